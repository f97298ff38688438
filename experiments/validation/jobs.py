"""What has to be driven, and the processes that drive it. Finished parts are files and are never driven again."""

from __future__ import annotations

import gzip
import io
import json
import multiprocessing
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from experiments.study.grid import TRAFFICS, level_names
from experiments.support.files import write_file
from sumo_env.tasks import TASKS

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Engine:
    """A simulator with its settings. `name` is how tables and files call it."""

    name: str
    backend: str
    config: tuple[tuple[str, Any], ...] = ()


PATH = Engine("highway-env", "highway-env", (("variant", "path"),))
NOISE = Engine("highway-env-10Hz", "highway-env", (("variant", "path"), ("simulation_frequency", 10)))
CONNECTED = Engine("connected", "highway-env", (("variant", "connected"),))
V0 = Engine("v0", "highway-env", (("variant", "v0"),))
MATCHED = Engine("sumo", "sumo")
NATIVE = Engine("sumo-native", "sumo", (("traffic_model", "sumo"),))
ENGINES = {engine.name: engine for engine in (PATH, NOISE, CONNECTED, V0, MATCHED, NATIVE)}
STRAIGHT = ("highway", "two-way")  # one segment of road: the variants of highway-env are the same there
CHANGE_LEVELS = (1, 3)  # of the highway, whose lane-change decisions are examined


@dataclass(frozen=True)
class Size:
    """Scenarios a cell: of the lowest level and of the others, and on the highway; and for lane changes."""

    lowest: int
    others: int
    highway: tuple[int, int, int]
    changes: int

    def of(self, task: str, level: int) -> int:
        """Scenarios of one level."""
        if task == "highway":
            return self.highway[level - 1]
        return self.lowest if level == 1 else self.others

    def at_most(self, scenarios: Mapping[str, Any]) -> Size:
        """The smaller of this size and the one that a reference's provenance names."""
        low, mid, high = map(min, self.highway, scenarios["highway"])
        return Size(
            min(self.lowest, scenarios["lowest"]), min(self.others, scenarios["others"]), (low, mid, high),
            min(self.changes, scenarios["changes"]),
        )  # fmt: skip


@dataclass(frozen=True)
class Job:
    """A part: episodes of a level and traffic, the scenes of a task, or lane changes at a level of the highway."""

    kind: Literal["episodes", "scenes", "changes"]
    engine: str
    task: str
    level: int = 0
    traffic: str = "regular"
    scenarios: int = 1

    @property
    def file(self) -> str:
        """Name of its file."""
        end = "parquet" if self.kind == "episodes" else "json.gz"
        return f"{self.kind}-{self.engine}-{self.task}-{self.level}-{self.traffic}.{end}"

    @property
    def is_reference(self) -> bool:
        """Whether highway-env drives it."""
        return ENGINES[self.engine].backend == "highway-env"

    @property
    def cost(self) -> float:
        """Rough processor time, to start long ones first."""
        episode = {"episodes": 10.0, "changes": 20.0, "scenes": 60.0}[self.kind]
        slow = 1.0 if self.is_reference else 0.05
        return slow * self.scenarios * episode * (8.0 if self.task == "highway" else 1.0) * (1 + self.level)


def plan(
    tasks: Sequence[str], size: Size, engines: Iterable[Engine], traffics: Sequence[str] = tuple(TRAFFICS)
) -> list[Job]:
    """Everything that some engines have to drive."""
    jobs = []
    for engine in engines:
        for task in tasks:
            only_bends = engine in (CONNECTED, V0)
            if only_bends and task in STRAIGHT:
                continue
            if engine != NATIVE and (not only_bends or task == "u-turn"):
                jobs.append(Job("scenes", engine.name, task))
            for level in range(1, len(TASKS[task].levels) + 1):
                n = size.of(task, level)
                for traffic in traffics:
                    if engine in (PATH, MATCHED, NATIVE) or (
                        traffic == "regular" and (not only_bends or level == 1)
                    ):
                        jobs.append(Job("episodes", engine.name, task, level, traffic, n))
                if task == "highway" and level in CHANGE_LEVELS:
                    jobs.append(Job("changes", engine.name, task, level, "regular", size.changes))
    return jobs


