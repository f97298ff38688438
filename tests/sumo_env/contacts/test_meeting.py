"""Contacts and times to collision where two vehicles can meet, and none where one road merely crosses another."""

import math
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from sumolib.geomhelper import polygonOffsetWithMinimumDistanceToPoint

from sumo_env.networks import files
from sumo_env.networks.mapping import network
from sumo_env.networks.meeting import Meeting, Spot
from sumo_env.networks.roads import road
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.sumo import nearby_vehicles
from sumo_env.tasks import TASKS
from tests.sumo_env.plans import QUIET, another, build, needs_sumo, route_file
from tests.sumo_env.rollout import drive

pytestmark = needs_sumo

FASTER = 3
SIDE_ROAD = "s 200 -200 0, n 200 200 0"
CAR, BUS = 5.0, 18.0  # lengths [m]


def nodes(text: str) -> str:
    """Nodes with heights, each as "id x y z"."""
    rows = (row.split() for row in text.split(","))
    return "".join(f'<node id="{id}" x="{x}" y="{y}" z="{z}"/>' for id, x, y, z in rows)


def edges(*rows: str) -> str:
    """Edges with one lane, each as its two nodes and, after a space, further attributes."""
    found = [f"{row} ".split(" ", 1) for row in rows]
    return "".join(f'<edge id="{id}" from="{id[0]}" to="{id[1]}" speed="14" {more}/>' for id, more in found)


def neighbours(one: str, other: str) -> str:
    """An edge whose only lane is beside another one, for overtaking."""
    lane = f'<lane index="0"><neigh lane="{other}_0"/></lane>'
    return f'<edge id="{one}" from="{one[0]}" to="{one[1]}" numLanes="1" speed="14">{lane}</edge>'


# Roads that cross at (200, 0) without a junction.
FLAT = nodes(f"w 0 0 0, e 400 0 0, {SIDE_ROAD}"), edges("we", "sn")
# A road that crosses itself at (140, 0): as one edge, as two that a junction joins, as a ramp over its own road.
TURN = "200,0 260,60 200,120"
LOOP = nodes("a 0 0 0, b 140 -150 0"), edges(f'ab shape="0,0 {TURN} 140,60 140,-150"')
BACK, RAMP = 'mb shape="200,120 140,60 140,-150"', 'mn shape="100,0 160,-40 230,-40 240,-20 240,200"'
TWO_EDGES = nodes("a 0 0 0, m 200 120 0, b 140 -150 0"), edges(f'am shape="0,0 {TURN}"', BACK)
FLYOVER = nodes("a 0 0 0, m 100 0 0, e 500 0 0, n 240 200 0"), edges("am", "me", RAMP)
# Two roads drawn over each other that share no junction, and two that share both.
PARALLEL = nodes("w 0 0 0, e 400 0 0, v 0 1 0, f 400 1 0"), edges("we", "vf")
ENDS = nodes("w 0 0 0, e 400 0 0")
OPPOSITE = ENDS, edges('we shape="0,0 400,0"', 'ew shape="400,-2 0,-2"')
OVERTAKING = ENDS, neighbours("we", "ew") + neighbours("ew", "we")
JUNCTION = (
    nodes(f"w 0 0 0, m 200 0 0, e 400 0 0, {SIDE_ROAD}"),
    edges("wm", "me", "sm", "mn"),
    '<connection from="sm" to="mn"/><connection from="wm" to="me"/>',
)
STRETCHED = ENDS, edges('we length="1600"')
HILL = nodes("w 0 0 0, m 200 0 20, e 400 0 0"), edges("wm", "me")
MERGE = nodes("w 0 0 0, s 40 -90 0, m 200 0 0, e 400 0 0"), edges("wm", "sm", "me")
# A ramp that is drawn over the main road for some hundred metres, and edges of a metre.
NARROW = nodes("w 0 0 0, s 0 -9 0, m 300 0 0, e 400 0 0"), edges("wm", "sm", "me")
PIECES = nodes("w 0 0 0, a 200 0 0, b 201 0 0, c 202 0 0, e 400 0 0"), edges("wa", "ab", "bc", "ce")


