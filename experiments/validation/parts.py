"""The episodes that simulators have to drive, in parallel processes and resumable: each part is a file of its own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from experiments.backends import make_env
from experiments.study.arms import stream_seed
from experiments.study.executors.local import call_all
from experiments.study.fingerprint import dynamics
from experiments.study.grid import level_names
from experiments.support.files import canonical_json, sha256_bytes, write_file
from experiments.validation.episodes import COLUMNS, drive, egos
from sumo_env.tasks import TASKS

STRAIGHT = ("highway", "two-way")  # roads without joins: the variants of highway-env are the same there
SIZE = 25  # scenarios in a part


@dataclass(frozen=True)
class Engine:
    """A simulator with its settings.

    name: how tables call it. config: changes of a task's configuration. options: of `reset`, beside the dose of risk
    (highway-env itself has none). one_in: drives a random episode in so many. egos: all of the task if empty.
    """

    name: str
    backend: str
    config: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    one_in: int = 1
    egos: tuple[str, ...] = ()

    def folder(self, task: str) -> str:
        """Where its parts of a task are stored: by all that decides what they hold, its dynamics included."""
        settings = [dict(self.config), dict(self.options), self.one_in, self.egos]
        digest = sha256_bytes(canonical_json([*settings, dynamics(self.backend, task)]).encode())[:8]
        return f"{self.name.replace(' ', '-')}/{task}-{digest}"


@dataclass(frozen=True)
class Part:
    """The episodes of some scenarios of a level and traffic, by all egos of an engine."""

    engine: Engine
    task: str
    level: int
    traffic: str
    scenarios: range

    @property
    def file(self) -> str:
        """Path of its table within the folder of all parts."""
        first, last = self.scenarios[0], self.scenarios[-1]
        return f"{self.engine.folder(self.task)}/{self.level}-{self.traffic}-{first:03d}-{last:03d}.parquet"

    def episodes(self) -> list[tuple[int, str]]:
        """Scenario and ego of each episode."""
        return [
            (scenario, ego)
            for scenario in self.scenarios
            for ego in egos(self.task)
            if not self.engine.egos or ego in self.engine.egos
            if self.engine.one_in == 1 or self._is_drawn(scenario, ego)
        ]

    def _is_drawn(self, scenario: int, ego: str) -> bool:
        drawn = stream_seed("recomputed episode", self.task, self.level, self.traffic, scenario, ego)
        return drawn % self.engine.one_in == 0

    def drive(self) -> pd.DataFrame:
        """Drive all episodes in this process."""
        level = TASKS[self.task].levels[level_names(self.task)[self.level - 1]]
        env = make_env(self.engine.backend, self.task, {**level, **self.engine.config})
        rows = [
            drive(env, self.task, self.level, self.traffic, ego, scenario, self.engine.options)
            for scenario, ego in self.episodes()
        ]
        env.close()
        return pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)

    def write(self, folder: Path) -> None:
        """Drive all episodes and write the table as a parquet file."""
        path = folder / self.file
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, self.drive().to_parquet(index=False, compression="zstd"))


def plan(
    engines: Iterable[Engine],
    levels: Mapping[str, Sequence[int]],
    traffics: Sequence[str],
    scenarios: range,
    size: int = SIZE,
) -> list[Part]:
    """Everything that the engines have to drive, `size` scenarios in a part.

    On roads without joins, engines that differ only in how far drivers see beyond a join are not driven.
    """
    return [
        Part(engine, task, level, traffic, scenarios[first : first + size])
        for engine in engines
        for task, numbers in levels.items()
        if not (task in STRAIGHT and engine.config.get("variant") in ("v0", "connected"))
        for level in numbers
        for traffic in traffics
        for first in range(0, len(scenarios), size)
    ]


def run(parts: Sequence[Part], folder: Path, workers: int, console: Console | None = None) -> pd.DataFrame:
    """Drive the parts whose files are not there yet, in processes, and return the table of all episodes.

    Args:
        console: where progress is shown, if at all.

    Returns:
        COLUMNS, and the name of the engine as the column ``engine``.

    Raises:
        UserError: a part failed. What is finished stays, and the same call goes on from there.
    """
    work = {part.file: partial(part.write, folder) for part in parts if not (folder / part.file).exists()}
    call_all(work, workers, "driving", console)
    tables = [pd.read_parquet(folder / part.file).assign(engine=part.engine.name) for part in parts]
    return pd.concat(tables, ignore_index=True)
