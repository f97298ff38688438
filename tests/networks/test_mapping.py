"""SUMO's lanes lie on highway-env's, and everything that drives finds its lane, position and route.

The shipped networks are what the plans give, and contain what the simulation relies on.
"""

import filecmp
import math
from dataclasses import replace
from importlib.util import find_spec
from itertools import pairwise
from xml.etree import ElementTree

import pytest

from sumo_env.networks import build, mapping, plans, roads
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
    straight = {index: lane for index, lane in road.lanes.items() if isinstance(lane, StraightLane)}
    moved = {index: replace(one, start=(one.start[0], one.start[1] + 1.0)) for index, one in straight.items()}
    return {**road.lanes, **moved}


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


# -- the shipped networks --------------------------------------------------------------------------------------------

PLANS = list(plans.all_plans())
needs_netconvert = pytest.mark.skipif(find_spec("sumo") is None, reason="netconvert comes with eclipse-sumo")


@needs_netconvert
@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.name)
def test_rebuilding_gives_the_same_bytes(plan, tmp_path):
    folder = build.build(plan, tmp_path).parent
    names = [path.name for path in folder.iterdir()]
    assert len(names) == 4  # nodes, edges and connections, and the network
    shipped = build.HERE / folder.name
    assert filecmp.cmpfiles(folder, shipped, names, shallow=False) == (names, [], [])


@needs_netconvert
def test_what_netconvert_complains_about_is_an_error(tmp_path):
    plan = plans.two_way()
    broken = plans.Plan("broken/broken", plan.road, plan.nodes[:1], plan.edges)
    with pytest.raises(RuntimeError, match="broken"):
        build.build(broken, tmp_path)


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.name)
def test_what_the_simulation_relies_on_is_there(plan):
    root = ElementTree.parse(build.HERE / f"{plan.name}.net.xml").getroot()
    lanes, ways = (list(root.iter(tag)) for tag in ("lane", "connection"))
    ways = [way for way in ways if not way.get("from").startswith(":")]
    limits = {round(lane.speed_limit, 4) for lane in plan.road.lanes.values()}  # see test_roads.py
    assert {float(lane.get("speed")) for lane in lanes} == limits  # in bends as well
    # otherwise SUMO's drivers slow down before minor connections until they are 4.5 m from them, in order to see
    assert [float(way.get("visibility")) for way in ways] == [200.0] * len(plan.connections)
    # lane changes are left to the drivers, but for those to lanes that nobody may change to
    sides = "changeLeft", "changeRight"
    closed = {(lane.get("id"), key, lane.get(key)) for lane in lanes for key in sides if lane.get(key)}
    net = mapping.network(plan.road)
    assert closed == {
        (net.lanes[start, end, lane].id, key, plans.NOBODY)
        for start, end, lane in plan.road.lanes
        for side, key in zip((-1, 1), sides, strict=True)
        if (start, end, lane + side) in plan.road.lanes and plan.road.beside((start, end, lane), side) is None
    }
    # at junctions that are `unregulated` SUMO checks no collisions
    assert {junction.get("type") for junction in root.iter("junction")} <= {"priority", "dead_end"}
    # no turn is split by an internal junction
    assert sum(len(edge) for edge in root.iter("edge") if edge.get("function") == "internal") == len(ways)


def test_right_of_way():
    """East-west before north-south at the intersection; the ring before its entries."""

    def yields(net: str, junction: str) -> dict[tuple[str, str], bool]:
        root = ElementTree.parse(build.HERE / net).getroot()
        (node,) = (j for j in root.iter("junction") if j.get("id") == junction)
        answers = {int(r.get("index")): "1" in r.get("response") for r in node.iter("request")}
        links = [c for c in root.iter("connection") if (c.get("via") or "").startswith(f":{junction}_")]
        place = {lane: k for k, lane in enumerate(node.get("intLanes").split())}
        return {(c.get("from"), c.get("to")): answers[place[c.get("via")]] for c in links}

    crossing = yields("intersection/intersection.net.xml", "x")
    assert not crossing["o1-ir1", "il3-o3"] and not crossing["o3-ir3", "il1-o1"]
    assert crossing["o0-ir0", "il2-o2"] and crossing["o0-ir0", "il1-o1"] and crossing["o1-ir1", "il2-o2"]
    entry = yields("roundabout/roundabout.net.xml", "se")
    assert entry["ses-se", "se-ex"] and not entry["sx-se", "se-ex"]
