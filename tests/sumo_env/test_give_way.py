"""The intersection's right of way against highway-env's RegulatedRoad, on random states of its own road."""

from __future__ import annotations

import math

import numpy as np
import pytest
from highway_env.road.regulation import RegulatedRoad

from sumo_env.models.give_way import PERIOD, regulate
from sumo_env.models.lane_table import lane_table
from sumo_env.networks.roads import intersection

from .reference import fill_intersection, intersection_network, state

ROAD = intersection()
TABLE = lane_table(ROAD.lanes)
NETWORK = intersection_network()


def test_who_gives_way_equals_highway_env() -> None:
    rng = np.random.default_rng(2)
    yielders = released = 0
    for _ in range(120):
        road = RegulatedRoad(NETWORK)
        routes, stage, _ = fill_intersection(road, TABLE, rng, 10, noise=0.2, spread=30.0)
        before = rng.random(10) < 0.3
        before[0] = False
        for vehicle, yields in zip(road.vehicles, before, strict=True):
            if yields:
                vehicle.is_yielding, vehicle.yield_timer, vehicle.color = True, 0, None
                vehicle.target_speed = 0.0
        ours = state(road.vehicles)
        yielding, exempt = before.copy(), np.arange(10) == 0
        regulate(TABLE.geometry, routes, stage, exempt=exempt, yielding=yielding, **ours)
        road.enforce_road_rules()
        expected = np.array([bool(getattr(v, "is_yielding", False)) for v in road.vehicles])
        np.testing.assert_array_equal(yielding, expected)
        np.testing.assert_array_equal(ours["target_speed"], [v.target_speed for v in road.vehicles])
        yielders += int(expected.sum())
        released += int((before & ~expected).sum())
    assert yielders > 150 and released > 100


def test_period_is_that_of_fifteen_steps_a_second() -> None:
    assert int(15 / RegulatedRoad.REGULATION_FREQUENCY) / 15 == PERIOD
    assert RegulatedRoad.YIELD_DURATION == 0.0  # released at every look


def crossing(first: tuple[int, int], second: tuple[int, int], exempt: tuple[bool, bool] = (False, False)):
    """Two cars at 9 m/s, 15 m before the square, each from one arm to another; who gives way?"""
    routes, x, y, heading = [], [], [], []
    for start, end in (first, second):
        way = [(f"o{start}", f"ir{start}", 0), (f"ir{start}", f"il{end}", 0), (f"il{end}", f"o{end}", 0)]
        entry = ROAD.lane(way[0])
        px, py = entry.position(85.0, 0.0)
        routes.append(TABLE.route(way))
        x.append(px)
        y.append(py)
        heading.append(entry.heading_at(85.0))
    target_speed, yielding = np.full(2, 8.0), np.zeros(2, dtype=bool)
    regulate(
        TABLE.geometry,
        np.array(routes),
        np.zeros(2, dtype=np.int64),
        np.array(x),
        np.array(y),
        np.full(2, 9.0),
        np.array(heading),
        np.array(exempt),
        target_speed,
        yielding,
    )
    np.testing.assert_array_equal(target_speed, np.where(yielding, 0.0, 8.0))
    return yielding.tolist()


def test_the_east_west_road_has_right_of_way() -> None:
    assert crossing((0, 2), (1, 3)) == [True, False]
    assert crossing((1, 3), (0, 2)) == [False, True]


def test_nobody_gives_way_in_the_stead_of_who_is_exempt() -> None:
    assert crossing((0, 2), (1, 3), exempt=(True, False)) == [False, False]
    assert crossing((0, 2), (1, 3), exempt=(False, True)) == [True, False]


def test_paths_that_do_not_meet_need_no_rule() -> None:
    assert crossing((0, 2), (2, 0)) == [False, False]


def test_on_one_lane_the_car_behind_gives_way() -> None:
    entry = ROAD.lane(("o1", "ir1", 0))
    routes = np.array([TABLE.route([("o1", "ir1", 0), ("ir1", "il3", 0), ("il3", "o3", 0)])] * 2)
    x, y = (np.array(c) for c in zip(entry.position(30.0, 0.0), entry.position(45.0, 0.0), strict=True))
    target_speed, yielding = np.full(2, 10.0), np.zeros(2, dtype=bool)
    heading = np.full(2, entry.heading_at(0.0))
    assert math.isclose(math.cos(heading[0]), 1.0)
    regulate(
        TABLE.geometry, routes, np.zeros(2, dtype=np.int64), x, y, np.array([10.0, 5.0]), heading,
        np.zeros(2, dtype=bool), target_speed, yielding,
    )  # fmt: skip
    assert yielding.tolist() == [True, False]


def test_who_is_released_wants_the_limit_of_its_lane() -> None:
    entry = ROAD.lane(("o1", "ir1", 0))
    x, y = entry.position(30.0, 0.0)
    target_speed, yielding = np.zeros(1), np.ones(1, dtype=bool)
    regulate(
        TABLE.geometry, TABLE.route([("o1", "ir1", 0)])[None], np.zeros(1, dtype=np.int64),
        np.array([x]), np.array([y]), np.zeros(1), np.array([entry.heading_at(0.0)]),
        np.zeros(1, dtype=bool), target_speed, yielding,
    )  # fmt: skip
    assert (target_speed[0], bool(yielding[0])) == pytest.approx((10.0, False))
