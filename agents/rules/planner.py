"""A planner that tries what would happen: open-loop search in copies of the environment.

A sequence of actions is a first action and another one that is repeated after it. Every sequence is driven in a copy
for a few steps, and the first action of the best one is taken. This needs an environment that `copy.deepcopy` copies
while an episode runs; one that knows the future if the copies meet the same traffic as the environment itself, and one
that does not if the environment can ``imagine`` (`sumo_env.env.DrivingEnv.imagine`).
"""

from __future__ import annotations

import copy
from typing import Any

import gymnasium as gym
import numpy as np

from agents.streams import stream

STEPS = 5  # of a sequence
CRASH = 10.0  # cost of a crash, in units of the reward
REPEATED = ("IDLE", "SLOWER")


class Planner:
    """Takes the first action of the sequence with the best return.

    Args:
        env: that it drives; its `unwrapped` is copied, so that rewards are its own.
        foresees: whether the copies meet the future that will come, instead of an imagined one.
    """

    def __init__(self, env: gym.Env[Any, Any], foresees: bool) -> None:
        self._env: Any = env.unwrapped
        self._foresees = foresees
        self.reset(0)

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode; the seed fixes what is imagined, without one the draws go on where they are."""
        if seed is not None:
            self._generator = stream(seed, "planner")

    def act(self, observation: np.ndarray) -> int:
        """The action that turns out best."""
        names: dict[int, str] = self._env.actions
        # IDLE first, so that nothing is done where it makes no difference
        firsts = sorted(self._env.get_available_actions(), key=lambda action: names[action] != "IDLE")
        repeated = [action for action, name in names.items() if name in REPEATED]
        seed = int(self._generator.integers(2**31))
        future = copy.deepcopy(self._env) if self._foresees else self._env.imagine(seed)
        best = {first: max(_values(future, first, repeated).values()) for first in firsts}
        future.close()
        return max(best, key=lambda first: best[first])


def _values(env: Any, first: int, repeated: list[int]) -> dict[int, float]:
    """Value of a first action followed by each of the repeated ones, in copies."""
    begun = copy.deepcopy(env)
    value, over = _step(begun, first)
    values = dict.fromkeys(repeated, value)
    for then in repeated if not over else ():
        twin = begun if then == repeated[-1] else copy.deepcopy(begun)
        ended = False
        for _ in range(STEPS - 1):
            if not ended:
                value, ended = _step(twin, then)
                values[then] += value
        twin.close()
    begun.close()
    return values


def _step(env: Any, action: int) -> tuple[float, bool]:
    """Reward less the cost of a crash, and whether the episode is over."""
    _, reward, terminated, truncated, info = env.step(action)
    return float(reward) - CRASH * bool(info["crashed"]), terminated or truncated
