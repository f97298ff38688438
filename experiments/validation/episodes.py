"""Whole episodes in any simulator, one row of measures each, driven in parallel processes and resumable.

The ego is measured as the study measures it (`play`), the other vehicles in ``env.unwrapped.scene`` at the start and
after every policy step. The egos are the rules of `agents`, two that repeat a few actions, and the published agents.
Each `Part` of the episodes is a file of its own, which the study's runner has written.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from agents import pretrained
from agents.rules import Policy, make_policy
from agents.rules.constant import Constant
from experiments.backends import make_env
from experiments.study.compute.batches import Batch, driven, named
from experiments.study.compute.evaluate import Drive, play
from experiments.study.compute.progress import LENGTH, STEP
from experiments.study.design.arms import stream_seed
from experiments.study.design.fingerprint import dynamics
from experiments.study.design.levels import level_names
from experiments.study.design.sheet import sheet
from experiments.study.design.traffic import AT_A_DOSE
from sumo_env.contacts.measures import DENSITY_RADIUS, headways
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.scene import Scene, is_obstacle
from sumo_env.tasks import TASKS

CORE = ("idle", "faster", "random", "careful", "idm")  # averaged over in the checks "over egos"
MORE = ("slower", "pulsing", "weaving")
AGENTS = ("control", "treatment")  # published agents, where a setting has them
CYCLES: dict[str, tuple[str, ...]] = {
    "pulsing": ("SLOWER", "IDLE", "FASTER", "FASTER", "IDLE", "SLOWER"),
    "weaving": ("LANE_LEFT", "IDLE", "LANE_RIGHT", "IDLE"),
}
PAIR = ["task", "level", "traffic", "ego", "scenario"]  # what names an episode in every simulator
BIN = 0.25  # [s] of the headway histogram
BINS = 40  # the last one holds everything beyond 9.75 s
HEADWAYS = [f"headway_{k:02d}" for k in range(BINS)]  # columns: observations in each bin
SIZE = 25  # scenarios in a part
START = 1.5  # [s] of a part before its first episode, for the progress line
# Columns of the table of episodes, with their types.
COLUMNS: dict[str, str] = {
    "task": "str",
    "level": "int8",
    "traffic": "str",  # "regular" or "risky"
    "ego": "str",
    "scenario": "int16",
    "return": "float32",
    "length": "int16",  # policy steps
    "crashed": "bool",
    "outcome": "str",  # "crashed", "arrived", "time" or "left" (the road)
    "crash_time": "float32",  # [s], nan without a crash
    "ego_speed": "float32",  # [m/s], mean over the steps
    "traffic_speed": "float32",  # [m/s], mean over the other vehicles within 200 m and the steps
    "lane_changes": "float32",  # per vehicle-minute
    "density": "float32",  # other vehicles within 200 m, mean over the steps
    **dict.fromkeys(HEADWAYS, "uint16"),
}


def egos(task: str) -> tuple[str, ...]:
    """Names of the egos of a task, those of CORE first."""
    return tuple(name for name in (*CORE, *MORE) if name not in sheet(task).egos_without)


def setting(task: str, level: int) -> str:
    """The name of a task's traffic level among the published agents."""
    return f"{task}-{level_names(task)[level - 1]}"


def agents(task: str, level: int) -> tuple[str, ...]:
    """Names of the published agents of a setting that are egos."""
    published = pretrained.cards()
    return tuple(name for name in AGENTS if f"{setting(task, level)}/{name}" in published)


def make_ego(name: str, env: Any, level: int) -> Policy:
    """The ego of this name for an environment with traffic of this level."""
    if name in AGENTS:
        return pretrained.load(setting(env.unwrapped.task.name, level), name)
    if name not in CYCLES:
        return make_policy(name, env)
    numbers = {action: number for number, action in env.unwrapped.actions.items()}
    return Constant(*(numbers[action] for action in CYCLES[name]))


def traffic_near(scenes: Sequence[Scene], task: str, road: Road, interval: float) -> dict[str, float]:
    """What the traffic near the ego did in an episode: the mean speed, lane changes, density and HEADWAYS of a row.

    Means over vehicles and steps, nan where there was nothing to see. Only vehicles within 200 m of the ego count: on
    the highway some simulators leave out those that it cannot reach.

    Args:
        scenes: at the start and after every policy step, which takes `interval` [s].
    """
    speeds: list[float] = []
    times: list[float] = []
    density = []
    changed: list[bool] = []  # in pairs of successive scenes in which a vehicle's lane is known
    lanes: dict[str, LaneIndex] = {}
    for scene in scenes:
        near = np.hypot(scene.x - scene.x[0], scene.y - scene.y[0]) <= DENSITY_RADIUS
        near[0] = False
        near[[row for row, name in enumerate(scene.ids) if is_obstacle(name)]] = False
        driving = near & ~scene.crashed
        density.append(int(near.sum()))
        speeds += scene.speed[driving].tolist()
        headway = headways(*map(np.ascontiguousarray, (scene.x, scene.y, scene.speed, scene.heading)))
        times += headway[driving & np.isfinite(headway)].tolist()
        if sheet(task).lane_changes:
            rows = np.flatnonzero(driving).tolist()
            now = {scene.ids[row]: _lane(scene, row, road, lanes) for row in rows}
            pairs = [(lanes[name], lane) for name, lane in now.items() if name in lanes]
            changed += [before[:2] == lane[:2] and before[2] != lane[2] for before, lane in pairs]
            lanes = now
    counts, _ = np.histogram(np.clip(times, 0, BIN * BINS - 1e-9), BINS, (0, BIN * BINS))
    minutes = len(changed) * interval / 60.0
    return {
        "traffic_speed": float(np.mean(speeds)) if speeds else math.nan,
        "lane_changes": sum(changed) / minutes if minutes else math.nan,
        "density": float(np.mean(density)),
        **dict(zip(HEADWAYS, counts.tolist(), strict=True)),
    }


