"""Whole episodes in any simulator, one row of measures each. The same code measures all of them.

The ego is measured as the study measures it (`play`), the other vehicles in ``env.unwrapped.scene`` at the start and
after every policy step. The egos are the rules of `agents`, and two that repeat a few actions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

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
        driving = near & ~scene.crashed
        density.append(int(near.sum()))
        speeds += scene.speed[driving].tolist()
        headway = headways(*map(np.ascontiguousarray, (scene.x, scene.y, scene.speed, scene.heading)))
        times += headway[driving & np.isfinite(headway)].tolist()
        if task not in WITHOUT_LANE_CHANGES:
            now = {
                scene.ids[row]: _lane(scene, int(row), task, road, lanes) for row in np.flatnonzero(driving)
            }
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


def _lane(scene: Scene, row: int, task: str, road: Road, lanes: Mapping[str, LaneIndex]) -> LaneIndex:
    """The lane of a vehicle, which was on one of `lanes` a step before."""
    x, y = scene.x.item(row), scene.y.item(row)
    if task == "highway":
        return ("0", "1", min(max(round(y / LANE_WIDTH), 0), road.count("0", "1") - 1))
    known = lanes.get(scene.ids[row])
    if known is not None and road.lane(known).on_lane(x, y):  # nearly always, and quickly told
        return known
    return road.closest_lane(x, y, scene.heading.item(row))


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
    inner, policy, scenes = env.unwrapped, make_ego(ego, env), []
    row = play(
        env, policy, task, level, traffic, scenario, lambda: scenes.append(inner.scene), options=options
    )
    ending = "time" if row["truncated"] else "left"
    road, interval = get_task(task).road(inner.config), 1.0 / inner.config["policy_frequency"]
    return {
        **row,
        "task": task,
        "level": level,
        "ego": ego,
        "outcome": next((name for name in ("crashed", "arrived") if row[name]), ending),
        "ego_speed": row["mean_speed"],
        **traffic_near(scenes, task, road, interval),
    }
