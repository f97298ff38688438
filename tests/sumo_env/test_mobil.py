"""Lane changes against highway-env's IDMVehicle.change_lane_policy, on random states of its highway."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import MDPVehicle

from sumo_env.models.mobil import (
    DELAY,
    MIN_GAIN,
    SAFE_BRAKING,
    closest_lanes,
    criteria,
    desired_lanes,
)

from .reference import randomise, state

ROAD: dict[str, Any] = {"lane_width": 4.0, "length": 10_000.0, "limit": 30.0}


def traffic(rng: np.random.Generator, count: int = 25, changing: float = 0.3) -> tuple[Road, dict[str, Any]]:
    """An ego (row 0) and drivers on four lanes, some changing; and the arguments of `desired_lanes`."""
    road = Road(RoadNetwork.straight_road_network(4, speed_limit=30.0))
    drivers = []
    for k in range(count):
        lane = int(rng.integers(4))
        place = [rng.uniform(20, 20 + 14 * count), 4.0 * lane + rng.uniform(-1.9, 1.9)]
        speed = rng.choice([rng.uniform(10, 32), rng.uniform(-1.5, 1.5)], p=[0.9, 0.1])
        vehicle = (MDPVehicle if k == 0 else IDMVehicle)(road, place, rng.uniform(-0.15, 0.15), speed)
        vehicle.target_speed = rng.uniform(10, 35)
        vehicle.timer = rng.uniform(0, 1.5)
        if rng.random() < changing:
            vehicle.target_lane_index = ("0", "1", int(np.clip(lane + rng.choice([-1, 1]), 0, 3)))
        road.vehicles.append(vehicle)
        drivers.append(randomise(vehicle, rng))
    lane, target_lane = (
        np.array([getattr(v, name)[2] for v in road.vehicles]) for name in ("lane_index", "target_lane_index")
    )
    changes = np.arange(count) > 0
    changes[1:] &= rng.random(count - 1) < 0.9
    due = np.array([getattr(v, "timer", 0.0) > DELAY for v in road.vehicles])
    arguments = state(road.vehicles) | ROAD
    arguments |= {"lane": lane, "target_lane": target_lane, "drivers": np.array(drivers)}
    return road, arguments | {"changes": changes, "due": due, "lanes_count": 4}


def test_decisions_equal_highway_env() -> None:
    rng = np.random.default_rng(4)
    left = right = aborted = 0
    for _ in range(150):
        road, arguments = traffic(rng)
        ours = desired_lanes(**arguments)
        lane, before = arguments["lane"], arguments["target_lane"]
        for k, vehicle in enumerate(road.vehicles):
            if arguments["changes"][k]:
                vehicle.change_lane_policy()
        after = np.array([v.target_lane_index[2] for v in road.vehicles])
        np.testing.assert_array_equal(np.where(ours >= 0, ours, before), after)
        reset = arguments["changes"] & arguments["due"] & (lane == before)
        timers = np.array([getattr(v, "timer", 1.0) for v in road.vehicles])
        np.testing.assert_array_equal(reset, timers == 0.0)
        left += int((after < before)[before == lane].sum())
        right += int((after > before)[before == lane].sum())
        aborted += int((after != before)[before != lane].sum())
    assert left > 50 and right > 50 and aborted > 30


def test_criteria_are_the_accelerations_that_highway_env_compares() -> None:
    rng = np.random.default_rng(8)
    for _ in range(40):
        road, arguments = traffic(rng, changing=0.0)
        some = {k: arguments[k] for k in ("lane", "drivers", *ROAD, *state([]))}
        for i, vehicle in enumerate(road.vehicles[1:], start=1):
            for index in road.network.side_lanes(vehicle.lane_index):
                preceding, following = road.neighbour_vehicles(vehicle, index)
                old_preceding, _ = road.neighbour_vehicles(vehicle)
                imposed, gain = criteria(i, index[2], **some)
                assert imposed == pytest.approx(vehicle.acceleration(following, vehicle), rel=1e-9, abs=1e-9)
                gained = vehicle.acceleration(vehicle, preceding) - vehicle.acceleration(
                    vehicle, old_preceding
                )
                assert gain == pytest.approx(gained, rel=1e-9, abs=1e-9)
                if abs(vehicle.speed) >= 1:
                    accepted = imposed >= -SAFE_BRAKING and gain >= MIN_GAIN
                    assert accepted == vehicle.mobil(index)


def three_lanes(**change: Any) -> dict[str, Any]:
    """A driver on the middle lane behind a slow car, on an otherwise empty road of three lanes."""
    n = 2
    return {
        "x": np.array([100.0, 125.0]), "y": np.full(n, 4.0), "speed": np.array([25.0, 15.0]),
        "heading": np.zeros(n), "lane": np.ones(n, dtype=np.int64), "target_lane": np.ones(n, dtype=np.int64),
        "target_speed": np.array([30.0, 15.0]), "drivers": np.tile([3.0, 5.0, 10.0, 1.5, 4.0, 6.0], (n, 1)),
        "changes": np.ones(n, dtype=bool), "due": np.array([True, False]), "lanes_count": 3,
    } | ROAD | change  # fmt: skip


def test_of_two_good_lanes_the_right_one_is_taken() -> None:
    assert desired_lanes(**three_lanes()).tolist() == [2, -1]
    assert desired_lanes(**three_lanes(lanes_count=2)).tolist() == [0, -1]


def test_nothing_happens_before_a_decision_is_due_or_at_a_standstill() -> None:
    nobody = np.zeros(2, dtype=bool)
    assert desired_lanes(**three_lanes(due=nobody)).tolist() == [-1, -1]
    assert desired_lanes(**three_lanes(changes=nobody)).tolist() == [-1, -1]
    assert desired_lanes(**three_lanes(speed=np.array([0.9, 0.0]))).tolist() == [-1, -1]


def test_giving_up_sees_decisions_taken_earlier_in_the_same_call() -> None:
    """The driver ahead decides for lane 2; the one behind, on its way there from lane 3, then gives up."""
    rows = {
        "x": np.array([100.0, 125.0, 65.0]), "y": np.array([4.0, 4.0, 11.9]), "heading": np.zeros(3),
        "speed": np.array([20.0, 15.0, 25.0]), "target_speed": np.array([30.0, 15.0, 25.0]),
        "lane": np.array([1, 1, 3]), "target_lane": np.array([1, 1, 2]), "lanes_count": 4,
        "changes": np.ones(3, dtype=bool), "due": np.array([True, False, False]),
        "drivers": np.tile([3.0, 5.0, 10.0, 1.5, 4.0, 6.0], (3, 1)),
    }  # fmt: skip
    assert desired_lanes(**rows, **ROAD).tolist() == [2, -1, 3]
    order = [2, 0, 1]
    turned = {name: values[order] if name != "lanes_count" else values for name, values in rows.items()}
    assert desired_lanes(**turned, **ROAD).tolist() == [-1, 2, -1]


def test_closest_lane_of_two_is_the_left_one() -> None:
    y = np.array([-3.0, 1.9, 2.0, 2.1, 6.0, 13.0, 99.0])
    assert closest_lanes(y, 4, 4.0).tolist() == [0, 0, 0, 1, 1, 3, 3]
    road = Road(RoadNetwork.straight_road_network(4))
    assert [road.network.get_closest_lane_index(np.array([50.0, v]))[2] for v in y] == [0, 0, 0, 1, 1, 3, 3]