class Other(NamedTuple):
    """A vehicle beside the ego: its route, the lane, the point of the lane nearest to its front, the speed it keeps.

    overtakes: whether it changes to the lane on its left.
    """

    route: Sequence[str]
    lane: str
    x: float
    y: float
    speed: float = 0.0
    overtakes: bool = False


class Drive(NamedTuple):
    """What an ego that goes straight ahead met with: with whom it crashed, and what `info` said at each step."""

    crash: dict[str, Any]
    infos: list[dict[str, Any]]

    @property
    def least_ttc(self) -> float:
        """[s]"""
        return min(info["min_ttc_before_contact"] for info in self.infos)


def straight_on(folder: Path, plan: tuple[str, ...], way: Sequence[str], other: Other) -> Drive:
    """The ego drives its way as fast as allowed, and the other one knows nothing of it."""
    net = netconvert(folder, plan)
    lane = files.network(net).sumo_lanes[other.lane]
    place = polygonOffsetWithMinimumDistanceToPoint((other.x, -other.y), lane.shape)
    with closing(SumoDrivingEnv(net, [way], way, {**QUIET, "duration": 50})) as env:
        env.reset(seed=0)
        position = min(place * lane.length / lane.drawn, lane.length)
        another(env, other.route, other.lane, position, other.speed)
        if other.overtakes:
            env.sumo.vehicle.changeLaneRelative("another", 1, 0.0)
        infos = [result[-1] for result in drive(env, FASTER)]
        return Drive(infos[-1]["crash"], infos)


def netconvert(folder: Path, plan: tuple[str, ...]) -> Path:
    """The network of a plan, in its coordinates."""
    return build(folder, plan, "--no-turnarounds", "--offset.disable-normalization")


# -- no contact --------------------------------------------------------------------------------------------

NEVER = {
    "roads across each other": (FLAT, ["we"], Other(["sn"], "sn_0", 201.6, 0.0)),
    "a ramp over its own road": (FLYOVER, ["am", "me"], Other(["mn"], "mn_0", 241.6, 0.0)),
    "roads drawn over each other": (PARALLEL, ["we"], Other(["vf"], "vf_0", 150.0, 0.0)),
}


@pytest.mark.parametrize("case", NEVER)
def test_roads_that_cross_without_a_junction_never_meet(case: str, tmp_path, monkeypatch) -> None:
    found = straight_on(tmp_path, *NEVER[case])
    assert found.infos[-1]["arrived"] and not found.crash
    assert found.least_ttc == math.inf
    assert not any(info["near_miss"] or info["cost"] for info in found.infos)
    # the outlines alone do touch
    monkeypatch.setattr(Meeting, "can_meet", lambda *_: True)
    assert straight_on(tmp_path, *NEVER[case]).crash["detected_by"] == "geometry"


@pytest.mark.parametrize(
    ("plan", "way", "lane"),
    [(LOOP, ["ab"], "ab_0"), (TWO_EDGES, ["am", "mb"], "mb_0")],
    ids=["one edge", "two edges"],
)
def test_a_road_that_crosses_itself_is_met_by_the_way_round(plan, way, lane, tmp_path, monkeypatch) -> None:
    other = Other(way[-1:], lane, 138.4, -3.5)
    found = straight_on(tmp_path, plan, way, other)
    assert (found.crash["other"], found.crash["type"]) == ("another", "rear-end")
    driven, ttc = np.array([(info["distance"], info["min_ttc"]) for info in found.infos]).T
    assert np.isinf(ttc[driven.cumsum() < 160.0]).all()
    monkeypatch.setattr(Meeting, "can_meet", lambda *_: True)
    assert straight_on(tmp_path, plan, way, other).crash["type"] == "junction"


