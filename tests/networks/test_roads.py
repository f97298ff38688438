"""Every lane of every task against highway-env's own objects."""

from itertools import pairwise
from types import SimpleNamespace

import highway_env.envs as envs
import numpy as np
import pytest
import shapely

from sumo_env.compat.views import RoadNetwork
from sumo_env.networks import roads
from sumo_env.networks.lanes import PolyLane

# Our road, and the environment of highway-env that has it, with the arguments and the configuration of its own.
ROADS = {
    "highway": (roads.highway(), envs.HighwayEnv, {}, {"lanes_count": 4}),
    "highway-2": (roads.highway(2), envs.HighwayEnv, {}, {"lanes_count": 2}),
    "two-way": (roads.two_way(), envs.TwoWayEnv, {}, {}),
    "two-way-533": (roads.two_way(1600 / 3), envs.TwoWayEnv, {"length": 1600 / 3}, {}),
    "roundabout": (roads.roundabout(), envs.RoundaboutEnv, {}, {}),
    "intersection": (roads.intersection(), envs.IntersectionEnv, {}, {}),
    "u-turn": (roads.u_turn(), envs.UTurnEnv, {}, {}),
    "merge": (roads.merge(), envs.MergeEnv, {}, {}),
    "exit": (roads.exit_road(), envs.ExitEnv, {}, {"lanes_count": 6}),
    "exit-3": (roads.exit_road(3), envs.ExitEnv, {}, {"lanes_count": 3}),
}


@pytest.fixture(params=ROADS)
def pair(request):
    """A road, and highway-env's RoadNetwork of it, built by its own `_make_road` without an environment."""
    ours, cls, arguments, config = ROADS[request.param]
    config = {**config, "show_trajectories": False, "speed_limit": 30}
    config["neighbour_vehicles_connected_lanes"] = False
    env = SimpleNamespace(config=config, np_random=np.random.default_rng(0))
    make = cls._create_road if issubclass(cls, envs.HighwayEnv) else cls._make_road
    make(env, **arguments)
    env.road.network.boxes = env.road.objects
    return ours, env.road.network


def _poses(network, rng, n):
    """Random poses around the lanes, also beyond their ends."""
    lanes = list(network.lanes_dict().values())
    for k in range(n):
        lane = lanes[k % len(lanes)]
        s = rng.uniform(-20, min(lane.length, 1000) + 20)
        x, y = lane.position(s, rng.normal(0, 4))
        yield float(x), float(y), float(lane.heading_at(s) + rng.normal(0, 1))


def test_same_lanes_in_the_same_order(pair):
    ours, theirs = pair
    assert list(ours.lanes) == list(theirs.lanes_dict())
    for index, lane in theirs.lanes_dict().items():
        mine = ours.lane(index)
        assert mine.length == pytest.approx(lane.length, abs=1e-9)
        assert (mine.speed_limit, mine.priority, mine.width) == (lane.speed_limit, lane.priority, lane.width)
        assert mine.forbidden == lane.forbidden


def test_same_obstacles(pair):
    ours, theirs = pair
    assert [tuple(box.position) for box in theirs.boxes] == list(ours.obstacles)


def test_who_may_change_to_which_lane(pair):
    """As highway-env lets vehicles change that are beside the lane."""
    ours, theirs = pair
    for index, lane in theirs.lanes_dict().items():
        middle = lane.position(lane.length / 2, 0.0)
        allowed = [one for one in theirs.side_lanes(index) if theirs.get_lane(one).is_reachable_from(middle)]
        assert [other for side in (-1, 1) if (other := ours.beside(index, side))] == allowed


def test_same_curves(pair):
    ours, theirs = pair
    rng = np.random.default_rng(1)
    for index, lane in theirs.lanes_dict().items():
        mine = ours.lane(index)
        for s in np.concatenate([np.linspace(-30, lane.length + 30, 23), rng.uniform(0, lane.length, 10)]):
            assert mine.heading_at(float(s)) == pytest.approx(lane.heading_at(s), abs=1e-9)
            for lat in (-5.0, 0.0, 3.0):
                assert mine.position(float(s), lat) == pytest.approx(lane.position(s, lat), abs=1e-9)


