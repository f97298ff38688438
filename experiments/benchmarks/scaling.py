"""How cost grows: with the vehicles on the road, with the workers of a vector, and memory with the episodes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from experiments.benchmarks.environments import MODELS, Driver, Effort, Key, Record, level_config
from experiments.benchmarks.remote import Remote, Slice, Stopwatch, median_rate, resident_mib

GROWTH_TASK = "highway"
MEMORY_TASK = "intersection"  # vehicles come and go during its episodes, too
SAMPLES = 50  # of the resident memory
SETTLED = 0.2  # share of the episodes after which memory is expected to stand still


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Least-squares slope of y over x; of logarithms, the exponent of a power law."""
    return float(np.polyfit(x, y, 1)[0])


def measure_growth(vehicles: Sequence[int], effort: Effort, note: Callable[[str], None]) -> Record:
    """Milliseconds a policy step on the highway by the number of other vehicles, which take turns, and the exponents.

    `highway_env` is measured up to 100 vehicles: its cost grows with their square.
    """
    few = [count for count in vehicles if count <= 100]
    slow: dict[int, list[Slice]] = {count: [] for count in few}
    fast: dict[Key, list[Slice]] = {(count, model, None): [] for model in MODELS for count in vehicles}
    with Remote(Driver, "sumo", GROWTH_TASK) as ours, Remote(Driver, "highway-env", GROWTH_TASK) as theirs:
        for count in few:
            config = level_config("highway-env", GROWTH_TASK, 1)
            theirs.call("open", (count, "", None), {**config, "vehicles_count": count})
        for key in fast:
            config = level_config("sumo", GROWTH_TASK, 1, key[1])
            ours.call("open", key, {**config, "vehicles_count": key[0]})
        for turn in range(effort.turns):
            note(f"growth, turn {turn + 1} of {effort.turns}")
            for count in few:
                drive = "drive", (count, "", None), effort.reference_seconds, effort.reference_steps
                slow[count].append(theirs.call(*drive)[0])
            for key in fast:
                fast[key].append(ours.call("drive", key, effort.seconds, 1, True)[0])
    series = {"highway_env": [1e3 / median_rate(slow[count]) for count in few]}
    for model in MODELS:
        series[model] = [1e3 / median_rate(fast[count, model, None]) for count in vehicles]
    logs = [math.log(count) for count in vehicles]
    return {
        "vehicles": list(vehicles),
        "highway_env_vehicles": few,
        "ms_per_step": series,
        "exponent": {
            name: slope(logs[: len(values)], [math.log(value) for value in values])
            for name, values in series.items()
        },
    }


class Episodes:
    """Plays episodes in regular and risky traffic in turn and weighs the process now and then."""

    def __init__(self, task: str) -> None:
        from experiments.backends import make_env

        self._env: Any = make_env("sumo", task, level_config("sumo", task, 1))
        self._actions = np.random.default_rng(0)
        self._seed = 0

    def play(self, count: int) -> float:
        """Play `count` episodes; returns the resident memory after them [MiB]."""
        for _ in range(count):
            self._env.reset(seed=self._seed, options={"config": {"risk": float(self._seed % 2)}})
            self._seed += 1
            done = False
            while not done:
                action = int(self._actions.integers(self._env.action_space.n))
                _, _, terminated, truncated, _ = self._env.step(action)
                done = terminated or truncated
        return resident_mib()


def measure_memory(episodes: int, note: Callable[[str], None]) -> Record:
    """Resident memory over many episodes [MiB], and its slope [MiB per 1000 episodes] once it has settled."""
    each = max(episodes // SAMPLES, 1)
    counts: list[int] = []
    memory: list[float] = []
    with Remote(Episodes, MEMORY_TASK) as player:
        while not counts or counts[-1] < episodes:
            note(f"memory, {counts[-1] if counts else 0} of {episodes} episodes")
            memory.append(player.call("play", each))
            counts.append((counts[-1] if counts else 0) + each)
    first = int(len(counts) * SETTLED)
    return {
        "task": MEMORY_TASK,
        "episodes": counts,
        "rss_mib": memory,
        "mib_per_1000_episodes": 1e3 * slope(counts[first:], memory[first:]),
    }


class Vectors:
    """Steps a vector of SUMO environments with random actions; lives in its own process."""

    def __init__(self, task: str) -> None:
        import gymnasium as gym

        import sumo_env  # noqa: F401  (registers the ids)

        self._make: Callable[[int], Any] = lambda count: gym.make_vec(f"sumo/{task}-v0", num_envs=count)
        self._count = 0
        self._envs: Any = None

    def open(self, count: int) -> None:
        """Start `count` workers and take the first steps."""
        self._envs, self._count = self._make(count), count
        self._envs.reset(seed=0)
        self._envs.action_space.seed(0)
        self.drive(0.0, 5)

    def drive(self, seconds: float, least: int) -> Slice:
        """Steps of all environments together; the processor time is this process's alone."""
        watch, steps = Stopwatch(), 0
        while steps < least or watch.wall < seconds:
            self._envs.step(self._envs.action_space.sample())
            steps += 1
        return watch.slice(steps * self._count)

    def close(self) -> None:
        """End the workers."""
        self._envs.close()


def measure_vector(
    tasks: Sequence[str], workers: Sequence[int], seconds: float, note: Callable[[str], None]
) -> list[Record]:
    """Steps a second (wall time) of `gym.make_vec` with so many environments."""
    records = []
    for task in tasks:
        with Remote(Vectors, task) as driver:
            for count in workers:
                note(f"vector of {count}, {task}")
                driver.call("open", count)
                part: Slice = driver.call("drive", seconds, 1)
                driver.call("close")
                records.append({"task": task, "workers": count, "steps_per_s": part.wall_per_second})
    return records
