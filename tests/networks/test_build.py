"""The shipped networks are what the plans give, and contain what the simulation relies on."""

from __future__ import annotations

import filecmp
from importlib.util import find_spec
from xml.etree import ElementTree

import pytest

from sumo_env.networks import build, mapping, plans

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
