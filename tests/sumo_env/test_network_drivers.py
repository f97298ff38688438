"""Drivers on roads of bends and joins against highway-env's IDMVehicle.act, in random states of its own roads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from highway_env.envs import RoundaboutEnv, UTurnEnv
from highway_env.road.road import Road
from highway_env.vehicle.controller import MDPVehicle

from experiments.backends.highway_env_vehicle import PathVehicle
from sumo_env.models.lane_net import locate, net
from sumo_env.models.lane_table import lane_table
from sumo_env.models.network_drivers import NO_PLAN, drive
from sumo_env.networks.roads import ROADS

from .reference import randomise, state

NETWORKS = {"u-turn": UTurnEnv, "roundabout": RoundaboutEnv}
GOALS = {"u-turn": ("d",), "roundabout": ("sxr", "exr", "nxr")}


def traffic(task: str, rng: np.random.Generator, count: int) -> tuple[Road, dict[str, Any]]:
    """An ego (row 0) and drivers anywhere on their ways, some changing lane; and the arguments of `drive`."""
    road = Road(NETWORKS[task]().road.network, neighbour_vehicles_connected_lanes=True)
    ours = ROADS[task]()
    table = lane_table(ours.lanes)
    drivers, ways, legs, planned, targets = [], [], [], [], []
    for k in range(count):
        start = list(ours.lanes)[rng.integers(len(ours.lanes))]
        goal = str(rng.choice(GOALS[task]))
        way = ours.way(start, goal)
        leg = int(rng.integers(min(len(way), 3)))
        lane = road.network.get_lane(way[leg])
        s = rng.uniform(0.0, min(lane.length, 40.0))
        if rng.random() < 0.5:
            s = lane.length - rng.uniform(0.0, 8.0)
        kind = MDPVehicle if k == 0 else PathVehicle
        vehicle = kind(
            road, lane.position(s, rng.normal() * 0.8), lane.heading_at(s) + 0.1 * rng.normal(), rng.uniform(0, 18)
        )
        vehicle.target_speed = rng.uniform(5, 22)
        vehicle.timer = rng.uniform(0.5, 1.5)
        vehicle.route = [way[0]] + [(a, b, None) for a, b, _ in way[1:]]
        vehicle.route = vehicle.route[leg:]
        vehicle.target_lane_index = way[leg]
        side = ours.side_lanes(way[leg])
        if side and rng.random() < 0.3:
            vehicle.target_lane_index = side[0]
        road.vehicles.append(vehicle)
        drivers.append(randomise(vehicle, rng))
        ways.append([table.index[a, b, 0] for a, b, _ in way] + [-1] * (14 - len(way)))
        legs.append(leg)
        planned.append(way[0][2] if leg == 0 else NO_PLAN)
        targets.append(table.index[vehicle.target_lane_index])
    acts = np.arange(count) > 0
    arguments = state(road.vehicles) | {
        "roads": net(table), "ways": np.array(ways), "leg": np.array(legs), "planned": np.array(planned),
        "lane": np.zeros(count, np.int64), "target": np.array(targets), "drivers": np.array(drivers),
        "timer": np.array([v.timer for v in road.vehicles]), "acts": acts, "changes": acts.copy(),
    }  # fmt: skip
    return road, arguments


def command(arguments: dict[str, Any]) -> np.ndarray:
    """The accelerations of vehicles that have moved [m/s2]."""
    roads, lane, x, y, heading = (arguments[name] for name in ("roads", "lane", "x", "y", "heading"))
    s = np.full((len(x), len(roads.geometry)), np.nan)
    on, acceleration = np.zeros(s.shape, np.bool_), np.zeros(len(x))
    locate(roads, x, y, heading, lane, True, s, on)
    drive(**arguments, s=s, on=on, acceleration=acceleration)
    return acceleration


@pytest.mark.parametrize("task", NETWORKS)
def test_drivers_do_what_highway_env_does(task: str) -> None:
    """Lanes, decisions on lane changes, giving up, timers, the next lane of the way, and accelerations."""
    rng = np.random.default_rng(3)
    names = list(ROADS[task]().lanes)
    changed = given_up = moved_on = 0
    for _ in range(120):
        road, arguments = traffic(task, rng, 14)
        before = arguments["target"].copy()
        acceleration = command(arguments)
        assert [names[k] for k in arguments["lane"]] == [v.lane_index for v in road.vehicles]
        for vehicle in road.vehicles[1:]:
            vehicle.act()
        assert [names[k] for k in arguments["target"]] == [v.target_lane_index for v in road.vehicles]
        np.testing.assert_array_equal(arguments["timer"], [v.timer for v in road.vehicles])
        expected = [v.action["acceleration"] for v in road.vehicles[1:]]
        np.testing.assert_allclose(acceleration[1:], expected, rtol=1e-7, atol=1e-7)
        route = [NO_PLAN if not v.route or v.route[0][2] is None else v.route[0][2] for v in road.vehicles]
        assert arguments["planned"][1:].tolist() == route[1:]
        for k, was in enumerate(before):
            now = int(arguments["target"][k])
            if names[now][:2] != names[was][:2]:
                moved_on += 1
            elif now != was:
                changed += bool(arguments["lane"][k] == was)
                given_up += bool(arguments["lane"][k] == now)
    assert changed > 10 and given_up > 5 and moved_on > 40
