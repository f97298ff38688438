"""Whole episodes in any simulator, one row of measures each. The same code measures all of them.

The ego is measured as the study measures it (`play`), the other vehicles in ``env.unwrapped.scene`` at the start and
after every policy step. The egos are the rules of `agents`, and two that repeat a few actions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.rules import Policy, make_policy
from agents.rules.constant import Constant
from experiments.study.evaluate import play
from sumo_env.contacts.measures import DENSITY_RADIUS, headways
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.scene import Scene
from sumo_env.tasks import get_task

# Averaged over in the checks "over egos"; the two-way road and the intersection start the ego at its top speed, so
# that "faster" would be "idle" again.
CORE = ("idle", "faster", "random", "careful", "idm")
MORE = ("slower", "pulsing", "weaving")
ALREADY_FASTEST = ("two-way", "intersection")
WITHOUT_WEAVING = ("intersection",)
CYCLES: dict[str, tuple[str, ...]] = {
    "pulsing": ("SLOWER", "IDLE", "FASTER", "FASTER", "IDLE", "SLOWER"),
    "weaving": ("LANE_LEFT", "IDLE", "LANE_RIGHT", "IDLE"),
}
PAIR = ["task", "level", "traffic", "ego", "scenario"]  # what names an episode in every simulator
BIN = 0.25  # [s] of the headway histogram
BINS = 40  # the last one holds everything beyond 9.75 s
HEADWAYS = [f"headway_{k:02d}" for k in range(BINS)]  # columns: observations in each bin
LANE_WIDTH = 4.0  # [m]
WITHOUT_LANE_CHANGES = ("two-way", "intersection")  # of the traffic
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
    without = {"faster"} if task in ALREADY_FASTEST else set()
    without |= {"weaving"} if task in WITHOUT_WEAVING else set()
    return tuple(name for name in (*CORE, *MORE) if name not in without)


def make_ego(name: str, env: Any) -> Policy:
    """The ego of this name for an environment."""
    if name not in CYCLES:
        return make_policy(name, env)
    numbers = {action: number for number, action in env.unwrapped.actions.items()}
    return Constant(*(numbers[action] for action in CYCLES[name]))


@dataclass
class Recorder:
    """Measures the traffic near the ego at the start and after every policy step of an episode.

    Only vehicles within 200 m of the ego count: on the highway some simulators leave out those that it cannot reach.
    """

    task: str
    road: Road
    interval: float  # [s] of a policy step
    speeds: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    density: list[int] = field(default_factory=list)
    changes: int = 0
    followed: int = 0  # pairs of successive scenes in which a vehicle's lane is known
    _lanes: dict[str, LaneIndex] = field(default_factory=dict)

    def see(self, scene: Scene) -> None:
        """Take one scene down."""
        near = np.hypot(scene.x - scene.x[0], scene.y - scene.y[0]) <= DENSITY_RADIUS
        near[0] = False
        driving = near & ~scene.crashed
        self.density.append(int(near.sum()))
        self.speeds += scene.speed[driving].tolist()
        headway = headways(*map(np.ascontiguousarray, (scene.x, scene.y, scene.speed, scene.heading)))
        self.times += headway[driving & np.isfinite(headway)].tolist()
        if self.task not in WITHOUT_LANE_CHANGES:
            self._count_changes(scene, driving)

    def _count_changes(self, scene: Scene, driving: NDArray[np.bool_]) -> None:
        lanes = {scene.ids[row]: self._lane(scene, int(row)) for row in np.flatnonzero(driving)}
        for name, lane in lanes.items():
            before = self._lanes.get(name)
            if before is not None:
                self.followed += 1
                self.changes += before[:2] == lane[:2] and before[2] != lane[2]
        self._lanes = lanes

    def _lane(self, scene: Scene, row: int) -> LaneIndex:
        x, y = scene.x.item(row), scene.y.item(row)
        if self.task == "highway":
            return ("0", "1", min(max(round(y / LANE_WIDTH), 0), self.road.count("0", "1") - 1))
        known = self._lanes.get(scene.ids[row])
        if known is not None and self.road.lane(known).on_lane(x, y):  # nearly always, and quickly told
            return known
        return self.road.closest_lane(x, y, scene.heading.item(row))

    def row(self) -> dict[str, Any]:
        """Means over vehicles and steps, nan where there was nothing to see."""
        counts, _ = np.histogram(np.clip(self.times, 0, BIN * BINS - 1e-9), BINS, (0, BIN * BINS))
        minutes = self.followed * self.interval / 60.0
        return {
            "traffic_speed": float(np.mean(self.speeds)) if self.speeds else math.nan,
            "lane_changes": self.changes / minutes if minutes else math.nan,
            "density": float(np.mean(self.density)),
            **dict(zip(HEADWAYS, counts.tolist(), strict=True)),
        }


def drive(
    env: Any,
    task: str,
    level: int,
    traffic: str,
    ego: str,
    scenario: int,
    options: Mapping[str, Any],
) -> dict[str, Any]:
    """Drive test scenario number `scenario` to its end and return its row of COLUMNS.

    Args:
        options: of `reset`, beside the dose of risk.
    """
    inner, policy = env.unwrapped, make_ego(ego, env)
    recorder = Recorder(task, get_task(task).road(inner.config), 1.0 / inner.config["policy_frequency"])
    row = play(
        env, policy, task, level, traffic, scenario, lambda: recorder.see(inner.scene), options=options
    )
    return {
        **{name: row[name] for name in ("traffic", "scenario", "return", "length", "crashed")},
        "task": task,
        "level": level,
        "ego": ego,
        "outcome": next(
            (name for name in ("crashed", "arrived") if row[name]), "time" if row["truncated"] else "left"
        ),
        "crash_time": math.nan if row["crash_time"] is None else row["crash_time"],
        "ego_speed": row["mean_speed"],
        **recorder.row(),
    }
