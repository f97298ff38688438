"""Car following against highway-env's IDMVehicle, on random states of its own roads."""

from __future__ import annotations

import math

import numpy as np
import pytest
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle

from sumo_env.drivers import CarFollowing, driver_pool
from sumo_env.models.idm import acceleration, driver_row, strip_accelerations
from sumo_env.models.lane_table import lane_table
from sumo_env.networks.roads import intersection

from .reference import fill_intersection, intersection_network, path_accelerations, randomise, state

ROAD = intersection()
TABLE = lane_table(ROAD.lanes)
NETWORK = intersection_network()


def test_equals_highway_env_for_any_pair() -> None:
    rng = np.random.default_rng(1)
    road = Road(RoadNetwork.straight_road_network(1, speed_limit=30.0))
    for _ in range(2000):
        gap = rng.choice([rng.uniform(-3, 3), rng.uniform(3, 200), 0.0])
        follower, leader = (
            IDMVehicle(road, [x, rng.uniform(-2, 2)], rng.uniform(-0.5, 0.5), rng.uniform(-2, 35))
            for x in (100.0, 100.0 + gap)
        )
        row = randomise(follower, rng)
        follower.target_speed = rng.choice([0.0, rng.uniform(0, 40)])
        v0 = min(follower.target_speed, 30.0)
        v_lead = leader.speed * math.cos(leader.heading - follower.heading)
        a, b, s0, tau, delta, _ = row
        ours = acceleration(follower.speed, v0, delta, gap, v_lead, a, b, s0, tau)
        assert ours == pytest.approx(follower.acceleration(follower, leader), rel=1e-9, abs=1e-9)
        alone = acceleration(follower.speed, v0, delta, math.inf, 0.0, a, b, s0, tau)
        assert alone == pytest.approx(follower.acceleration(follower), rel=1e-9, abs=1e-9)


def test_distance_kept_at_a_steady_speed() -> None:
    """36.28 m between centres at 15 m/s and a desired speed of 22.5 m/s (measured in highway-env)."""
    gap = (10 + 1.5 * 15) / math.sqrt(1 - (15 / 22.5) ** 4)
    assert gap == pytest.approx(36.28, abs=0.01)
    assert acceleration(15.0, 22.5, 4.0, gap, 15.0, 3.0, 5.0, 10.0, 1.5) == pytest.approx(0.0, abs=1e-12)


def test_a_much_faster_leader_brakes_as_in_highway_env() -> None:
    near = acceleration(10.0, 30.0, 4.0, 12.0, 40.0, 3.0, 5.0, 10.0, 1.5)
    assert near < acceleration(10.0, 30.0, 4.0, math.inf, 0.0, 3.0, 5.0, 10.0, 1.5)


def test_drivers_have_the_numbers_of_highway_env() -> None:
    regular = driver_row(driver_pool(CarFollowing(), 0.0, fixed_delta=True)[0])
    v = IDMVehicle
    assert regular == pytest.approx(
        [v.COMFORT_ACC_MAX, -v.COMFORT_ACC_MIN, v.DISTANCE_WANTED, v.TIME_WANTED, v.DELTA, v.ACC_MAX]
    )


def commanded(road: Road) -> np.ndarray:
    """The accelerations that highway-env's drivers command, for lane changes already decided."""
    for vehicle in road.vehicles:
        vehicle.enable_lane_change = False
        vehicle.act()
    return np.array([float(vehicle.action["acceleration"]) for vehicle in road.vehicles])


