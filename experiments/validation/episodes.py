"""Whole episodes in either simulator, one row of measures each. The same code measures both."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.rules import make_policy
from experiments.study.evaluate import play
from sumo_env.models.lane_table import lane_at
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.safety import DENSITY_RADIUS, headways
from sumo_env.scenario import Scenario
from sumo_env.scene import Scene
from sumo_env.tasks import get_task

POLICIES = ("idle", "random", "faster", "slower", "idm", "careful")
# The ego starts at the top of its ladder there, so that faster is idle.
SAME_AS_IDLE = {"two-way": ("faster",), "intersection": ("faster",)}
BIN = 0.25  # [s] of the headway histogram
BINS = 40  # the last one holds everything beyond 9.75 s
MEASURES = (
    "return", "crashed", "length", "arrived", "ego_speed", "traffic_speed", "headway", "gap", "ego_headway",
    "lane_changes", "density", "min_ttc", "near_misses",
)  # fmt: skip
FAR = 10.0  # [s] counted for an episode in which no collision ever came nearer


def policies(task: str) -> tuple[str, ...]:
    """The egos of a task."""
    return tuple(name for name in POLICIES if name not in SAME_AS_IDLE.get(task, ()))


@dataclass
class Recorder:
    """Measures the traffic near the ego at the start and after every policy step of an episode.

    Only vehicles within 200 m of the ego count: on the highway SUMO leaves out those that the ego cannot reach.
    """

    task: str
    road: Road
    speeds: list[float] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    ego_headways: list[float] = field(default_factory=list)
    ahead: list[float] = field(default_factory=list)
    flow: list[float] = field(default_factory=list)
    changes: int = 0
    vehicle_seconds: float = 0.0
    _lanes: dict[str, LaneIndex] = field(default_factory=dict)

    def see(self, scene: Scene) -> None:
        """Take one scene down."""
        dx, dy = scene.x - scene.x[0], scene.y - scene.y[0]
        near = (dx * dx + dy * dy <= DENSITY_RADIUS**2) & ~scene.crashed
        others = near.copy()
        others[0] = False
        self.speeds += scene.speed[others].tolist()
        headway = headways(
            np.ascontiguousarray(scene.x), np.ascontiguousarray(scene.y),
            np.ascontiguousarray(scene.speed), np.ascontiguousarray(scene.heading),
        )  # fmt: skip
        following = others & np.isfinite(headway)
        self.times += headway[following].tolist()
        self.gaps += (headway[following] * scene.speed[following]).tolist()
        if np.isfinite(headway[0]):
            self.ego_headways.append(float(headway[0]))
        ahead = others & (dx * np.cos(scene.heading[0]) + dy * np.sin(scene.heading[0]) > 0)
        self.ahead.append(ahead.sum() / (DENSITY_RADIUS / 1000))
        self.flow.append(scene.speed[ahead].sum() * 3.6 / (DENSITY_RADIUS / 1000))
        self._count_changes(scene, others)

    def _count_changes(self, scene: Scene, others: NDArray[np.bool_]) -> None:
        if self.task in ("two-way", "intersection"):
            return
        lanes = {scene.ids[row]: self._lane(scene, int(row)) for row in np.flatnonzero(others)}
        for name, lane in lanes.items():
            before = self._lanes.get(name)
            if before is not None:
                self.vehicle_seconds += 1.0
                self.changes += before[:2] == lane[:2] and before[2] != lane[2]
        self._lanes = lanes

    def _lane(self, scene: Scene, row: int) -> LaneIndex:
        x, y = float(scene.x[row]), float(scene.y[row])
        if self.task == "highway":
            return ("0", "1", min(max(round(y / 4.0), 0), self.road.count("0", "1") - 1))
        heading = float(scene.heading[row])
        return lane_at(self.road, x, y, heading)

    def row(self) -> dict[str, Any]:
        """What was seen: means over vehicles and steps, nan where there was nothing to see."""
        counts, _ = np.histogram(np.clip(self.times, 0, BIN * BINS - 1e-9), BINS, (0, BIN * BINS))
        return {
            "traffic_speed": mean(self.speeds),
            "headway": mean(np.clip(self.times, 0, BIN * BINS)),
            "gap": mean(self.gaps),
            "ego_headway": mean(np.clip(self.ego_headways, 0, BIN * BINS)),
            "lane_changes": 60 * self.changes / self.vehicle_seconds if self.vehicle_seconds else np.nan,
            "ahead": mean(self.ahead),  # vehicles ahead of the ego a km
            "flow": mean(self.flow),  # vehicles an hour there
            "headways": counts.astype(np.uint16).tolist(),
        }


def fingerprint(scenario: Scenario) -> int:
    """A number that tells scenarios apart by what is driven: places, speeds, drivers, later arrivals and events.

    Of the vehicles only the first five count: one of the simulators leaves out those that the ego cannot reach.
    """
    specs = (scenario.ego, *scenario.vehicles[:5], *(spawn.vehicle for spawn in scenario.spawns))
    drawn = [
        (v.id, v.lane, round(v.s, 6), round(v.speed, 6), round(v.target_speed, 6), v.destination,
         *(round(value, 6) for value in (v.driver.delta, v.driver.accel, v.driver.tau, v.driver.min_gap)))
        for v in specs
    ]  # fmt: skip
    events = [(round(event.time, 6), event.vehicle, event.kind) for event in scenario.events]
    return zlib.crc32(repr((drawn, events)).encode())


def mean(values: Any) -> float:
    """The mean, nan of nothing."""
    return float(np.mean(values)) if len(values) else float("nan")


def episode(env: Any, task: str, level: int, traffic: str, policy: str, scenario: int) -> dict[str, Any]:
    """Play test scenario number `scenario` and measure it."""
    inner = env.unwrapped
    recorder = Recorder(task, get_task(task).road(inner.config))
    played = play(
        env, make_policy(policy, env), task, level, traffic, scenario, lambda: recorder.see(inner.scene)
    )
    row = {
        "task": task, "level": level, "traffic": traffic, "policy": policy, "scenario": scenario,
        "drawn": fingerprint(inner.scenario),  # to be sure that pairs are pairs
        **{name: played[name] for name in ("return", "length", "crashed", "arrived", "density", "near_misses")},
        "ego_speed": played["mean_speed"],
        "min_ttc": min(played["min_ttc"], FAR),
        "crash_time": np.nan if played["crash_time"] is None else played["crash_time"],
    }  # fmt: skip
    return {**row, **recorder.row()}
