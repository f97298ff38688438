"""The shipped networks are what the plans give, and contain what the simulation relies on."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest

from sumo_env.networks import build, plans

SPEEDS = {"highway": 30.0, "two-way": 20.0, "roundabout": 20.0, "intersection": 10.0, "u-turn": 20.0}
PLANS = {plan.name: plan for plan in plans.all_plans()}


@pytest.fixture(params=PLANS)
def built(request):
    plan = PLANS[request.param]
    return plan, ElementTree.parse(build.HERE / f"{plan.name}.net.xml").getroot()


def test_rebuilding_gives_the_same_bytes():
    pytest.importorskip("sumo", reason="netconvert comes with eclipse-sumo")
    assert build.stale() == []


def test_a_changed_file_is_noticed(tmp_path, monkeypatch, capsys):
    pytest.importorskip("sumo", reason="netconvert comes with eclipse-sumo")
    monkeypatch.setattr(plans, "all_plans", lambda: (plans.two_way(),))
    build.build(plans.two_way(), tmp_path)
    assert build.stale(tmp_path) == []
    net = tmp_path / "two_way" / "two_way.net.xml"
    net.write_text(net.read_text().replace("20.0000", "19.0000"))
    (tmp_path / "two_way" / "two_way.nod.xml").unlink()
    assert build.stale(tmp_path) == ["two_way/two_way.nod.xml", "two_way/two_way.net.xml"]


def test_what_netconvert_complains_about_is_an_error(tmp_path):
    pytest.importorskip("sumo", reason="netconvert comes with eclipse-sumo")
    plan = plans.two_way()
    broken = plans.Plan("broken/broken", plan.road, plan.nodes[:1], plan.edges)
    with pytest.raises(RuntimeError, match="broken"):
        build.build(broken, tmp_path)


def test_no_lane_limits_bends(built):
    plan, root = built
    speeds = {float(lane.get("speed")) for lane in root.iter("lane")}
    assert speeds == {SPEEDS[plan.road.name]}


def test_drivers_see_every_junction_from_afar(built):
    """Otherwise SUMO's drivers slow down before minor connections until they are 4.5 m from them, in order to see."""
    plan, root = built
    ways = [c for c in root.iter("connection") if not c.get("from").startswith(":")]
    assert len(ways) == len(plan.connections)
    assert all(float(c.get("visibility")) == 200.0 for c in ways)


def test_lane_changes_are_left_to_the_drivers(built):
    _, root = built
    assert not any(lane.get("changeLeft") or lane.get("changeRight") for lane in root.iter("lane"))


def test_collisions_are_checked_at_every_junction(built):
    """SUMO never checks `unregulated` ones."""
    _, root = built
    kinds = {junction.get("type") for junction in root.iter("junction")}
    assert kinds <= {"priority", "dead_end"}


def test_no_turn_is_split_by_an_internal_junction(built):
    _, root = built
    joints = [edge for edge in root.iter("edge") if edge.get("function") == "internal"]
    ways = [c for c in root.iter("connection") if not c.get("from").startswith(":")]
    assert sum(len(edge) for edge in joints) == len(ways)


def test_no_trace_of_the_machine(built):
    plan, _ = built
    for suffix in build.SUFFIXES:
        text = (build.HERE / f"{plan.name}{suffix}").read_text()
        assert "<!--" not in text
        assert not re.search(r"\b20\d\d-\d\d-\d\d|value=\"/", text)


def test_roundabout_is_known_as_one():
    root = ElementTree.parse(build.HERE / "roundabout/roundabout.net.xml").getroot()
    (ring,) = root.iter("roundabout")
    assert set(ring.get("nodes").split()) == {"se", "ex", "ee", "nx", "ne", "wx", "we", "sx"}


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
