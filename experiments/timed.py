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
IDLE = 1  # of the actions


class Driver:
    """Drives an environment, or a batch, with random actions, as an exploring agent does: resets count in full.

    Args:
        backend: of the study, or "envpool".
        config: of the study's environment; None for the default configuration of the backend's own, and for EnvPool.
        batch: environments of EnvPool, or of the replica in seeded scenarios, that a step drives; None for one.
        threads: that drive them.
    """

    def __init__(
        self,
        backend: str,
        task: str,
        config: dict[str, Any] | None = None,
        batch: int | None = None,
        threads: int = 1,
    ) -> None:
        self._env: Any
        self._envpool: dict[str, Any] = {}
        if backend == "envpool":
            batch = batch or 1
            self._envpool = {"task_id": f"{task}-v0", "num_envs": batch, "num_threads": threads}
        elif batch:
            settings: dict[str, Any] = {"scenarios": "seeded", "config": config, "threads": threads}
            self._env = gym.make_vec(f"sumo_env:replica/{task}-v0", num_envs=batch, **settings)
        elif config is not None:
            self._env = make_env(backend, task, config)
        else:
            room = "highway_env:" if backend == "highway-env" else f"sumo_env:{backend}/"
            self._env = gym.make(f"{room}{task}-v0")
        self._rng, self._actions, self._batch = (
            np.random.default_rng(0),
            3 if task == "intersection" else 5,
            batch,
        )
        # a slice ends with an episode and so holds its share of resets; batches begin the next episodes by themselves,
        # and highway-env's episodes take too long
        self._whole = not batch and backend != "highway-env"
        self._done = False
        self._resets: list[float] = []  # processor time of each [s]
        self._begin(0)
        self.rate(0.0)  # loads the network, compiles, fills caches
        self._resets = []

    def _begin(self, seed: int) -> Any:
        """Begin the episode of a seed; returns the first observation."""
        if not self._envpool:
            return self._env.reset(seed=seed)[0]
        import envpool

        self._env = envpool.make_gymnasium(**self._envpool, seed=seed)  # which cannot be told later
        return self._env.reset()[0]

    def rate(self, seconds: float) -> tuple[float, float]:
        """Policy steps per second of processor time and of wall time, in a slice of so many seconds."""
        begun, cpu, steps = time.perf_counter(), time.process_time(), 0
        while steps < LEAST or time.perf_counter() - begun < seconds or (self._whole and not self._done):
            if self._done:
                start = time.process_time()
                self._env.reset()
                self._resets.append(time.process_time() - start)
            actions = self._rng.integers(self._actions, size=self._batch).astype("int32")
            _, _, terminated, truncated, _ = self._env.step(actions)
            self._done = not self._batch and (terminated or truncated)
            steps += 1
        steps *= self._batch or 1
        return steps / (time.process_time() - cpu), steps / (time.perf_counter() - begun)

    def reset_ms(self) -> float | None:
        """Median processor time of the resets so far [ms], if there were any."""
        return 1e3 * statistics.median(self._resets) if self._resets else None

    def distinct(self, seeds: int) -> int:
        """Different first observations of so many seeds."""
        return len({self._begin(seed).tobytes() for seed in range(seeds)})

    def idle_crash_rate(self, seeds: int) -> float:
        """Share of the episodes of so many seeds in which an ego crashes that always takes IDLE."""
        idle, crashes = IDLE if self._batch is None else np.full(1, IDLE, np.int32), 0
        for seed in range(seeds):
            self._begin(seed)
            over, info = False, {"crashed": False}
            while not over:
                _, _, terminated, truncated, info = self._env.step(idle)
                over = bool(np.any(terminated) or np.any(truncated))
            crashes += bool(np.all(info["crashed"]))
        return crashes / seeds


class Process(BaseManager):
    """A process for objects of this file: its method `Driver` makes one there."""

    Driver: Any


Process.register("Driver", Driver)
