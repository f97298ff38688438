"""What has to be driven, and the processes that drive it. A part is a file; one that is there is never driven again."""

from __future__ import annotations

import copy
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from experiments.backends import make_env
from experiments.study.attempt import LOG, Beat
from experiments.study.executors import open_executor
from experiments.study.grid import level_names
from experiments.study.run import Silent
from experiments.study.run import run as compute
from experiments.study.seeds import stream_seed
from experiments.support.errors import UserError
from experiments.support.files import canonical_json, sha256_bytes, write_file
from experiments.validation.egos import egos
from experiments.validation.episodes import COLUMNS, ScenarioMaker, drive
from sumo_env.tasks import TASKS
from sumo_env.traffic.risk import RiskRates

if TYPE_CHECKING:
    import pandas as pd

STRAIGHT = ("highway", "two-way")  # roads without joins: the variants of highway-env are the same there
# Rough time of an episode at the lowest level, relative to each other, to start long parts first and to estimate
# the end.
COST = {"highway": 8.0, "two-way": 2.0, "roundabout": 2.0, "intersection": 2.0, "u-turn": 1.0}
TASKS_PER_PROCESS = 25  # then a fresh process takes over
SILENCE = 6 * 3600.0  # [s] a part that takes so long hangs
SLOWNESS = {"highway-env": 60.0}  # of a backend


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

    def named(self, name: str) -> Engine:
        """The same under another name."""
        return replace(self, name=name)

    def folder(self, task: str) -> str:
        """Where its parts of a task are stored: by all that decides what they hold."""
        settings = [dict(self.config), dict(self.calibration), dict(self.risk), self.one_in, list(self.egos)]
        digest = sha256_bytes(canonical_json([*settings, self.stamps.get(task)]).encode())[:8]
        return f"{self.name.replace(' ', '-')}/{task}-{digest}"


class Work(Protocol):
    """Something to be computed in a process and stored in a file."""

    @property
    def engine(self) -> Engine:
        """Whose work it is."""

    @property
    def task(self) -> str:
        """The only task that it drives."""

    @property
    def file(self) -> str:
        """Its path within the folder of all parts."""

    @property
    def cost(self) -> float:
        """Rough time that it takes, in an arbitrary unit."""

    def compute(self) -> bytes:
        """The content of the file."""


@dataclass(frozen=True)
class Part:
    """The episodes of some scenarios of a level and traffic, by all egos."""

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

    @property
    def cost(self) -> float:
        """Rough time that it takes, in an arbitrary unit."""
        number = len(self.scenarios) * len(egos(self.task)) / self.engine.one_in
        return COST[self.task] * (1 + self.level) * number * SLOWNESS.get(self.engine.backend, 1.0)

    def compute(self) -> bytes:
        """Drive all episodes; the table as a parquet file."""
        buffer = io.BytesIO()
        drive_part(self).to_parquet(buffer, index=False, compression="zstd")
        return buffer.getvalue()


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


def open_env(engine: Engine, task: str, level: int) -> Any:
    """The environment of a task at a level."""
    config = {**TASKS[task].levels[level_names(task)[level - 1]], **engine.config}
    if not engine.calibration:
        return make_env(engine.backend, task, config)
    from sumo_env.env import DrivingEnv
    from sumo_env.sumo.world import SumoSimulator

    calibration = replace(TASKS[task].calibration, **engine.calibration)
    return DrivingEnv(task, config, simulator=SumoSimulator(calibration))


def scenario_maker(engine: Engine, task: str) -> ScenarioMaker | None:
    """How scenarios are drawn where the engine's risk differs from the task's."""
    if not engine.risk:
        return None
    changed = copy.copy(TASKS[task])
    names = {item.name for item in fields(RiskRates)}
    rates = {name: value for name, value in engine.risk.items() if name in names}
    ranges = {name: value for name, value in engine.risk.items() if name not in names}
    changed.risk_rates = replace(changed.risk_rates, **rates)  # type: ignore[misc]
    changed.risk_ranges = replace(changed.risk_ranges, **ranges)  # type: ignore[misc]
    return changed.scenario


def drive_part(part: Part) -> pd.DataFrame:
    """Drive all episodes of a part in this process."""
    import pandas as pd

    chosen = part.episodes()
    rows = []
    if chosen:
        env = open_env(part.engine, part.task, part.level)
        try:
            make_scenario = scenario_maker(part.engine, part.task)
            for scenario, ego in chosen:
                rows.append(drive(env, part.task, part.level, part.traffic, ego, scenario, make_scenario))
        finally:
            env.close()
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)


@dataclass(frozen=True)
class WorkTask:
    """Some work whose file lies in the folder of all parts (an `attempt.Task`)."""

    work: Work
    parts: Path
    silence: float = SILENCE

    @property
    def name(self) -> str:
        """Path of the file within the folder."""
        return self.work.file

    @property
    def cost(self) -> float:
        """Rough time, in an arbitrary unit."""
        return self.work.cost

    @property
    def folder(self) -> Path:
        """For lock and log."""
        return self.parts / "work" / self.work.file.replace("/", "-")

    def done(self) -> bool:
        """Whether the file is there."""
        return (self.parts / self.name).exists()

    def compute(self, beat: Beat) -> str:
        """Compute the content and write the file."""
        path = self.parts / self.name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, self.work.compute())
        return ""


class Noted(Silent):
    """Calls a function with each finished piece of work."""

    def __init__(self, note: Callable[[Work], None]) -> None:
        self._note = note

    def finished(self, task: WorkTask, remark: str) -> None:
        """Note it."""
        self._note(task.work)


def run(work: Sequence[Work], folder: Path, workers: int, note: Callable[[Work], None]) -> None:
    """Do the work whose files are not there yet, in processes; `note` is called with each finished piece.

    Raises:
        UserError: some of it failed. What is finished stays, and the same call goes on from there.
    """
    groups: dict[tuple[str, ...], list[WorkTask]] = {}
    for item in work:
        if not (task := WorkTask(item, folder)).done():
            # highway-env's tasks change class attributes of each other's vehicles: a process sees one of them only
            own = item.engine.backend == "highway-env"
            groups.setdefault((item.engine.backend, item.task if own else ""), []).append(task)
    for tasks in groups.values():
        executor, limit = open_executor("local", workers, folder, TASKS_PER_PROCESS)
        if failures := compute(tasks, executor, limit, Noted(note)):
            failed = next(task for task in tasks if task.name in failures)
            raise UserError(
                f"{len(failures)} parts failed, one of them because {failures[failed.name]}; see {failed.folder / LOG} "
                "and run the same command again to go on"
            )


def collect(parts: Sequence[Part], folder: Path) -> pd.DataFrame:
    """The table of all episodes, with the column ``engine``."""
    import pandas as pd

    tables = [pd.read_parquet(folder / part.file).assign(engine=part.engine.name) for part in parts]
    return pd.concat(tables, ignore_index=True)
