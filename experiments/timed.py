"""What `benchmark.py` times: environments, each in a process of its own."""

from __future__ import annotations

import statistics
import time
from multiprocessing.managers import BaseManager
from typing import Any

import gymnasium as gym
import numpy as np

from experiments.backends import make_env

LEAST = 3  # steps in a slice
BATCH = 64  # environments
IDLE = 1  # of the actions


class EnvPool:
    """EnvPool's copy of a task as an environment of gymnasium. It begins the next episode by itself."""

    def __init__(self, task: str) -> None:
        import envpool

        self._action = np.zeros(1, np.int32)
        self._open = lambda seed: envpool.make_gymnasium(f"{task}-v0", num_envs=1, seed=seed)

    def reset(self, seed: int | None = None) -> tuple[Any, Any]:
        """Begin the episode of a seed, in a new environment; without a seed there is nothing to do."""
        if seed is None:
            return None, {}
        self._env = self._open(seed)
        return self._env.reset()

    def step(self, action: int) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Drive one step."""
        self._action[0] = action
        observation, reward, terminated, truncated, info = self._env.step(self._action)
        return observation, reward, bool(terminated[0]), bool(truncated[0]), {"crashed": info["crashed"][0]}


class Driver:
    """Drives an environment with random actions, as an exploring agent does: resets count in full.

    Args:
        backend: of the study, or "envpool".
        config: of the study's environment; None for the default configuration of the backend's own.
    """

    def __init__(self, backend: str, task: str, config: dict[str, Any] | None = None) -> None:
        if backend == "envpool":
            self._env: Any = EnvPool(task)
        elif config is not None:
            self._env = make_env(backend, task, config)
        elif backend == "highway-env":
            self._env = gym.make(f"highway_env:{task}-v0")
        else:
            self._env = gym.make(f"sumo_env:{backend}/{task}-v0")
        self._rng, self._actions = np.random.default_rng(0), 3 if task == "intersection" else 5
        self._done = False
        # a slice ends with an episode and so holds its share of resets; highway-env's episodes take too long
        self._whole = backend != "highway-env"
        self._resets: list[float] = []  # processor time of each [s]
        self._env.reset(seed=0)
        self.rate(0.0)  # loads the network, compiles, fills caches
        self._resets = []

    def rate(self, seconds: float) -> float:
        """Policy steps per second of processor time, in a slice of so many seconds."""
        begun, cpu, steps = time.perf_counter(), time.process_time(), 0
        while steps < LEAST or time.perf_counter() - begun < seconds or (self._whole and not self._done):
            if self._done:
                start = time.process_time()
                self._env.reset()
                self._resets.append(time.process_time() - start)
            _, _, terminated, truncated, _ = self._env.step(int(self._rng.integers(self._actions)))
            self._done = terminated or truncated
            steps += 1
        return steps / (time.process_time() - cpu)

    def reset_ms(self) -> float:
        """Median processor time of the resets so far [ms]."""
        return 1e3 * statistics.median(self._resets)

    def distinct(self, seeds: int) -> int:
        """Different first observations of so many seeds."""
        return len({self._env.reset(seed=seed)[0].tobytes() for seed in range(seeds)})

    def idle_crash_rate(self, seeds: int) -> float:
        """Share of the episodes of so many seeds in which an ego crashes that always takes IDLE."""
        crashes = 0
        for seed in range(seeds):
            self._env.reset(seed=seed)
            over, info = False, {"crashed": False}
            while not over:
                _, _, terminated, truncated, info = self._env.step(IDLE)
                over = terminated or truncated
            crashes += bool(info["crashed"])
        return crashes / seeds


class Batch:
    """A batch of environments, which random actions drive: EnvPool's or, with seeded scenarios, the replica's.

    Args:
        backend: "envpool" or "replica".
        config: of the replica's environments; EnvPool drives its own default.
        threads: that drive them.
    """

    def __init__(self, backend: str, task: str, config: dict[str, Any], threads: int) -> None:
        if backend == "envpool":
            import envpool

            self._envs: Any = envpool.make_gymnasium(f"{task}-v0", num_envs=BATCH, num_threads=threads)
        else:
            settings: dict[str, Any] = {"scenarios": "seeded", "config": config, "threads": threads}
            self._envs = gym.make_vec(f"sumo_env:replica/{task}-v0", num_envs=BATCH, **settings)
        self._envs.reset()
        self._rng, self._actions = np.random.default_rng(0), 3 if task == "intersection" else 5
        self.rate(0.0)

    def rate(self, seconds: float) -> tuple[float, float]:
        """Policy steps per second of processor time and of wall time; a step that is a reset counts."""
        begun, cpu, steps = time.perf_counter(), time.process_time(), 0
        while steps < LEAST * BATCH or time.perf_counter() - begun < seconds:
            self._envs.step(self._rng.integers(self._actions, size=BATCH).astype("int32"))
            steps += BATCH
        return steps / (time.process_time() - cpu), steps / (time.perf_counter() - begun)


class Process(BaseManager):
    """A process for objects of this file: its methods `Driver` and `Batch` make one there."""


for _kind in (Driver, Batch):
    Process.register(_kind.__name__, _kind)