def test_same_local_coordinates_and_lane_membership(pair):
    ours, theirs = pair
    lanes = theirs.lanes_dict()
    for x, y, heading in _poses(theirs, np.random.default_rng(2), 60):
        position = np.array([x, y])
        for index, lane in lanes.items():
            mine = ours.lane(index)
            assert mine.local_coordinates(x, y) == pytest.approx(lane.local_coordinates(position), abs=1e-9)
            assert mine.on_lane(x, y) == lane.on_lane(position)
            assert mine.on_lane(x, y, margin=1.0) == lane.on_lane(position, margin=1.0)
            assert mine.is_reachable_from(x, y) == lane.is_reachable_from(position)
            assert mine.after_end(x, y) == lane.after_end(position)
            assert mine.distance(x, y) == pytest.approx(lane.distance(position), abs=1e-9)
            expected = lane.distance_with_heading(position, heading)
            assert mine.distance(x, y, heading) == pytest.approx(expected, abs=1e-9)


def test_same_closest_lane(pair):
    ours, theirs = pair
    for x, y, heading in _poses(theirs, np.random.default_rng(3), 300):
        position = np.array([x, y])
        assert ours.closest_lane(x, y, heading) == theirs.get_closest_lane_index(position, heading)
        assert ours.closest_lane(x, y) == theirs.get_closest_lane_index(position, None)


@pytest.mark.parametrize("name", ROADS)
def test_the_closest_lane_is_the_first_of_all_with_the_least_distance(name):
    """Also far from the road, and where lanes are equally close, which is decided by their order."""
    road = ROADS[name][0]
    rng = np.random.default_rng(5)
    anywhere = rng.uniform((-180, -180, -7), (180, 180, 7), (1500, 3))
    ties = rng.integers((-90, -15, -4), (90, 15, 4), (1500, 3)) * (1.0, 2.0, np.pi / 2)
    for x, y, heading in [*anywhere.tolist(), *ties.tolist()]:
        for direction in (heading, None):
            expected = min(road.lanes, key=lambda index: road.lane(index).distance(x, y, direction))
            assert road.closest_lane(x, y, direction) == expected


def test_same_graph(pair):
    ours, theirs = pair
    nodes = sorted(set(theirs.graph) | {end for ends in theirs.graph.values() for end in ends})
    for start in theirs.graph:
        for goal in nodes:
            assert ours.route(start, goal) == tuple(theirs.shortest_path(start, goal))
    for index in ours.lanes:
        assert RoadNetwork(road=ours).side_lanes(index) == theirs.side_lanes(index)
        assert ours.count(*index[:2]) == len(theirs.all_side_lanes(index))


def test_same_next_lane(pair):
    """As ControlledVehicle.follow_road asks for it: with a planned route, near the end, off the centre."""
    ours, theirs = pair
    rng = np.random.default_rng(4)
    goals = sorted({end for ends in theirs.graph.values() for end in ends})
    for index, lane in theirs.lanes_dict().items():
        for goal in [None, *goals]:
            path = theirs.shortest_path(index[1], goal) if goal else []
            plan = [index, *((a, b, None) for a, b in pairwise(path))]
            x, y = map(float, lane.position(lane.length + rng.uniform(-2.5, 2.0), rng.normal(0, 2)))
            expected = theirs.next_lane(index, plan if goal else None, np.array([x, y]))
            assert ours.next_lane(index, (index[0], *path), x, y) == expected


def test_a_lane_of_pieces_is_measured_as_shapely_does() -> None:
    """Beside pieces, and at corners from outside and from inside; beyond both ends it goes on straight."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        turns, lengths = rng.uniform(-1.0, 1.0, 5).cumsum(), rng.uniform(5.0, 30.0, 5)
        steps = np.stack([lengths * np.cos(turns), lengths * np.sin(turns)], axis=1)
        points = np.concatenate([np.zeros((1, 2)), steps.cumsum(axis=0)])
        lane, line = PolyLane(tuple(map(tuple, points.tolist()))), shapely.LineString(points)
        assert lane.length == pytest.approx(line.length)
        headings = [lane.heading_at(s) for s in lengths.cumsum() - lengths / 2.0]
        np.testing.assert_allclose(np.sin(headings), np.sin(turns))
        for x, y in (points[rng.integers(6, size=60)] + rng.normal(0.0, 4.0, (60, 2))).tolist():
            s, lateral = lane.local_coordinates(x, y)
            if 0.0 < s < lane.length:
                place = shapely.Point(x, y)
                assert (s, abs(lateral)) == pytest.approx((line.project(place), line.distance(place)))
