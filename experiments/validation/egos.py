"""The egos that drive through the traffic: the rules of `agents`, and two that repeat a few actions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from agents.rules import Policy, make_policy

# Averaged over in the checks "over egos"; the two-way road and the intersection start the ego at its top speed, so
# that "faster" would be "idle" again.
CORE = ("idle", "faster", "random", "careful", "idm")
MORE = ("slower", "pulsing", "weaving")
ALREADY_FASTEST = ("two-way", "intersection")
WITHOUT_LANE_CHANGES = ("intersection",)


class Cycle:
    """The same few actions over and over."""

    def __init__(self, actions: Sequence[int]) -> None:
        self._actions = tuple(actions)
        self._step = 0

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode with the first action."""
        self._step = 0

    def act(self, observation: Any) -> int:
        """The next action, whatever is observed."""
        self._step += 1
        return self._actions[(self._step - 1) % len(self._actions)]


CYCLES: dict[str, tuple[str, ...]] = {
    "pulsing": ("SLOWER", "IDLE", "FASTER", "FASTER", "IDLE", "SLOWER"),
    "weaving": ("LANE_LEFT", "IDLE", "LANE_RIGHT", "IDLE"),
}


def egos(task: str) -> tuple[str, ...]:
    """Names of the egos of a task, those of CORE first."""
    without = {"faster"} if task in ALREADY_FASTEST else set()
    without |= {"weaving"} if task in WITHOUT_LANE_CHANGES else set()
    return tuple(name for name in (*CORE, *MORE) if name not in without)


def make_ego(name: str, env: Any) -> Policy:
    """The ego of this name for an environment."""
    if name not in CYCLES:
        return make_policy(name, env)
    numbers = {action: number for number, action in env.unwrapped.actions.items()}
    return Cycle([numbers[action] for action in CYCLES[name]])
