"""Sideways motion: highway-env's controller and bicycle model, and SUMO's cars that follow it."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import libsumo
import numpy as np
import pytest
from highway_env.envs import IntersectionEnv, RoundaboutEnv, UTurnEnv
from highway_env.road.road import Road
from highway_env.vehicle.controller import ControlledVehicle

import sumo_env  # noqa: F401  (registers the ids)
from sumo_env.models.lane_table import lane_table
from sumo_env.models.steering import BACK, REFERENCE_STEP, follow, steer
from sumo_env.networks.roads import ROADS
from sumo_env.steering import nearest
from sumo_env.tasks import get_task

from .reference import intersection_network

NETWORKS = {"u-turn": UTurnEnv, "roundabout": RoundaboutEnv, "intersection": IntersectionEnv}


@pytest.mark.parametrize("task", NETWORKS)
def test_a_car_moves_as_in_highway_env(task: str) -> None:
    """In steps of highway-env's length, at any place and speed, on every kind of lane; wrecks go straight on."""
    rng = np.random.default_rng(2)
    network = intersection_network() if task == "intersection" else NETWORKS[task]().road.network
    table = lane_table(ROADS[task]().lanes)
    road = Road(network)
    for name, number in table.index.items():
        lane = network.get_lane(name)
        for crashed in (False, True):
            s, speed = rng.uniform(0.0, lane.length), rng.uniform(-2.0, 25.0)
            vehicle = ControlledVehicle(
                road, lane.position(s, rng.normal()), lane.heading_at(s) + 0.2 * rng.normal(), speed, name
            )
            vehicle.crashed = crashed
            x, y, heading = (np.array([float(v)]) for v in (*vehicle.position, vehicle.heading))
            for _ in range(15):
                vehicle.action = {"steering": vehicle.steering_control(name), "acceleration": 0.0}
                vehicle.speed = speed  # a wreck would brake
                vehicle.step(REFERENCE_STEP)
                distance = np.array([speed * REFERENCE_STEP])
                steer(table.geometry, np.array([number]), x, y, heading, distance, np.array([crashed]), REFERENCE_STEP)
            assert (x[0], y[0]) == pytest.approx(tuple(vehicle.position), abs=1e-6)
            assert heading[0] == pytest.approx(vehicle.heading, abs=1e-6)


def test_half_a_lane_change_takes_as_long_as_in_highway_env_at_our_step() -> None:
    table = lane_table(ROADS["u-turn"]().lanes)
    for speed in (8.0, 16.0, 24.0):
        crossed = []
        for step in (REFERENCE_STEP, 0.1):
            x, y, heading = np.zeros(1), np.array([44.0]), np.zeros(1)
            lateral = [0.0]
            while lateral[-1] < 2.0:
                to = np.array([table.index["a", "b", 1]])
                steer(table.geometry, to, x, y, heading, np.array([speed * step]), np.zeros(1, np.bool_), step)
                lateral.append(float(y[0]) - 44.0)
            crossed.append(float(np.interp(2.0, lateral, np.arange(len(lateral)) * step)))
        assert crossed[1] == pytest.approx(crossed[0], abs=0.03)


def bring(road: Any, lane: Any, front: tuple[float, float], to: tuple[float, float, float], lateral: float) -> Any:
    """What `follow` commands a car on a lane: speed [m/s], distance to the middle [m], place of its lane or -1."""
    table = lane_table(road.lanes)
    numbers = [np.array([value]) for value in (table.index[lane], lane[2], road.count(*lane[:2]), -1)]
    pose = np.array([[to[0] - 2.5 * np.cos(to[2])], [to[1] - 2.5 * np.sin(to[2])], [to[2]]])
    beside, speed, change = np.array([lateral]), np.empty(1), np.empty(1, np.int64)
    follow(
        table.geometry, np.zeros(1, np.int64), *numbers, np.empty((0, 0, 2)), np.ones(1),
        np.array(front).reshape(2, 1), *pose, 0.1, beside, speed, change,
    )  # fmt: skip
    return speed[0], beside[0], change[0]


def test_sumo_follows_a_bend() -> None:
    """On the way around the u-turn, 2 m ahead and half a metre to the right."""
    road = ROADS["u-turn"]()
    lane = road.lane(("b", "c", 0))
    to = (*lane.position(12.0, 0.5), lane.heading_at(12.0))
    speed, lateral, change = bring(road, ("b", "c", 0), lane.position(10.0, 0.0), to, 0.0)
    assert speed == pytest.approx(20.0, abs=0.3)
    assert lateral == pytest.approx(-0.5, abs=0.03)
    assert change == -1


@pytest.mark.parametrize(("place", "moved", "change", "lateral"), [
    (0, 0.3, 1, 1.8), (1, -0.3, 0, -1.8), (1, 0.3, -1, -2.2), (0, -0.3, -1, 2.2),
])  # fmt: skip
def test_who_crosses_the_line_is_on_the_next_lane(place: int, moved: float, change: int, lateral: float) -> None:
    """`moved`: to the right of where the car is, 0.1 m before the line; there is no lane beyond the outer ones."""
    road = ROADS["u-turn"]()
    lane = ("a", "b", place)
    side = np.sign(moved)
    y = road.lane(lane).position(20.0, 0.0)[1] + 1.9 * side
    x = road.lane(lane).position(20.0, 0.0)[0]
    _, beside, found = bring(road, lane, (x, y), (x + 1.0, y + moved, 0.0), -1.9 * side)
    assert found == change
    assert beside == pytest.approx(lateral, abs=1e-6)


