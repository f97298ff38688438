"""Scenes without chance: the same few vehicles in both simulators, compared metre by metre.

The leader of a car-following scene is the ego, because its speed can be commanded alike in both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.validation.stage import FREQUENCY, Motion, Place, Scene, drive, motion, scenario_of, staged
from sumo_env.networks.mapping import network
from sumo_env.tasks import TASKS, get_task

LANE = ("0", "1", 0)
ONE_LANE = {"lanes_count": 1, "action": {"type": "DiscreteMetaAction", "target_speeds": [0, 10, 20, 30]}}
LADDER = {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10, 15, 20]}
OWN = ("a", "b", 1)
# (road, where the ego starts) of each task, for scenes in which it is alone
START: dict[str, Place] = {
    "highway": Place(("0", "1", 1), 100.0, 25.0),
    "two-way": Place(OWN, 30.0, 25.0),
    "roundabout": Place(("ser", "ses", 0), 5.0, 8.0, destination="nxs"),
    "intersection": Place(("o0", "ir0", 0), 5.0, 4.5, destination="o1"),
    "u-turn": Place(("a", "b", 0), 0.0, 16.0, destination="d"),
}
MIDDLE = {"highway": 25.0, "two-way": 25.0, "roundabout": 8.0, "intersection": 4.5, "u-turn": 16.0}


def following() -> list[Scene]:
    """Cars behind the ego: approach, stop and go, braking to a stop, on every kind of road."""
    platoon = tuple(Place(LANE, 300.0 - 35.0 * k, 20.0, 25.0) for k in range(1, 7))
    stop_and_go = ((2.0, "SLOWER"), (5.0, "SLOWER"), (10.0, "FASTER"), (14.0, "FASTER"))
    return [
        Scene("approach", "highway", Place(LANE, 300.0, 10.0), (Place(LANE, 150.0, 25.0),),
              seconds=20.0, config=ONE_LANE),
        Scene("stop and go", "highway", Place(LANE, 300.0, 20.0), platoon, stop_and_go, 28.0, ONE_LANE),
        Scene("braking to a stop", "highway", Place(LANE, 300.0, 0.0), (Place(LANE, 200.0, 25.0),),
              seconds=15.0, config=ONE_LANE),
        Scene("approach", "two-way", Place(OWN, 200.0, 10.0), (Place(OWN, 100.0, 24.0),),
              ((6.0, "SLOWER"),), 15.0, {"action": LADDER}),
        Scene("through the bend", "u-turn", Place(("a", "b", 1), 90.0, 10.0, destination="d"),
              (Place(("a", "b", 1), 55.0, 14.0, destination="d"),), ((8.0, "SLOWER"),), 14.0,
              {"action": LADDER}),
        Scene("into the ring", "roundabout", Place(("ser", "ses", 0), 95.0, 10.0, destination="nxs"),
              (Place(("ser", "ses", 0), 60.0, 14.0, destination="nxs"),), ((9.0, "SLOWER"),), 13.0,
              {"action": LADDER}),
        Scene("through the junction", "intersection", Place(("o0", "ir0", 0), 60.0, 9.0, destination="o1"),
              (Place(("o0", "ir0", 0), 35.0, 8.0, 10.0, destination="o1"),), ((7.0, "SLOWER"),), 12.0),
    ]  # fmt: skip


def ladders() -> list[Scene]:
    """FASTER and SLOWER from the middle rung, the ego alone."""
    scenes = []
    for task, place in START.items():
        for action in ("FASTER", "SLOWER"):
            scenes.append(Scene(action, task, place, actions=((0.0, action),), seconds=4.0))
    return scenes


def lane_changes() -> list[Scene]:
    """One lane change at every speed of the ladders, on straight roads."""
    scenes = [
        Scene(f"{action} at {speed:g} m/s", "highway", Place(("0", "1", 1), 100.0, speed),
              actions=((0.0, action),), seconds=4.0)
        for speed in (20.0, 25.0, 30.0) for action in ("LANE_LEFT", "LANE_RIGHT")
    ]  # fmt: skip
    scenes += [
        Scene(f"LANE_LEFT at {speed:g} m/s", "two-way", Place(OWN, 30.0, speed),
              actions=((0.0, "LANE_LEFT"),), seconds=4.0)
        for speed in (20.0, 30.0)
    ]  # fmt: skip
    scenes += [
        Scene(f"LANE_RIGHT at {speed:g} m/s", "u-turn", Place(("a", "b", 0), 0.0, speed, destination="d"),
              actions=((0.0, "LANE_RIGHT"),), seconds=4.0)
        for speed in (8.0, 16.0, 24.0)
    ]  # fmt: skip
    return scenes


def turns() -> list[Scene]:
    """The ego alone through every bend, at the middle and at the highest rung."""
    starts = {
        "roundabout": (Place(("ser", "ses", 0), 105.0, 8.0, destination="nxs"), 11.0),
        "intersection": (Place(("o0", "ir0", 0), 75.0, 9.0, destination="o1"), 8.0),
        "u-turn": (Place(("a", "b", 0), 90.0, 16.0, destination="d"), 9.0),
    }
    scenes = []
    for task, (place, seconds) in starts.items():
        for rung in (1, 2):
            speed = TASKS[task].target_speeds[rung]
            start = Place(place.lane, place.s, speed, destination=place.destination)
            scenes.append(
                Scene(
                    f"turning at {speed:g} m/s",
                    task,
                    start,
                    seconds=seconds * 8.0 / max(speed, 8.0) if task == "roundabout" else seconds,
                )
            )
    return scenes  # fmt: skip


def bends() -> list[Scene]:
    """One other vehicle alone through a bend, the ego far away and slow."""
    return [
        Scene("other car in the bend, inner lane", "u-turn", Place(("a", "b", 1), 0.0, 8.0, destination="d"),
              (Place(("a", "b", 0), 100.0, 14.0, destination="d"),), seconds=8.0),
        Scene("other car in the bend, outer lane", "u-turn", Place(("a", "b", 0), 0.0, 8.0, destination="d"),
              (Place(("a", "b", 1), 100.0, 14.0, destination="d"),), seconds=8.0),
        Scene("other car in the ring, inner lane", "roundabout", Place(("ser", "ses", 0), 5.0, 0.0, destination="nxs"),
              (Place(("we", "sx", 0), 5.0, 14.0, destination="nxr"),), seconds=6.0),
        Scene("other car in the ring, outer lane", "roundabout", Place(("ser", "ses", 0), 5.0, 0.0, destination="nxs"),
              (Place(("we", "sx", 1), 5.0, 14.0, destination="nxr"),), seconds=6.0),
        Scene("other car turning left", "intersection", Place(("o2", "ir2", 0), 5.0, 0.0, destination="o1"),
              (Place(("o0", "ir0", 0), 70.0, 8.0, destination="o1"),), seconds=9.0),
        Scene("other car turning right", "intersection", Place(("o2", "ir2", 0), 5.0, 0.0, destination="o1"),
              (Place(("o0", "ir0", 0), 70.0, 8.0, destination="o3"),), seconds=9.0),
    ]  # fmt: skip


SCENES: Mapping[str, Callable[[], list[Scene]]] = {
    "following": following,
    "ladder": ladders,
    "lane change": lane_changes,
    "turn": turns,
    "bend": bends,
}


def key(kind: str, scene: Scene) -> str:
    """Name of a scene among all."""
    return f"{kind} | {scene.task} | {scene.name}"


def drive_task(backend: str, task: str, **config: Any) -> dict[str, Motion]:
    """Every scene of a task, driven in one simulator."""
    return {
        key(kind, scene): drive(backend, scene, **config)
        for kind, scenes in SCENES.items()
        for scene in scenes()
        if scene.task == task
    }


def artefact() -> Scene:
    """A car that follows another one into the u-turn: stock connected lanes see the leader come nearer."""
    return Scene(
        "projection artefact", "u-turn", Place(("a", "b", 1), 0.0, 8.0, destination="d"),
        (Place(("b", "c", 0), 45.0, 10.0, destination="d"), Place(("a", "b", 0), 80.0, 14.0, destination="d")),
        seconds=9.0,
    )  # fmt: skip


def placement_errors(task: str) -> dict[str, float]:
    """How far from its place a vehicle stands after a reset in SUMO, the largest on each lane [m]."""
    from experiments.backends import make_env

    env = make_env("sumo", task)
    inner: Any = env.unwrapped
    road = get_task(task).road(inner.config)
    net = network(task)
    worst: dict[str, float] = {}
    for index, lane in road.lanes.items():
        if task == "two-way" and index == ("a", "b", 0):
            continue  # nobody starts in the oncoming lane
        end = min(lane.length, 400.0)
        routes = [name.split(">")[1] for name in net.routes if name.startswith(f"{index[0]}-{index[1]}>")]
        goal = index[1] if task == "highway" else (routes[0] if routes else index[1].replace("il", "o"))
        places = tuple(
            Place(index, float(s), 8.0, destination=None if task in ("highway", "two-way") else goal)
            for s in np.linspace(min(3.0, end / 4), end - min(3.0, end / 4), 6)
        )
        scene = Scene("placement", task, START[task], places)
        inner.task = staged(task, scene)
        env.reset(seed=0)
        wanted = scenario_of(scene, inner.config)
        x, y = sumo_positions(inner)
        worst["-".join(map(str, index))] = max(
            float(np.hypot(x[inner.scene.ids.index(spec.id)] - spec.x, y[inner.scene.ids.index(spec.id)] - spec.y))
            for spec in wanted.vehicles
        )
    env.close()
    return worst


def sumo_positions(env: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres of SUMO's own cars [m], shape (n,) each; the scene shows where they were steered."""
    n = len(env.scene.ids)
    state = np.empty((4, n))
    fleet = env._world.sim.fleet(env.scene.ids)
    fleet.read(state, np.empty((3, n)), np.empty(n, np.int64), np.full(n, np.nan))
    return state[0], state[1]


def common(sumo: Motion, reference: Motion, step: float = 0.2) -> NDArray[np.float64]:
    """Times at which two motions are compared [s]."""
    return np.arange(0.0, min(sumo.time[-1], reference.time[-1]) + 1e-9, step)


__all__ = ["FREQUENCY", "SCENES", "artefact", "common", "drive", "drive_task", "motion", "placement_errors"]
