"""The episodes that simulators have to drive, in parallel processes and resumable: each part is a file of its own."""

from __future__ import annotations

import io
import multiprocessing
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pebble import ProcessPool

from experiments.backends import make_env
from experiments.study.grid import level_names
from experiments.study.seeds import stream_seed
from experiments.support.errors import UserError
from experiments.support.files import canonical_json, sha256_bytes, write_file
from experiments.support.processes import end_with_parent
from experiments.validation.egos import egos
from experiments.validation.episodes import COLUMNS, drive
from sumo_env.tasks import TASKS
from sumo_env.traffic.risk import RiskRates

if TYPE_CHECKING:
    import pandas as pd

STRAIGHT = ("highway", "two-way")  # roads without joins: the variants of highway-env are the same there
# Rough time of an episode at the lowest level, relative to each other, to start long parts first and to estimate
# the end.
COST = {"highway": 8.0, "two-way": 2.0, "roundabout": 2.0, "intersection": 2.0, "u-turn": 1.0}
SLOWNESS = {"highway-env": 60.0}  # of a backend
PARTS_PER_PROCESS = 25  # then a fresh process takes over


@dataclass(frozen=True)
class Engine:
    """A simulator with its settings.

    Attributes:
        name: how tables call it.
        backend: of `experiments.backends.make_env`.
        config: changes of a task's configuration.
        calibration: changes of the task's calibrated drivers (`sumo_env.traffic.drivers.Calibration`); SUMO only.
        risk: changes of the task's risk, by the names of `sumo_env.traffic.risk.RiskRates` and
            `sumo_env.traffic.drivers.RiskRanges`; not highway-env itself.
        one_in: drives a random episode in so many.
        egos: that are driven, all of the task if empty.
        stamps: task -> fingerprint of what it drives; episodes of another fingerprint are never reused.
    """

    name: str
    backend: str
    config: Mapping[str, Any] = field(default_factory=dict)
    calibration: Mapping[str, Any] = field(default_factory=dict)
    risk: Mapping[str, Any] = field(default_factory=dict)
    one_in: int = 1
    egos: tuple[str, ...] = ()
    stamps: Mapping[str, str] = field(default_factory=dict)

    def folder(self, task: str) -> str:
        """Where its parts of a task are stored: by all that decides what they hold."""
        settings = [dict(self.config), dict(self.calibration), dict(self.risk), self.one_in, list(self.egos)]
        digest = sha256_bytes(canonical_json([*settings, self.stamps.get(task)]).encode())[:8]
        return f"{self.name.replace(' ', '-')}/{task}-{digest}"

    def open_env(self, task: str, level: int) -> Any:
        """The environment of a task at a level."""
        config = {**TASKS[task].levels[level_names(task)[level - 1]], **self.config}
        return make_env(self.backend, task, config)

    @property
    def options(self) -> dict[str, Any]:
        """What `reset` is given beside the configuration."""
        rates = {item.name for item in fields(RiskRates)}
        options = {
            "calibration": self.calibration,
            "risk_rates": {name: value for name, value in self.risk.items() if name in rates},
            "risk_ranges": {name: value for name, value in self.risk.items() if name not in rates},
        }
        return {name: changes for name, changes in options.items() if changes}


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

    @property
    def cost(self) -> float:
        """Rough time that it takes, in an arbitrary unit."""
        number = len(self.scenarios) * len(egos(self.task)) / self.engine.one_in
        return COST[self.task] * (1 + self.level) * number * SLOWNESS.get(self.engine.backend, 1.0)

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
        import pandas as pd

        rows = []
        if chosen := self.episodes():
            env = self.engine.open_env(self.task, self.level)
            options = self.engine.options
            try:
                for scenario, ego in chosen:
                    rows.append(drive(env, self.task, self.level, self.traffic, ego, scenario, options))
            finally:
                env.close()
        return pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)

    def write(self, folder: Path) -> None:
        """Drive all episodes and write the table as a parquet file."""
        buffer = io.BytesIO()
        self.drive().to_parquet(buffer, index=False, compression="zstd")
        path = folder / self.file
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, buffer.getvalue())


def plan(
    engines: Iterable[Engine],
    levels: Mapping[str, Sequence[int]],
    traffics: Sequence[str],
    scenarios: range,
    size: int,
) -> list[Part]:
    """Everything that the engines have to drive, `size` scenarios in a part.

    On roads without joins, engines that differ only in how far drivers see beyond a join are left out.
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


def run(parts: Sequence[Part], folder: Path, workers: int, note: Callable[[Part], None]) -> None:
    """Drive the parts whose files are not there yet, in processes; `note` is called with each finished one.

    Raises:
        UserError: a part failed. What is finished stays, and the same call goes on from there.
    """
    groups: dict[tuple[str, str], list[Part]] = {}
    for part in sorted(parts, key=lambda part: -part.cost):
        if not (folder / part.file).exists():
            # highway-env's tasks change class attributes of each other's vehicles: a process sees one of them only
            alone = part.task if part.engine.backend == "highway-env" else ""
            groups.setdefault((part.engine.backend, alone), []).append(part)
    context = multiprocessing.get_context("spawn")
    for group in groups.values():
        pool = ProcessPool(workers, PARTS_PER_PROCESS, end_with_parent, context=context)
        try:
            running: dict[Future[None], Part] = {
                pool.schedule(part.write, args=(folder,)): part for part in group
            }
            for future in as_completed(running):
                part = running[future]
                if error := future.exception():
                    raise UserError(f"{part.file} failed ({error}): run the same command again to go on")
                note(part)
        finally:
            pool.stop()  # on an error or Ctrl-C, whatever is running is given up
            pool.join()


def collect(parts: Sequence[Part], folder: Path) -> pd.DataFrame:
    """The table of all episodes, with the column ``engine``."""
    import pandas as pd

    tables = [pd.read_parquet(folder / part.file).assign(engine=part.engine.name) for part in parts]
    return pd.concat(tables, ignore_index=True)
