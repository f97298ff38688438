"""Steps a second of the SUMO environments and of highway-env, resets and observations included.

A task at a level is measured in two processes that take turns: one slice of highway-env, then one of each SUMO
variant, again and again. The ratio of a variant is the median over the turns.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.backends import make_env
from experiments.benchmarks.remote import (
    Remote,
    Slice,
    Stopwatch,
    median_rate,
    median_ratio,
    median_wall_rate,
    resident_mib,
)
from experiments.study.grid import env_config, level_names

MODELS = ("matched", "sumo")
EQUAL_WORK = 15  # [Hz] highway-env's simulation_frequency: as many sub-steps on both sides
VARIANT = "connected"  # of highway-env: its own code alone, cars see beyond the ends of their lanes
WARM_UP_STEPS = {
    "sumo": 3,
    "highway-env": 1,
}  # compile, load the network, fill caches, before anything is timed

Record = dict[str, Any]
Key = tuple[
    int, str, int | None
]  # level, traffic model ("" on highway-env), simulation frequency (None: default)


@dataclass(frozen=True)
class Effort:
    """How much is measured: turns, seconds of a slice, and the fewest steps in one of highway-env's."""

    turns: int
    seconds: float
    reference_seconds: float
    reference_steps: int

    @property
    def engine_seconds(self) -> float:
        """Of a slice of the engine alone [s]."""
        return self.seconds / self.turns


def level_config(
    backend: str, task: str, level: int, model: str = "", frequency: int | None = None
) -> Record:
    """The configuration of a task at a level; `model` and `frequency` [Hz] where they are not the default."""
    config = dict(env_config(backend, task, level))
    if backend == "highway-env":
        config["variant"] = VARIANT
    elif model:
        config["traffic_model"] = model
    if frequency is not None:
        config["simulation_frequency"] = frequency
    return config


class Driver:
    """Drives environments of one backend with random actions; lives in its own process.

    An exploring agent acts like this, and its episodes are short in dense traffic: resets count in full.

    Args:
        backend: "sumo" or "highway-env".
        task: of all environments; highway-env allows one a process.
    """

    def __init__(self, backend: str, task: str) -> None:
        self._backend, self._task = backend, task
        self._envs: dict[Key, Any] = {}
        self._running: Key | None = None  # whose episode is under way
        self._done = True
        self._seed = 0
        self._resets: dict[Key, list[float]] = {}
        self._actions: dict[Key, Iterator[int]] = {}

    def open(self, key: Key, config: Mapping[str, Any]) -> None:
        """Make an environment and take the first steps in it, which compile."""
        env: Any = make_env(self._backend, self._task, config)
        self._envs[key], self._actions[key] = env, _random_actions(env.action_space.n)
        self._resets[key] = []
        self.drive(key, 0.0, WARM_UP_STEPS[self._backend])
        self._resets[key].clear()
        self._reset(key)

    def drive(self, key: Key, seconds: float, least: int, whole: bool = False) -> tuple[Slice, int]:
        """Take steps for `seconds`, at least `least` of them; returns them and the number of episodes begun.

        An episode goes on in the next slice, unless another environment was driven meanwhile; `whole`
        episodes are driven to their end, so that a slice holds the resets that its steps deserve.
        """
        env, actions = self._envs[key], self._actions[key]
        if self._running != key:
            env.reset(seed=self._seed)  # loads the network, if it is another one: no part of the slice
            self._running, self._done = key, True
        watch, steps, episodes = Stopwatch(), 0, 0
        while steps < least or watch.wall < seconds or (whole and not self._done):
            if self._done:
                self._reset(key)
                episodes += 1
            _, _, terminated, truncated, _ = env.step(next(actions))
            self._done = terminated or truncated
            steps += 1
        return watch.slice(steps), episodes

    def _reset(self, key: Key) -> None:
        start = time.process_time()
        self._envs[key].reset(seed=self._seed)
        self._resets[key].append(time.process_time() - start)
        self._seed += 1
        self._done = False

    def reset_ms(self, key: Key) -> float:
        """Median processor time of the resets so far [ms]."""
        return 1e3 * statistics.median(self._resets[key])

    def engine_share(self, key: Key, seconds: float) -> float:
        """Share of the processor time of a slice that is spent inside SUMO's step."""
        from sumo_env import simulation

        inside, step = 0.0, simulation._step

        def timed(until: float) -> None:
            nonlocal inside
            start = time.thread_time()
            step(until)
            inside += time.thread_time() - start

        simulation._step = timed  # libsumo's function itself: compiled code holds on to the methods above it
        try:
            part, _ = self.drive(key, seconds, 1, True)
        finally:
            simulation._step = step
        return inside / part.cpu

    def engine(self, key: Key, seconds: float, episode: int) -> Slice:
        """The same traffic for `episode` policy steps, again and again, with nothing read and nobody commanded.

        Counted are policy steps; placing the vehicles is no part of the time.
        """
        from sumo_env.simulation import simulation

        sim, env = simulation(), self._envs[key]
        config = env.unwrapped.config
        substeps = round(config["simulation_frequency"] / config["policy_frequency"])
        wall = cpu = 0.0
        steps = 0
        while steps == 0 or wall < seconds:
            self._reset(key)
            watch = Stopwatch()
            for _ in range(substeps * episode):
                sim.step()
            wall, cpu, steps = wall + watch.wall, cpu + watch.cpu, steps + episode
        self._running = None
        return Slice(steps, wall, cpu)

    def resident(self) -> float:
        """Resident memory of this process [MiB]."""
        return resident_mib()