def run(job: Job, folder: Path) -> None:
    """Drive a job in this process, going on from what its file holds."""
    path = folder / job.file
    if job.kind == "episodes":
        _run_episodes(job, path)
    elif job.kind == "changes":
        from experiments.validation.changes import count

        done = read_json(path) if path.exists() else []
        engine = ENGINES[job.engine]
        for scenario in range(len(done), job.scenarios):
            done.append(count(engine.backend, job.level, scenario, **dict(engine.config)))
            write_json(path, done)
    elif not path.exists():
        from experiments.validation import dynamics

        engine = ENGINES[job.engine]
        motions = {}
        if engine not in (CONNECTED, V0):
            motions = dynamics.drive_task(engine.backend, job.task, **dict(engine.config))
        if job.task == "u-turn":
            motions["artefact"] = dynamics.drive(engine.backend, dynamics.artefact(), **dict(engine.config))
        placed = dynamics.placement_errors(job.task) if engine == MATCHED else {}
        write_json(path, {"motions": {k: m.as_dict() for k, m in motions.items()}, "placement": placed})


def _run_episodes(job: Job, path: Path) -> None:
    import pandas as pd

    from experiments.validation.episodes import episode, policies
    from experiments.validation.stage import open_env

    done = pd.read_parquet(path) if path.exists() else None
    first = 0 if done is None else int(done["scenario"].max()) + 1
    if first >= job.scenarios:
        return
    engine = ENGINES[job.engine]
    level = TASKS[job.task].levels[level_names(job.task)[job.level - 1]]
    env = open_env(engine.backend, job.task, {**level, **dict(engine.config)})
    rows = [
        episode(env, job.task, job.level, job.traffic, policy, scenario)
        for scenario in range(first, job.scenarios)
        for policy in policies(job.task)
    ]
    env.close()
    table = pd.DataFrame(rows).assign(engine=job.engine)
    if done is not None:
        table = pd.concat([done, table], ignore_index=True)
    write_file(path, parquet(table))


def parquet(table: pd.DataFrame) -> bytes:
    """The rows in small types: single precision is enough for means, and files stay small."""
    types: dict[str, str] = {name: "float32" for name in table.columns if table[name].dtype == "float64"}
    types |= {"level": "int8", "scenario": "int16", "length": "int16", "near_misses": "int16"}
    buffer = io.BytesIO()
    table.astype(types).to_parquet(buffer, index=False, compression="zstd")
    return buffer.getvalue()


def read_json(path: Path) -> Any:
    """The value in a compressed JSON file."""
    return json.loads(gzip.decompress(path.read_bytes()))


def write_json(path: Path, value: Any) -> None:
    """Write a value as compressed JSON: equal values give equal bytes."""
    write_file(path, gzip.compress(json.dumps(value, separators=(",", ":")).encode(), mtime=0))


def finished(job: Job, folder: Path) -> bool:
    """Whether the job's file is there with all that it asks for."""
    path = folder / job.file
    if not path.exists():
        return False
    if job.kind == "scenes":
        return True
    if job.kind == "changes":
        return len(read_json(path)) >= job.scenarios
    import pandas as pd

    return int(pd.read_parquet(path, columns=["scenario"])["scenario"].max()) + 1 >= job.scenarios


def run_all(jobs: Sequence[Job], folder: Path, workers: int, note: Callable[[int], None]) -> None:
    """Drive all jobs, in spawned processes. One sees one task only: highway-env's change each other's drivers.

    note: called with the number of jobs finished, whenever some are.
    """
    folder.mkdir(parents=True, exist_ok=True)
    groups: dict[tuple[object, ...], list[Job]] = {}
    for job in jobs:
        group = (job.kind, job.engine, job.task, job.level) if job.is_reference else (job.task,)
        groups.setdefault(group, []).append(job)
    ordered = sorted(groups.values(), key=lambda group: -sum(job.cost for job in group))
    context = multiprocessing.get_context("spawn")
    with context.Pool(workers, maxtasksperchild=1) as pool:
        for finished in pool.imap_unordered(_Run(folder), ordered, chunksize=1):
            note(finished)


@dataclass(frozen=True)
class _Run:
    """`run` with its folder, to be sent to another process."""

    folder: Path

    def __call__(self, group: list[Job]) -> int:
        os.nice(5)  # the reference takes long; leave the machine usable
        for job in group:
            run(job, self.folder)
        return len(group)
