"""The grid of lanes leaves out no lane that is near, and the closest lane found with it is the closest of all."""

from __future__ import annotations

import numpy as np
import pytest

from sumo_env.models.idm import NEAR
from sumo_env.models.lane_grid import CELL, cell, lane_grid
from sumo_env.models.lane_net import locate, net
from sumo_env.models.lane_table import LENGTH, compiled_lanes, lane_table, local_coordinates
from sumo_env.networks.roads import ROADS

BEYOND, BESIDE = 5.0, 3.0  # [m]


@pytest.mark.parametrize("task", ["two-way", "roundabout", "intersection", "u-turn"])
def test_every_lane_that_is_near_is_found(task: str) -> None:
    table = lane_table(ROADS[task]().lanes)
    corner, near = lane_grid(table.geometry, BEYOND, BESIDE)
    high = corner + CELL * np.array(near.shape[:2])
    rng = np.random.default_rng(3)
    found = 0
    for x, y in rng.uniform(corner - 20.0, high + 20.0, (20_000, 2)):
        listed = [lane for lane in near[cell(corner, near, x, y)].tolist() if lane >= 0]
        assert listed == sorted(set(listed))
        for lane in range(len(table.geometry)):
            s, lat = local_coordinates(table.geometry, lane, x, y)
            if abs(lat) <= BESIDE and -BEYOND <= s < table.geometry[lane, LENGTH] + BEYOND:
                assert lane in listed
                found += 1
    assert found > 500


@pytest.mark.parametrize("task", ["roundabout", "intersection", "u-turn"])
def test_cars_are_located_as_by_looking_at_all_lanes(task: str) -> None:
    road = ROADS[task]()
    roads = net(compiled_lanes(road))
    names = list(road.lanes)
    rng = np.random.default_rng(4)
    x, y, heading = [], [], []
    for k in range(400):  # on a lane, beside one, and anywhere
        lane = road.lanes[names[k % len(names)]]
        s = rng.uniform(-8.0, lane.length + 8.0)
        px, py = lane.position(s, rng.normal(0.0, 0.5 + k / 50.0))
        x.append(px), y.append(py), heading.append(lane.heading_at(s) + rng.normal(0.0, 0.5))
    closest = np.zeros(len(x), np.int64)
    s, on = np.full((len(x), len(names)), np.nan), np.zeros((len(x), len(names)), np.bool_)
    locate(roads, np.array(x), np.array(y), np.array(heading), closest, True, s, on)
    for j in range(len(x)):
        for number in range(len(names)):
            along, lat = local_coordinates(roads.geometry, number, x[j], y[j])
            length = roads.geometry[number, LENGTH]
            assert on[j, number] == (abs(lat) <= NEAR and -5.0 <= along < length + 5.0)
            assert np.isnan(s[j, number]) or s[j, number] == along
        expected = road.closest_lane(x[j], y[j], heading[j])
        chosen = road.lanes[names[closest[j]]].distance_with_heading(x[j], y[j], heading[j])
        assert chosen == pytest.approx(road.lanes[expected].distance_with_heading(x[j], y[j], heading[j]), abs=1e-9)
    assert on.sum() > 300