@pytest.mark.parametrize(("height", "kind"), [(8, "rear-end"), (2, "junction")])
def test_where_the_way_is_short_heights_decide(height: int, kind: str, tmp_path: Path) -> None:
    """A road crosses itself, and SUMO's length of its edge is an eighth of the drawn one."""
    up = f"200,0,0 260,60,{height} 200,120,{height} 140,60,{height} 140,-150,{height}"
    spiral = nodes(f"a 0 0 0, b 140 -150 {height}"), edges(f'ab length="80" shape="0,0,0 {up}"')
    found = straight_on(tmp_path, spiral, ["ab"], Other(["ab"], "ab_0", 138.4, -3.5))
    assert (found.crash["other"], found.crash["type"]) == ("another", kind)


# -- real crashes ------------------------------------------------------------------------------------------

REAL: dict[str, tuple[Any, ...]] = {
    "on an edge that is longer than drawn": (STRETCHED, ["we"], Other(["we"], "we_0", 60.0, 0.0), "rear-end"),
    "edges between the same junctions": (OPPOSITE, ["we"], Other(["ew"], "ew_0", 200.0, 0.0), "frontal"),
    "across the end of an edge": (JUNCTION, ["wm", "me"], Other(["me"], "me_0", 206.0, 0.0), "rear-end"),
    "a ramp drawn over the road": (NARROW, ["wm", "me"], Other(["sm", "me"], "sm_0", 240.0, 0.0), "side"),
    "within a crossing": (JUNCTION, ["wm", "me"], Other(["sm", "mn"], ":m_0_0", 201.6, 1.0), "junction"),
    "within a merge": (MERGE, ["wm", "me"], Other(["sm", "me"], ":m_0_0", 201.6, 1.0), "rear-end"),
    "overtaking": (OVERTAKING, ["we"], Other(["ew"], "ew_0", 250.0, 0.0, 8.0, True), "frontal"),
}


@pytest.mark.parametrize("case", REAL)
def test_a_real_crash_is_found(case: str, tmp_path: Path) -> None:
    *given, kind = REAL[case]
    found = straight_on(tmp_path, *given)
    assert (found.crash["other"], found.crash["type"]) == ("another", kind)
    assert found.infos[-1]["cost"] == 1.0
    assert found.least_ttc < 0.2


def test_a_report_of_sumo_counts_in_any_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Meeting, "can_meet", lambda *_: False)
    crash = straight_on(tmp_path, FLAT, ["we"], Other(["we"], "we_0", 150.0, 0.0)).crash
    assert (crash["other"], crash["type"]) == ("another", "rear-end")
    assert crash["detected_by"] in ("sumo", "both")


def test_the_time_to_collision_looks_beyond_short_edges(tmp_path: Path) -> None:
    """At a vehicle 60 m away, on an edge with which the ego's own shares no junction."""
    found = straight_on(tmp_path, PIECES, ["wa", "ab", "bc", "ce"], Other(["ce"], "ce_0", 260.0, 0.0))
    assert found.infos[-1]["crashed"]
    assert any(4.0 < info["min_ttc"] < 8.0 for info in found.infos)


# -- the rule itself ---------------------------------------------------------------------------------------


def test_the_five_tasks_ask_nothing() -> None:
    """No road of theirs crosses another one without a junction."""
    assert all(network(road(task)).meeting is None for task in TASKS)


CARS = 2 * CAR
# A plan, two places, and whether they are near enough for vehicles of these lengths that drive on together [m].
NEAR = [
    # the back of a long vehicle is on the edges behind; others are there soon
    (PIECES, Spot("wa_0", 197.0), Spot("ce_0", 10.0), BUS + CAR, 0.0, True),
    (PIECES, Spot("wa_0", 197.0), Spot("ce_0", 10.0), CARS, 0.0, False),
    # a ramp and its road, as long as they are beside each other
    (NARROW, Spot("wm_0", 150.0), Spot("sm_0", 150.0), CARS, 0.0, True),
    (NARROW, Spot("wm_0", 20.0), Spot("sm_0", 20.0), CARS, 0.0, False),
    # heights differ more where vehicles have a way to go
    (HILL, Spot("wm_0", 160.0, 14.0), Spot("wm_0", 180.0, 18.0), CARS, 0.0, False),
    (HILL, Spot("wm_0", 160.0, 14.0), Spot("wm_0", 180.0, 18.0), CARS, 20.0, True),
    # off the road
    (FLAT, Spot("", -1e9), Spot("we_0", 5.0), CARS, 0.0, True),
]


