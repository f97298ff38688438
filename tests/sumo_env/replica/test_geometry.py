"""Lanes as records: highway-env's lanes, how they hang together, and where cars are on them."""

from __future__ import annotations

import numpy as np
import pytest

from sumo_env.replica.geometry import closest_lane, heading_at, local_coordinates, position
from sumo_env.replica.neighbours import neighbours
from sumo_env.replica.numpy_loops import LOOPS
from sumo_env.replica.tables import NONE, lanes_of

from .stock import TASKS, VARIANTS, close, environment, traffic


@pytest.mark.parametrize("task", TASKS)
def test_lanes_are_those_of_highway_env(task: str) -> None:
    env = environment(task, "path")
    lanes = lanes_of(env.task.road(env.config), connected=True)
    rng = np.random.default_rng(1)
    assert list(lanes.names) == list(env.road.network.lanes_dict())
    for name, lane in env.road.network.lanes_dict().items():
        ours = lanes.table[lanes.numbers[name]]
        assert (ours["limit"], ours["priority"]) == (lane.speed_limit, lane.priority)
        for s in rng.uniform(-10.0, lane.length + 10.0, 10):
            close(position(ours, s), lane.position(s, 0.0))
            close(heading_at(ours, s, LOOPS), lane.heading_at(s))
        for x, y in rng.uniform(-150.0, 150.0, (10, 2)):
            close(local_coordinates(ours, x, y), lane.local_coordinates(np.array([x, y])))


@pytest.mark.parametrize("task", TASKS)
def test_the_closest_lane_is_highway_env_s_whatever_lane_a_car_was_on(task: str) -> None:
    env = environment(task, "path")
    rng = np.random.default_rng(2)
    for _ in range(20):
        t = traffic(env, rng)
        for i, vehicle in enumerate(t.road.vehicles):
            last = int(rng.integers(len(t.table)))
            found = closest_lane(t.table, t.places, LOOPS, i, float(vehicle.heading), last)
            assert t.lanes.names[found] == vehicle.lane_index


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("task", TASKS)
def test_neighbours_are_highway_env_s_on_every_lane(task: str, variant: str) -> None:
    env = environment(task, variant)
    rng = np.random.default_rng(3)
    found = 0
    for _ in range(10):
        t = traffic(env, rng)
        for i, vehicle in enumerate(t.road.vehicles):
            for number, name in enumerate(t.lanes.names):
                theirs = t.road.neighbour_vehicles(vehicle, name)
                ours = [
                    None if k == NONE else t.road.vehicles[k]
                    for k in neighbours(t.table, t.places, i, number)
                ]
                assert ours == list(theirs)
                found += theirs[0] is not None
    assert found > 100
