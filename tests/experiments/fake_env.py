"""A small driving task with the environment's interface: one lane, one leader, a crash when the gap closes.

Fast (20 us a step) and deterministic in its seed, so that the engine can be tested without a simulator.
"""

from dataclasses import asdict
from types import SimpleNamespace
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np

from sumo_env.contacts.crash import CrashRecord

FEATURES = ("presence", "x", "y", "vx", "vy")


class FakeEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012
    target_speeds = (10.0, 20.0, 30.0)
    met: ClassVar[list[tuple[int, float, int]]] = []  # seed, dose and duration of this process' episodes

    def __init__(self, task: str, config: dict[str, Any], render_mode: str | None = None) -> None:
        self.task = task
        self.render_mode = render_mode
        self.config = {"risk": 0.0, "duration": 10, "policy_frequency": 1, **config}
        self.actions = {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT", 3: "FASTER", 4: "SLOWER"}
        self.action_space = gym.spaces.Discrete(5)
        self.observation_space = gym.spaces.Box(-1, 1, (2, 5), np.float32)
        self.observation_type = SimpleNamespace(
            features=FEATURES,
            absolute=False,
            ranges={"x": (-200.0, 200.0), "y": (-8.0, 8.0), "vx": (-80.0, 80.0), "vy": (-80.0, 80.0)},
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        self.config.update((options or {}).get("config", {}))
        self.met.append((seed, self.config["risk"], self.config["duration"]))
        self.gap = float(self.np_random.uniform(20, 60))
        self.rung, self.speed, self.time, self.crashed = 1, 20.0, 0, False
        return self._observe(), self._info(0.0, None)

    def step(self, action: int):
        self.rung = int(np.clip(self.rung + {3: 1, 4: -1}.get(int(action), 0), 0, 2))
        self.speed += 0.6 * (self.target_speeds[self.rung] - self.speed)
        leader = 15.0 + 10.0 * self.config["risk"] * float(self.np_random.normal())
        self.gap += leader - self.speed
        self.time += 1
        self.crashed = self.gap < 5.0
        hit = CrashRecord(
            "v0", float(self.time), 0.0, 0.0, self.gap, 0.0, 0.0, self.speed - leader, "rear-end", "sumo"
        )
        crash = asdict(hit) if self.crashed else None
        reward = 0.0 if self.crashed else self.speed / 30.0
        truncated = self.time >= self.config["duration"]
        return self._observe(), reward, self.crashed, truncated, self._info(self.speed, crash)

    def render(self):
        picture = np.full((20, 60, 3), 200, np.uint8)
        picture[8:12, min(59, int(max(self.gap, 0) / 4)) :] = 0
        return picture

    @property
    def scene(self) -> SimpleNamespace:
        """What a fingerprint is taken of."""
        return SimpleNamespace(
            ids=("ego", "v0"),
            x=np.array([0.0, self.gap]),
            y=np.array([4.0, 4.0]),
            speed=np.array([self.speed, 15.0]),
            crashed=np.array([self.crashed] * 2),
        )

    @property
    def vehicle(self) -> SimpleNamespace:
        return SimpleNamespace(
            target_lane_index=0,
            speed_index=self.rung,
            position=np.array([0.0, 4.0]),
            speed=self.speed,
            heading=0.0,
        )

    def _observe(self) -> np.ndarray:
        rows = [[1, 0, 0, self.speed / 80, 0], [1, self.gap / 200, 0, (15 - self.speed) / 80, 0]]
        return np.clip(np.array(rows, np.float32), -1, 1)

    def _info(self, distance: float, crash: dict[str, Any] | None) -> dict[str, Any]:
        closing = self.speed - 15.0
        ttc = (self.gap - 5) / closing if closing > 0 else float("inf")
        return {
            "speed": self.speed,
            "crashed": self.crashed,
            "arrived": False,
            "crash": crash,
            "density": 1,
            "min_ttc_before_contact": max(ttc, 0.0),
            "near_miss": ttc < 1.5 and not self.crashed,
            "distance": distance,
        }


def make_other_env(*arguments: Any) -> gym.Env:
    """As `make_env`, but for its dynamics."""
    env: Any = make_env(*arguments)
    env.target_speeds = (10.0, 19.0, 31.0)
    return env


def make_env(backend: str, task: str, config: Any = None, render_mode: str | None = None) -> gym.Env:
    return FakeEnv(task, dict(config or {}), render_mode)