def _lane(scene: Scene, row: int, road: Road, lanes: Mapping[str, LaneIndex]) -> LaneIndex:
    """The lane of a vehicle, which was on one of `lanes` a step before."""
    x, y = scene.x.item(row), scene.y.item(row)
    known = lanes.get(scene.ids[row])
    if known is not None and road.lane(known).on_lane(x, y):  # nearly always, and quickly told
        return known
    return road.closest_lane(x, y, scene.heading.item(row))


@dataclass(frozen=True)
class Engine:
    """A simulator with its settings.

    name: how tables call it. config: changes of a task's configuration. options: of `reset`, more than the dose of
    risk (highway-env itself has none). one_in: drives a random episode in so many. egos: AGENTS, or rules, all of the
    task's if empty.
    """

    name: str
    backend: str
    config: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    one_in: int = 1
    egos: tuple[str, ...] = ()


@dataclass(frozen=True)
class Part(Batch):
    """The episodes of some scenarios of a level and traffic, by all egos of an engine."""

    engine: Engine
    task: str
    level: int
    traffic: str
    scenarios: range
    columns = COLUMNS

    @cached_property
    def name(self) -> str:
        """By engine, task, level, traffic and first scenario."""
        one, numbers = self.engine, self.scenarios
        label = f"{one.name.replace(' ', '-')}-{self.task}-{self.level}-{self.traffic}-{numbers[0]:03d}"
        does = dynamics(one.backend, self.task)
        return named(label, {**asdict(one), "dynamics": does, "scenarios": len(numbers)})

    @property
    def size(self) -> float:
        """Expected time [s]."""
        return START + len(self.each()) * LENGTH * STEP[self.engine.backend]

    def each(self) -> list[tuple[int, str]]:
        """Scenario and ego of each episode."""
        asked = self.engine.egos
        known = agents(self.task, self.level) if asked == AGENTS else egos(self.task)
        return [
            (scenario, ego)
            for scenario in self.scenarios
            for ego in known
            if not asked or ego in asked
            if self.engine.one_in == 1 or self._is_drawn(scenario, ego)
        ]

    def _is_drawn(self, scenario: int, ego: str) -> bool:
        drawn = stream_seed("recomputed episode", self.task, self.level, self.traffic, scenario, ego)
        return drawn % self.engine.one_in == 0

    @property
    def episodes(self) -> dict[str, list[Any]]:
        """What names them, by the columns of PAIR."""
        rows = [(self.task, self.level, self.traffic, ego, scenario) for scenario, ego in self.each()]
        return {name: [row[k] for row in rows] for k, name in enumerate(PAIR)}

    def drive(self) -> Iterator[dict[str, Any]]:
        """Drive them."""
        level = TASKS[self.task].levels[level_names(self.task)[self.level - 1]]
        if self.engine.egos == AGENTS:
            level = pretrained.card(setting(self.task, self.level), AGENTS[0])["config"]
        with closing(make_env(self.engine.backend, self.task, {**level, **self.engine.config})) as env:
            for episode in self.each():
                yield self._row(env, *episode)

    def _row(self, env: Any, scenario: int, ego: str) -> dict[str, Any]:
        inner, scenes = env.unwrapped, []
        drive = Drive(self.task, self.level, self.traffic, scenario)
        risky = AT_A_DOSE[self.traffic] > 0.0  # at 0 there is nothing that its rates and ranges could change
        options = {
            name: own for name, own in self.engine.options.items() if risky or not name.startswith("risk_")
        }
        row = play(
            env, make_ego(ego, env, self.level), drive, lambda: scenes.append(inner.scene), options=options
        )
        ending = "time" if row["truncated"] else "left"
        road, interval = TASKS[self.task].road(inner.config), 1.0 / inner.config["policy_frequency"]
        return {
            **row,
            "task": self.task,
            "level": self.level,
            "ego": ego,
            "outcome": next((name for name in ("crashed", "arrived") if row[name]), ending),
            "ego_speed": row["mean_speed"],
            **traffic_near(scenes, self.task, road, interval),
        }


def plan(
    engines: Iterable[Engine], levels: Mapping[str, Sequence[int]], traffics: Sequence[str], scenarios: range
) -> list[Part]:
    """Everything that the engines have to drive, SIZE scenarios in a part.

    On roads without joins, engines that differ only in how far drivers see beyond a join are not driven, nor published
    agents in settings that have none.
    """
    parts = [
        Part(Path(), engine, task, level, traffic, scenarios[first : first + SIZE])
        for engine in engines
        for task, numbers in levels.items()
        if TASKS[task].road(TASKS[task].defaults).joined
        or engine.config.get("variant") not in ("v0", "connected")
        for level in numbers
        for traffic in traffics
        for first in range(0, len(scenarios), SIZE)
    ]
    return [part for part in parts if part.engine.egos != AGENTS or agents(part.task, part.level)]


def run(parts: Sequence[Part], directory: Path, workers: int) -> pd.DataFrame:
    """Drive the parts whose files are not there yet, in processes, and return the table of all episodes.

    Returns:
        COLUMNS, and the name of the engine as the column ``engine``.

    Raises:
        UserError: a part failed. What is finished stays, and the same call goes on from there.
    """
    rows = driven([replace(part, directory=directory) for part in parts], "local", workers, "parts")
    return rows.assign(engine=[part.engine.name for part in parts for _ in part.each()])
