"""highway-env's own environments with kinematics observations, behind the attributes that the rules read."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np

FEATURES = ["presence", "x", "y", "vx", "vy"]
# task: (id, absolute, features, x [m], y [m], speed [m/s], other configuration)
TASKS: dict[str, tuple[str, bool, list[str], float, float, float, dict[str, Any]]] = {
    "highway": ("highway-v0", False, FEATURES, 200, 16, 80, {"vehicles_count": 20, "duration": 20}),
    "roundabout": ("roundabout-v1", True, FEATURES, 100, 100, 15, {}),
    "intersection": ("intersection-v2", True, [*FEATURES, "cos_h", "sin_h"], 100, 100, 20, {}),
    "u-turn": ("u-turn-v1", False, FEATURES, 160, 50, 24, {}),
}


class Stock(gym.Wrapper):
    """A stock environment; ``actions``, ``target_speeds`` and ``observation_type`` are added to ``unwrapped``."""

    def __init__(self, task: str) -> None:
        import highway_env  # noqa: F401  (registers the environments)

        name, absolute, features, x, y, speed, config = TASKS[task]
        ranges = {"x": (-x, x), "y": (-y, y), "vx": (-speed, speed), "vy": (-speed, speed)}
        observation = {
            "type": "Kinematics",
            "vehicles_count": 15 if task == "intersection" else 5,
            "features": features,
            "features_range": {key: list(limits) for key, limits in ranges.items()},
            "absolute": absolute,
        }
        env = gym.make(name, config={"observation": observation, **config}, disable_env_checker=True)
        super().__init__(env)
        inner: Any = env.unwrapped
        self._names = dict(inner.action_type.actions)
        self._ladder = tuple(float(target) for target in inner.action_type.target_speeds)
        self._kind = SimpleNamespace(features=tuple(features), ranges=ranges, absolute=absolute)

    @property
    def unwrapped(self) -> Any:
        return SimpleNamespace(
            actions=self._names,
            target_speeds=self._ladder,
            observation_type=self._kind,
            env=self.env.unwrapped,
        )


def drive(env: gym.Env[Any, Any], policy: Any, episodes: int) -> tuple[float, float]:
    """Mean return and crash rate over the seeds 0, 1, ..."""
    returns, crashes = [], []
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        policy.reset(seed)
        total, ended = 0.0, False
        while not ended:
            observation, reward, terminated, truncated, info = env.step(policy.act(observation))
            total, ended = total + float(reward), terminated or truncated
        returns.append(total)
        crashes.append(info["crashed"])
    return float(np.mean(returns)), float(np.mean(crashes))
