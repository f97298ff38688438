"""Lanes as numbers: the same geometry as `sumo_env.networks.lanes`, and progress along a route."""

from __future__ import annotations

import numpy as np
import pytest

from sumo_env.models.lane_table import (
    advance,
    closest_lane,
    heading_at,
    lane_table,
    local_coordinates,
    position,
)
from sumo_env.networks.roads import ROADS, intersection

ENTRY, LEFT, EXIT = ("o0", "ir0", 0), ("ir0", "il1", 0), ("il1", "o1", 0)


@pytest.mark.parametrize("task", ROADS)
def test_geometry_equals_the_lanes(task: str) -> None:
    road = ROADS[task]()
    table = lane_table(road.lanes)
    rng = np.random.default_rng(1)
    for name, lane in road.lanes.items():
        number = table.index[name]
        for s in rng.uniform(-10, lane.length + 10, 20):
            assert position(table.geometry, number, s) == pytest.approx(lane.position(s, 0.0), abs=1e-9)
            assert heading_at(table.geometry, number, s) == pytest.approx(lane.heading_at(s), abs=1e-12)
        for x, y in rng.uniform(-150, 150, (20, 2)):
            expected = lane.local_coordinates(x, y)
            assert local_coordinates(table.geometry, number, x, y) == pytest.approx(expected, abs=1e-9)


def test_successors_are_the_roads_that_begin_at_the_end() -> None:
    table = lane_table(intersection().lanes)
    names = list(table.index)
    following = [[names[k] for k in row if k >= 0] for row in table.successors]
    assert following[table.index[ENTRY]] == [("ir0", "il3", 0), LEFT, ("ir0", "il2", 0)]
    assert following[table.index[LEFT]] == [EXIT]
    # Node o1 is the end of one lane and the start of the other beside it: highway-env looks into both.
    assert following[table.index[EXIT]] == [("o1", "ir1", 0)]


def test_successors_keep_the_lane_id_where_it_exists() -> None:
    table = lane_table(ROADS["roundabout"]().lanes)
    names = list(table.index)
    following = {names[k] for k in table.successors[table.index["se", "ex", 1]] if k >= 0}
    assert following == {("ex", "ee", 1), ("ex", "exs", 0)}


def test_routes_are_padded_and_checked() -> None:
    table = lane_table(intersection().lanes)
    assert table.route([LEFT, EXIT]).tolist() == [table.index[LEFT], table.index[EXIT], -1]
    with pytest.raises(ValueError, match="1 to 3 lanes"):
        table.route([])


def test_a_vehicle_advances_along_its_route() -> None:
    road = intersection()
    table = lane_table(road.lanes)
    routes = table.route([ENTRY, LEFT, EXIT])[None]
    stage = np.zeros(1, dtype=np.int64)
    seen = []
    for name in (ENTRY, LEFT, EXIT):
        for share in (0.1, 0.6, 0.99, 1.5 if name == EXIT else 0.999):
            x, y = road.lane(name).position(share * road.lane(name).length, 0.3)
            advance(table.geometry, routes, stage, np.array([x]), np.array([y]))
            seen.append(int(stage[0]))
    assert seen == [0] * 4 + [1] * 4 + [2] * 4


@pytest.mark.parametrize("task", ROADS)
def test_the_closest_lane_is_the_road_s_or_left_to_it(task: str) -> None:
    road = ROADS[task]()
    table = lane_table(road.lanes)
    names = list(table.index)
    rng = np.random.default_rng(2)
    decided = 0
    for x, y, heading in rng.uniform((-120, -60, -7), (120, 60, 7), (1000, 3)):
        number = closest_lane(table.geometry, x, y, heading)
        if number >= 0:
            decided += 1
            assert names[number] == road.closest_lane(x, y, heading)
    assert decided > 400  # where lanes lie on each other, as on the two-way road, they are as close


def test_between_two_lanes_the_closest_one_is_left_to_the_road() -> None:
    table = lane_table(ROADS["highway"]().lanes)
    assert closest_lane(table.geometry, 100.0, 2.0, 0.0) == -1
    assert closest_lane(table.geometry, 100.0, 2.001, 0.0) == 1