@pytest.mark.parametrize("seed", range(15))
def test_highway(seed: int) -> None:
    rng = np.random.default_rng(seed)
    road = Road(RoadNetwork.straight_road_network(4, speed_limit=30.0))
    drivers = []
    for _ in range(25):
        lane = int(rng.integers(4))
        place = [rng.uniform(50, 450), 4.0 * lane + rng.uniform(-1.9, 1.9)]
        vehicle = IDMVehicle(road, place, rng.uniform(-0.2, 0.2), rng.uniform(0, 32))
        vehicle.target_speed = rng.uniform(0, 35)
        if rng.random() < 0.4:
            vehicle.target_lane_index = ("0", "1", int(np.clip(lane + rng.choice([-1, 1]), 0, 3)))
        road.vehicles.append(vehicle)
        drivers.append(randomise(vehicle, rng))
    lane_y, target_y = (
        np.array([4.0 * getattr(v, name)[2] for v in road.vehicles])
        for name in ("lane_index", "target_lane_index")
    )
    ours = strip_accelerations(
        **state(road.vehicles), lane_y=lane_y, target_y=target_y, direction=np.ones(25),
        drivers=np.array(drivers), length=10_000.0, limit=30.0,
    )  # fmt: skip
    np.testing.assert_allclose(ours, commanded(road), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(15))
def test_two_way(seed: int) -> None:
    """Both directions share the strip y = 0, and oncoming cars there are leaders."""
    rng = np.random.default_rng(seed)
    net = RoadNetwork()
    net.add_lane("a", "b", StraightLane([0, 0], [800, 0]))
    net.add_lane("a", "b", StraightLane([0, 4], [800, 4]))
    net.add_lane("b", "a", StraightLane([800, 0], [0, 0]))
    road = Road(net)
    drivers = []
    for _ in range(14):
        west, overtaking = rng.random() < 0.4, rng.random() < 0.3
        y = 0.0 if west or overtaking else 4.0
        place = [rng.uniform(10, 790), y + rng.uniform(-1.5, 1.5)]
        vehicle = IDMVehicle(
            road, place, (math.pi if west else 0.0) + rng.uniform(-0.1, 0.1), rng.uniform(0, 30)
        )
        vehicle.target_speed = rng.uniform(0, 30)
        if not west and rng.random() < 0.4:
            vehicle.target_lane_index = ("a", "b", 1 - vehicle.lane_index[2])
        road.vehicles.append(vehicle)
        drivers.append(randomise(vehicle, rng))
    lane_y, target_y = (
        np.array([4.0 * getattr(v, name)[2] for v in road.vehicles])
        for name in ("lane_index", "target_lane_index")
    )
    direction = np.array([1.0 if v.lane_index[0] == "a" else -1.0 for v in road.vehicles])
    ours = strip_accelerations(
        **state(road.vehicles), lane_y=lane_y, target_y=target_y, direction=direction,
        drivers=np.array(drivers), length=800.0, limit=20.0,
    )  # fmt: skip
    np.testing.assert_allclose(ours, commanded(road), rtol=1e-9, atol=1e-9)


def along_the_path(road: Road, vehicle: IDMVehicle) -> tuple[float, int]:
    """The acceleration that the variant "path" of highway-env commands, written with highway-env's own parts.

    Who leads is asked of ``Road.neighbour_vehicles``. A leader beyond the lane's end is put, at its distance
    along the path, on a straight lane before a copy of the driver. Second value: number of such leaders.
    """
    straight = Road(RoadNetwork.straight_road_network(1, speed_limit=vehicle.lane.speed_limit))
    s_own = vehicle.lane.local_coordinates(vehicle.position)[0]
    found, beyond = [], 0
    for index in dict.fromkeys([vehicle.lane_index, vehicle.target_lane_index]):
        leader, _ = road.neighbour_vehicles(vehicle, index)
        lane = road.network.get_lane(index)
        if leader is None or (
            lane is vehicle.lane
            and lane.on_lane(leader.position, *lane.local_coordinates(leader.position), margin=1)
        ):
            found.append(vehicle.acceleration(vehicle, leader))
            continue
        before = 0.0 if lane is vehicle.lane else vehicle.lane.length
        following = [(lane, before)]
        following += [(lanes[0], before + lane.length) for lanes in road.network.graph[index[1]].values()]
        s_leader = next(
            candidate.local_coordinates(leader.position)[0] + offset
            for candidate, offset in following
            if candidate.on_lane(leader.position, margin=1)
        )
        ahead = IDMVehicle(straight, [s_leader, 0], 0.0, leader.speed)
        driver = IDMVehicle(straight, [s_own, 0], 0.0, vehicle.speed, target_speed=vehicle.target_speed)
        driver.target_speed = vehicle.target_speed
        for name in ("COMFORT_ACC_MAX", "COMFORT_ACC_MIN", "DISTANCE_WANTED", "TIME_WANTED", "DELTA"):
            setattr(driver, name, getattr(vehicle, name))
        found.append(driver.acceleration(driver, ahead))
        beyond += 1
    return float(np.clip(min(found), -vehicle.ACC_MAX, vehicle.ACC_MAX)), beyond