def _random_actions(count: int) -> Iterator[int]:
    """Uniform ones of so many actions; drawn in blocks, to take no time of the loop."""
    rng = np.random.default_rng(0)
    while True:
        yield from rng.integers(count, size=4096).tolist()


def measure_task(
    task: str, levels: Sequence[int], effort: Effort, note: Callable[[str], None]
) -> Iterator[Record]:
    """Records of a task at some levels: both traffic models, at highway-env's frequency and at the default one."""
    variants: list[tuple[str, int | None]] = [(m, f) for f in (EQUAL_WORK, None) for m in MODELS]
    with Remote(Driver, "sumo", task) as ours, Remote(Driver, "highway-env", task) as theirs:
        for level in levels:
            note(f"{task} {level_names(task)[level - 1]}")
            reference: Key = (level, "", None)
            theirs.start("open", reference, level_config("highway-env", task, level))
            keys: list[Key] = [(level, model, frequency) for model, frequency in variants]
            for key in keys:
                ours.call("open", key, level_config("sumo", task, *key))
            theirs.result()
            slow: list[Slice] = []
            fast: dict[Key, list[Slice]] = {key: [] for key in keys}
            bare: dict[Key, list[Slice]] = {key: [] for key in keys}
            shares: dict[Key, list[float]] = {key: [] for key in keys}
            episodes, lengths = dict.fromkeys(keys, 0), dict.fromkeys(keys, 1)
            for _ in range(effort.turns):
                slow.append(
                    theirs.call("drive", reference, effort.reference_seconds, effort.reference_steps)[0]
                )
                for key in keys:
                    part, begun = ours.call("drive", key, effort.seconds, 1, True)
                    fast[key].append(part)
                    episodes[key] += begun
                    lengths[key] = max(
                        round(sum(part.count for part in fast[key]) / max(episodes[key], 1)), 1
                    )
                    bare[key].append(ours.call("engine", key, effort.engine_seconds, lengths[key]))
                    shares[key].append(ours.call("engine_share", key, effort.engine_seconds))
            memory = ours.call("resident")
            for key in keys:
                yield {
                    "task": task,
                    "level": level_names(task)[level - 1],
                    "traffic_model": key[1],
                    "simulation_frequency": key[2] or default_frequency(),
                    "equal_work": key[2] == EQUAL_WORK,
                    "highway_env_variant": VARIANT,
                    "sumo_steps_per_s": median_rate(fast[key]),
                    "highway_env_steps_per_s": median_rate(slow),
                    "ratio": median_ratio(fast[key], slow),
                    "sumo_wall_steps_per_s": median_wall_rate(fast[key]),
                    "highway_env_wall_steps_per_s": median_wall_rate(slow),
                    "engine_steps_per_s": median_rate(bare[key]),
                    "of_engine_alone": median_ratio(fast[key], bare[key]),
                    "engine_share": statistics.median(shares[key]),
                    "reset_ms": ours.call("reset_ms", key),
                    "highway_env_reset_ms": theirs.call("reset_ms", reference),
                    "episode_steps": lengths[key],
                    "highway_env_steps": sum(part.count for part in slow),
                    "rss_mib": memory,
                }


def default_frequency() -> int:
    """The environments' own simulation frequency [Hz]."""
    from sumo_env.config import COMMON

    return int(COMMON["simulation_frequency"])
