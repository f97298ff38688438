"""One car alone drives every route in SUMO: placed where highway-env has it, never slowed, to its exit."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Sequence
from typing import Any

import pytest

from sumo_env.networks.mapping import Network, network
from sumo_env.networks.roads import road
from sumo_env.tasks import TASKS
from tests.tasks import every_task

pytest.importorskip("libsumo")
STEP = 0.1  # [s]


def _speed(task: str) -> float:
    """The highest that somebody drives [m/s]: the limit, or the ego."""
    limits = [lane.speed_limit for lane in network(road(task)).road.lanes.values()]
    return max(*limits, *TASKS[task].target_speeds)


def _leads(net: Network, lane: str, edges: Sequence[str]) -> bool:
    """Whether a lane leads along the edges of a route without a change of lanes; those inside a crossing do."""
    lanes, edge = {lane}, lane.rpartition("_")[0]
    for following in edges[edges.index(edge) + 1 :] if edge in edges else ():
        joints = {joint for name in lanes for joint in net.sumo_lanes[name].following}
        after = {net.sumo_lanes[joint].following[0] for joint in joints}
        lanes = {name for name in after if name.rpartition("_")[0] == following}
    return bool(lanes)


def _drive(task: str) -> list[dict]:
    """Drive each route from each lane, one car at a time; in another process, which has no other simulation."""
    import libsumo

    net, speed = network(road(task)), _speed(task)
    options = ["--step-length", str(STEP), "--no-step-log", "--collision.check-junctions"]
    libsumo.start(["sumo", "-n", str(net.net_file), *options])
    for key, edges in net.routes.items():
        libsumo.route.add(key, list(edges))

    def centre(car: str) -> tuple[float, float]:
        x, y = libsumo.vehicle.getPosition(car)
        heading = math.radians(90 - libsumo.vehicle.getAngle(car))
        return x - 2.5 * math.cos(heading), -(y - 2.5 * math.sin(heading))

    records = []
    for index, lane in net.road.lanes.items():
        if (task, index) == ("two-way", ("a", "b", 0)) or lane.forbidden:
            continue  # no lane of SUMO's, and a ramp, at whose end stands who does not change lanes
        for key in [key for key in net.routes if key.startswith(f"{index[0]}-{index[1]}>")]:
            if not _leads(net, net.lanes[index].id, net.routes[key]):
                continue  # where lanes part, this one leads to another end
            car, destination, s = f"{index} {key}", key.split(">")[1], min(lane.length / 2, 60.0)
            route, start, position = net.place(index, s, destination)
            libsumo.vehicle.add(car, route, departSpeed="5")
            libsumo.vehicle.setSpeedMode(car, 32)  # nothing holds it up
            libsumo.vehicle.setLaneChangeMode(car, 0)
            libsumo.vehicle.moveTo(car, start, position)
            libsumo.vehicle.setSpeed(car, speed)
            record: dict[str, Any] = {
                "car": car,
                "slowest": math.inf,
                "aside": 0.0,
                "last": net.routes[route][-1],
            }
            record["misplaced"] = math.dist(centre(car), lane.position(s, 0.0))
            for _ in range(150):  # 15 s, the longest episode but the highway's
                libsumo.simulationStep()
                if car not in libsumo.vehicle.getIDList():
                    record["vanished"] = True
                    break
                record["slowest"] = min(record["slowest"], libsumo.vehicle.getSpeed(car))
                x, y = libsumo.vehicle.getPosition(car)
                here = libsumo.vehicle.getLaneID(car)
                if not (here.startswith(":") and task in ("roundabout", "u-turn")):
                    aside = net.road.lane(net.indices[here]).local_coordinates(x, -y)[1]
                    record["aside"] = max(record["aside"], abs(aside))
            record["edge"] = libsumo.vehicle.getRoadID(car)
            libsumo.vehicle.remove(car)
            libsumo.simulationStep()
            records.append(record)
    libsumo.close()
    return records


# [m] In bends the body is a chord of the lane, its centre inside the curve: by 0.36 m at a radius of 9 m.
BEND = 0.37
MISPLACED = {"highway": 1e-6, "two-way": 1e-6, "roundabout": 0.2, "u-turn": 0.17, "merge": 0.1}


@pytest.fixture(scope="module")
def elsewhere():
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        yield pool


@every_task
def test_every_route_is_driven_where_highway_env_has_it_at_full_speed_to_its_end(task, elsewhere):
    drives = elsewhere.apply(_drive, [task])
    assert drives
    for record in drives:
        assert "vanished" not in record and record["edge"] == record["last"], record
        assert record["slowest"] == pytest.approx(_speed(task)), record
        assert record["aside"] < 0.02 and record["misplaced"] < MISPLACED.get(task, BEND), record
