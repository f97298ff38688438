"""SUMO's lanes lie on highway-env's, and everything that drives finds its lane, position and route."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from sumo_env.networks import plans, roads
from sumo_env.networks.lanes import CircularLane, StraightLane
from sumo_env.networks.mapping import network
from sumo_env.networks.roads import road
from tests.tasks import every_task


@every_task
def test_sumo_lanes_lie_on_highway_env_lanes_and_nobody_drives_off_an_end(task):
    """Within 1 cm sideways, chords included, without a hole; 400 m beyond every exit, and room before every entry."""
    net = network(road(task))
    last = {edges[-1] for edges in net.routes.values()}
    for index, sumo_lane in net.lanes.items():
        lane = net.road.lane(index)
        points = sumo_lane.shape
        for (x0, y0), (x1, y1) in pairwise(points):
            for k in (0.0, 0.25, 0.5, 0.75, 1.0):
                assert abs(lane.local_coordinates(x0 + k * (x1 - x0), y0 + k * (y1 - y0))[1]) < 0.01
        if (task, index) == ("two-way", ("a", "b", 0)):
            continue  # driven the other way
        begins = not any(net.lanes[other].preceding for other in net.lanes if other[:2] == index[:2])
        first_s, last_s = (lane.local_coordinates(*point)[0] for point in (points[0], points[-1]))
        assert first_s < (-50 + 1e-9 if begins else plans.GAP + plans.OVERHANG)
        is_exit = f"{index[0]}-{index[1]}" in last
        # of a bend there is half a turn at most
        beyond = 199 if isinstance(lane, CircularLane) else 399
        assert last_s > (lane.length + beyond - 1e-9 if is_exit else lane.length - plans.GAP)


def test_two_way_road_of_any_length_keeps_x():
    for length in (800.0, 1600 / 3):
        net = network(road("two-way", road_length=length))
        assert net.place(("a", "b", 1), 30.0) == ("a-b>b", "a-b_0", pytest.approx(700 + 32.5))
        # 200 m along the oncoming lane is x = length - 200; SUMO counts from x = 1500
        expected = 1500 - (length - 200) + 2.5
        assert net.place(("b", "a", 0), 200.0) == ("b-a>a", "b-a_0", pytest.approx(expected))
    assert net.indices["b-a_0"] == ("b", "a", 0)


def test_routes_in_the_ring_start_one_edge_earlier():
    net = network(road("roundabout"))
    assert net.sumo_route(("we", "sx", 0), "exr") == "we-sx>exr"
    assert net.routes["we-sx>exr"] == ("wx-we", "we-sx", "sx-se", "se-ex", "ex-exs", "exs-exr")
    # the ego of the roundabout is bound for a node short of the end
    ego = net.routes[net.sumo_route(("ser", "ses", 0), "nxs")]
    assert ego == ("ser-ses", "ses-se", "se-ex", "ex-ee", "ee-nx", "nx-nxs", "nxs-nxr")
    for index in net.lanes:
        for end in ("sxr", "exr", "nxr", "wxr"):
            if index[1][1:] not in ("xs", "xr") or index[1][0] == end[0]:
                assert net.sumo_route(index, end) in net.routes


def test_placing_follows_the_route_over_joints():
    net = network(road("u-turn"))
    _, lane, position = net.place(("a", "b", 0), 127.0, "d")  # the bumper is 1.5 m into the arc
    assert lane == "b-c_1" and 0 < position < 1.6
    net = network(road("roundabout"))
    _, lane, position = net.place(("we", "sx", 0), -10.0, "exr")  # before its start, as highway-env may
    assert lane == "wx-we_1"
    travelled = 20 * math.radians(48) - 10.0 + 2.5  # of the inner arc from node wx, by the bumper
    assert position / net.stretch(lane) + plans.GAP / 2 == pytest.approx(travelled, abs=0.1)
    straight = net.road.lane(("ser", "ses", 0)).length
    before = net.place(("ses", "se", 0), -5.0, "exr"), net.place(("ser", "ses", 0), straight - 5.0, "exr")
    assert before[0][1] == before[1][1] and before[0][2] == pytest.approx(before[1][2], abs=0.1)


def shifted(road):
    """Its lanes 1 m further south, where SUMO's network is not."""
    return {
        index: replace(lane, start=(lane.start[0], lane.start[1] + 1.0))
        if isinstance(lane, StraightLane)
        else lane
        for index, lane in road.lanes.items()
    }


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: network(road("motorway")), "choose from highway"),
        (lambda: network(road("highway", lanes_count=7)), "lanes_count"),
        (lambda: network(road("two-way", road_length=5000.0)), "road_length"),
        (lambda: network(replace(roads.u_turn(), name="own", net_file="none.xml")), "own"),
        (lambda: network(replace(roads.u_turn(), lanes=shifted(roads.u_turn()))), "beside"),
        (lambda: network(replace(roads.u_turn(), net_file=roads.roundabout().net_file)), "no lane"),
        (lambda: network(road("roundabout")).sumo_route(("exs", "exr", 0), "nxr"), "ends: exr"),
        (lambda: network(road("intersection")).sumo_route(("o0", "ir0", 0)), "ends: o1, o2, o3"),
        (lambda: network(road("two-way")).place(("a", "b", 0), 10.0), "change lane"),
        (lambda: network(road("roundabout")).place(("we", "sx", 0), -60.0, "exr"), "not on route"),
    ],
)
def test_what_cannot_be_is_refused_with_the_choices(call, message):
    with pytest.raises(ValueError, match=message):
        call()