def test_who_can_meet(tmp_path: Path) -> None:
    for plan, one, other, lengths, driven, expected in NEAR:
        can_meet = files.network(netconvert(tmp_path, plan)).meeting.can_meet
        assert {can_meet(*two, lengths, driven) for two in ((one, other), (other, one))} == {expected}, one


def test_a_junction_is_left_by_the_way_that_was_taken(tmp_path: Path) -> None:
    net = files.network(netconvert(tmp_path, MERGE))
    for start in ("wm", "sm"):
        inside = net.meeting.inside(Spot("me_0", 2.0), CAR, start)
        assert inside == list(net.sumo_lanes[f"{start}_0"].following) != []


def test_the_ego_is_as_large_as_its_vehicle_type(tmp_path: Path) -> None:
    """A lorry of 16 m hits what stands 8 m ahead of its middle."""
    demand = route_file(
        tmp_path,
        '<vType id="lorry" vClass="truck" length="16" width="2.5"/>'
        '<vehicle id="parked" depart="0" departPos="120"><route edges="we"/>'
        '<stop lane="we_0" endPos="121" duration="99"/></vehicle>',
    )
    with closing(SumoDrivingEnv(netconvert(tmp_path, FLAT), demand, ["we"], ego_type="lorry")) as env:
        *_, (_, _, _, _, info) = drive(env, FASTER, seed=0)
        crash = info["crash"]
    assert (crash["other"], crash["type"]) == ("parked", "rear-end")
    assert crash["relative_x"] == pytest.approx(8.0 + 2.5, abs=0.01)


def test_of_a_vehicle_of_several_parts_the_parts_behind_follow_the_road(tmp_path, monkeypatch) -> None:
    """A long bus turns right while the ego drives past on its left; its outline in one piece would swing out."""
    plan = ("a 0 0,b 200 0,c 400 0,d 200 -200", "ab a b 2 14,bc b c 1 14,bd b d 1 14", "ab 0 bd 0,ab 1 bc 0")
    net = build(tmp_path, plan)
    kind = '<vType id="bus" vClass="bus" guiShape="bus/flexible" length="18"/>'
    start = 'type="bus" depart="0" departLane="0" departPos="{}" departSpeed="{}"'
    bus = f'{kind}<vehicle id="bus" {start}>{{}}</vehicle>'

    def driven(position: float, speed: float, way: str) -> dict[str, Any]:
        ego = '<vehicle id="ego" depart="0" departLane="1" departSpeed="10"><route edges="ab bc"/></vehicle>'
        file = route_file(tmp_path, bus.format(position, speed, way) + ego)
        env = SumoDrivingEnv(net, file, ego_vehicle="ego", config={"duration": 50})
        with closing(env):
            *_, (*_, info) = drive(env, FASTER, 0)
        return dict(info)

    turns = 55, 7, '<route edges="ab bd"/>'
    assert driven(*turns)["ending"] == "arrived"
    monkeypatch.setattr(nearby_vehicles, "BENDING", ())
    monkeypatch.setattr(nearby_vehicles, "LONG", math.inf)
    assert driven(*turns)["crash"]["detected_by"] == "geometry"
    monkeypatch.undo()
    stands = 150, 0, '<route edges="ab bd"/><stop lane="ab_1" endPos="150" duration="90"/>'
    crash = driven(*stands)["crash"]
    assert (crash["other"], crash["type"], crash["detected_by"]) == ("bus", "rear-end", "both")
