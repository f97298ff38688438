"""Traffic that is drawn for each episode on routes of a SUMO network, as SUMO's elements."""

import math
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np

from sumo_env.config import Config
from sumo_env.networks import files
from sumo_env.networks.lanes import VEHICLE_LENGTH
from sumo_env.networks.mapping import Network
from sumo_env.streams import stream
from sumo_env.tasks.base import Drivers, Task, ego_driver
from sumo_env.traffic.drivers import vehicle_type
from sumo_env.traffic.scenario import VehicleSpec

Routes = Sequence[tuple[str, Sequence[str]]]  # names, and edges
MARGIN = VEHICLE_LENGTH  # [m] that a vehicle keeps from both ends of an edge when it is placed
SPACING = 15.0  # [m] between centres when vehicles are placed
EGO_SPACING = 25.0  # [m] likewise, from the place where the ego departs


def elements(
    task: Task,
    network: Network,
    routes: Routes,
    config: Config,
    ego: VehicleSpec,
    begin: float,
    rng: np.random.Generator,
    seed: int,
) -> str:
    """Vehicles at random places of the routes at the start, and others that depart later, as SUMO's elements."""
    drivers = Drivers(task, {**config, "risk": 0.0}, seed)
    root = ElementTree.Element("additional")
    types: set[str] = set()

    def kind(driver: Any, name: str) -> str:
        if name not in types:
            types.add(name)
            ElementTree.SubElement(root, "vType", {"id": name, **vehicle_type(driver, task.calibration)})
        return name

    kind(ego_driver(task), "ego")
    for name, edges in routes:
        ElementTree.SubElement(root, "route", {"id": name, "edges": " ".join(edges)})
    vehicles: list[dict[str, str]] = []

    def add(id: str, route: str, depart: float, speed: str, **where: str) -> None:
        driver = drivers.next()
        when = {"depart": f"{depart:.3f}", "departSpeed": speed}
        vehicles.append({"id": id, "type": kind(driver, driver.type), "route": route, **when, **where})

    for number, place in enumerate(_places(network, routes, config, ego, rng)):
        route, edge, lane, front, speed = place
        where = {"departEdge": str(edge), "departLane": str(lane), "departPos": f"{front:.2f}"}
        add(f"v{number}", route, begin, f"{speed:.2f}", insertionChecks="none", **where)
    spawned, frequency = stream(seed, "spawns"), config["policy_frequency"]
    for step in range(1, math.ceil((config["duration"] + config["warm_up"]) * frequency) + 1):
        if spawned.random() < config["spawn_probability"] / frequency:
            route = routes[int(spawned.integers(len(routes)))][0]
            add(f"s{step}", route, begin + step / frequency, "max", departLane="free")
    for attributes in vehicles:
        ElementTree.SubElement(root, "vehicle", attributes)
    return ElementTree.tostring(root, "unicode")


def _places(
    network: Network, routes: Routes, config: Config, ego: VehicleSpec, rng: np.random.Generator
) -> list[tuple[str, int, int, float, float]]:
    """Route, number of its edge, SUMO's lane, place of the front [m] and speed [m/s] of each vehicle."""
    road = network.road
    roomy = {
        name: [k for k, edge in enumerate(way) if road.lane(files.lane(edge)).length >= 2 * MARGIN]
        for name, way in routes
    }
    routes = [(name, way) for name, way in routes if roomy[name]]
    centres: list[tuple[float, float]] = []
    found = []
    for _ in range(int(config["vehicles_count"]) if routes else 0):
        for _ in range(100):
            name, way = routes[int(rng.integers(len(routes)))]
            place = roomy[name][int(rng.integers(len(roomy[name])))]
            lanes = files.lanes_for(network, way[place])
            index = lanes[int(rng.integers(len(lanes)))]
            lane = road.lane(index)
            s = float(rng.uniform(MARGIN, max(lane.length - MARGIN, MARGIN + 0.1)))
            x, y = lane.position(s, 0.0)
            near = any(math.hypot(x - a, y - b) < SPACING for a, b in centres)
            if not near and math.hypot(x - ego.x, y - ego.y) >= EGO_SPACING:
                break
        else:  # the roads are full
            break
        centres.append((x, y))
        sumo_lane = network.lanes[index]
        front = min(s + VEHICLE_LENGTH / 2, lane.length - 0.1) * sumo_lane.length / lane.length
        speed = float(rng.uniform(0.5, 0.8)) * lane.speed_limit
        found.append((name, place, network.sumo_index(index), front, speed))
    return found
