"""The egos that drive through the traffic: the rules of `agents`, and two that repeat a few actions."""

from __future__ import annotations

from typing import Any

from agents.rules import Policy, make_policy
from agents.rules.constant import Constant

# Averaged over in the checks "over egos"; the two-way road and the intersection start the ego at its top speed, so
# that "faster" would be "idle" again.
CORE = ("idle", "faster", "random", "careful", "idm")
MORE = ("slower", "pulsing", "weaving")
ALREADY_FASTEST = ("two-way", "intersection")
WITHOUT_LANE_CHANGES = ("intersection",)
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
    return Constant(*(numbers[action] for action in CYCLES[name]))