def test_intersection_along_the_path() -> None:
    rng = np.random.default_rng(5)
    beyond = 0
    for _ in range(60):
        road = Road(NETWORK, neighbour_vehicles_connected_lanes=True)
        routes, stage, drivers = fill_intersection(road, TABLE, rng, 10, noise=0.3, spread=60.0)
        expected = [
            along_the_path(road, vehicle) for vehicle in road.vehicles[1:]
        ]  # the ego is no IDMVehicle
        ours = path_accelerations(
            TABLE.geometry, TABLE.successors, routes, stage, **state(road.vehicles), drivers=drivers
        )
        np.testing.assert_allclose(ours[1:], [a for a, _ in expected], rtol=1e-9, atol=1e-9)
        beyond += sum(count for _, count in expected)
    assert beyond > 100


def test_intersection_without_connected_lanes() -> None:
    """With nothing beyond the end of a lane, the drivers are those of the stock intersection-v0."""
    rng = np.random.default_rng(6)
    nothing = np.full_like(TABLE.successors, -1)
    compared = 0
    for _ in range(60):
        road = Road(NETWORK)
        routes, stage, drivers = fill_intersection(road, TABLE, rng, 10, noise=0.3, spread=60.0)
        ours = path_accelerations(
            TABLE.geometry, nothing, routes, stage, **state(road.vehicles), drivers=drivers
        )
        for k, vehicle in enumerate(road.vehicles[1:], start=1):
            if vehicle.lane_index != vehicle.target_lane_index:
                continue  # highway-env projects the next lane's leader on this one; see the test above
            vehicle.enable_lane_change = False
            vehicle.act()
            assert ours[k] == pytest.approx(vehicle.action["acceleration"], rel=1e-9, abs=1e-9)
            compared += 1
    assert compared > 300


def test_a_leader_round_the_bend_is_as_far_as_the_way_to_it() -> None:
    """12 m beyond a left turn: 20.42 + 12 m away, and as fast as it drives, though across one's heading."""
    way = [("o0", "ir0", 0), ("ir0", "il1", 0), ("il1", "o1", 0)]
    places = [(ROAD.lane(way[0]), 95.0), (ROAD.lane(way[2]), 12.0)]
    x, y = (np.array(c) for c in zip(*(lane.position(s, 0.0) for lane, s in places), strict=True))
    heading = np.array([lane.heading_at(s) for lane, s in places])
    routes = np.array([TABLE.route(way)] * 2)
    drivers = np.array([[6.0, 3.0, 7.0, 1.5, 4.0, 6.0]] * 2)
    speed = np.full(2, 8.0)

    def front(stage_of_first: int) -> float:
        stage = np.array([stage_of_first, 2])
        return path_accelerations(
            TABLE.geometry, TABLE.successors, routes, stage, x, y, speed, heading, speed + 1, drivers
        )[0]

    free = acceleration(8.0, 9.0, 4.0, math.inf, 0.0, 6.0, 3.0, 7.0, 1.5)
    assert front(0) == free  # two lanes ahead: not looked at yet, as in highway-env
    bend = ROAD.lane(way[1])
    x[0], y[0] = bend.position(0.0, 0.0)
    heading[0] = bend.heading_at(0.0)
    behind = acceleration(8.0, 9.0, 4.0, bend.length + 12.0, 8.0, 6.0, 3.0, 7.0, 1.5)
    assert front(1) == pytest.approx(behind)