def test_a_car_that_rolls_back_is_put_where_it_is_to_be() -> None:
    road = ROADS["u-turn"]()
    lane = ("b", "c", 1)
    to = (*lane_point(road, lane, 9.0, 0.0), road.lane(lane).heading_at(9.0))
    speed, lateral, change = bring(road, lane, lane_point(road, lane, 10.0, 0.0), to, 0.0)
    assert (speed, change) == (0.0, BACK)
    assert lateral == pytest.approx(0.0, abs=1e-6)


def lane_point(road: Any, lane: Any, s: float, lat: float) -> tuple[float, float]:
    x, y = road.lane(lane).position(s, lat)
    return float(x), float(y)


def test_a_car_that_went_around_the_ring_is_not_put_back_to_its_first_time_there() -> None:
    """It rolls back at an exit, and has passed the road before it twice: SUMO takes the first time, and refuses."""
    config = {**get_task("roundabout").levels["10"], "simulation_frequency": 15}
    env = gym.make("sumo/roundabout-v0", config=config)
    env.reset(seed=1013357)
    for action in (4, 4, 3, 4, 1, 1, 3, 1, 2, 2, 1):
        env.step(action)


def test_where_a_point_is_on_a_line() -> None:
    corner = ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0))  # y points down: it turns to the right
    assert nearest(corner, 3.0, -1.0) == pytest.approx((1.0, 3.0, 1.0))
    assert nearest(corner, 3.5, 2.0) == pytest.approx((0.5, 6.0, -0.5))
    assert nearest(corner, -2.0, 0.5)[1] == 0.0


LEVELS = [(task, level) for task in ("highway", "u-turn", "roundabout", "intersection") for level in (0, -1)]


@pytest.mark.parametrize(("task", "level"), LEVELS)
@pytest.mark.parametrize("risk", [0.0, 1.0])
def test_sumo_cars_are_where_they_are_steered(task: str, level: int, risk: float) -> None:
    """Front bumpers: half of them within 1 mm, 95 % within 5 cm, 99 % within 0.2 m, also of cars that roll back."""
    settings = list(get_task(task).levels.values())[level]
    env = gym.make(f"sumo/{task}-v0", config={**settings, "risk": risk})
    inner: Any = env.unwrapped
    apart, back = [], []
    for seed in range(12):
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        over = False
        while not over:
            _, _, terminated, truncated, _ = env.step(int(rng.integers(env.action_space.n)))
            over = terminated or truncated
            world = inner._world
            state, n = np.empty((4, len(world.ids))), len(world.ids)
            world.sim.fleet(world.ids).read(state, np.empty((3, n)), np.empty(n, np.int64), np.full(n, np.nan))
            x, y, heading, _ = state
            dx = x + 2.5 * np.cos(heading) - world.x - 2.5 * np.cos(world.heading)
            dy = y + 2.5 * np.sin(heading) - world.y - 2.5 * np.sin(world.heading)
            apart += np.hypot(dx, dy).tolist()
            back += (world.speed < 0.0).tolist()
    env.close()
    assert len(apart) > 200
    assert np.median(apart) < 0.001
    assert np.quantile(apart, 0.95) < 0.05
    assert np.quantile(apart, 0.99) < 0.2
    assert max(np.array(apart)[back], default=0.0) < 0.1


@pytest.mark.parametrize("task", ["roundabout", "intersection"])
def test_a_car_that_is_placed_again_has_the_route_of_its_new_way(task: str) -> None:
    inner: Any = gym.make(f"sumo/{task}-v0").unwrapped
    before: dict[str, str] = {}
    changed = 0
    for seed in range(20):
        inner.reset(seed=seed)
        world = inner._world
        routes = {name: libsumo.vehicle.getRouteID(name) for name in libsumo.vehicle.getIDList()}
        assert routes == {
            spec.id: world.network.sumo_route(spec.lane, spec.destination) for spec in world.specs
        }
        changed += sum(before.get(name, route) != route for name, route in routes.items())
        before = routes
        inner.step(0)
    assert changed > 5
    inner.close()


@pytest.mark.parametrize("task", ["highway", "roundabout", "intersection", "u-turn"])
def test_a_car_that_is_placed_again_stands_where_a_new_one_would(task: str) -> None:
    inner: Any = gym.make(f"sumo/{task}-v0").unwrapped

    def reset_and_step(seed: int) -> Any:
        """What SUMO knows of its cars after its first step."""
        inner.reset(seed=seed)
        world = inner._world
        world._substep()
        state, n = np.empty((4, len(world.ids))), len(world.ids)
        world.fleet.read(state, np.empty((3, n)), np.empty(n, np.int64), np.full(n, np.nan))
        return [*state.ravel(), *(world.sim.lateral_position(name) for name in world.ids)]

    inner.reset(seed=0)
    inner._world.sim._clear()
    new = reset_and_step(1)
    inner.reset(seed=0)
    for _ in range(3):
        inner.step(0)
    assert inner._world.sim.present()
    np.testing.assert_allclose(reset_and_step(1), new, rtol=0, atol=1e-9)
    inner.close()
