"""Networks of a user's own, with nothing but what docs/own-parts.md names, and networks as they are found.

Junctions without a gap, edges of a metre, thousands of lanes.
"""

import random
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from sumo_env.config import ConfigError
from sumo_env.networks import files
from sumo_env.networks.mapping import Network
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.simulator import SimulatorError
from tests.sumo_env.plans import QUIET, SUMO_HOME, build, endings, grid, needs_sumo, route_file
from tests.sumo_env.rollout import drive

pytestmark = needs_sumo

ROUTES = [["A0A1", "A1B1", "B1C1"], ["C2C1", "C1B1", "B1A1"], ["B0B1", "B1B2"]]
EGO = ["A0A1", "A1A2", "A2B2"]

# A merge by hand: a slip road joins a main road with two lanes, which ends in a bend.
MERGE = (
    '<node id="merge" x="300" y="0" type="priority"/>'
    '<node id="west" x="0" y="0"/> <node id="south" x="100" y="-100"/> <node id="east" x="600" y="100"/>',
    """
        <edge id="main" from="west" to="merge" numLanes="2" speed="25" priority="3"/>
        <edge id="slip" from="south" to="merge" numLanes="1" speed="15" priority="1"/>
        <edge id="out" from="merge" to="east" numLanes="2" speed="20" priority="3" shape="300,0 500,0 580,30 600,100"/>
    """,
)
DEPARTING = '<vehicle id="v" depart="0" {}><route edges="main"/></vehicle>'
DEMAND = """
    <vType id="lorry" carFollowModel="Krauss" accel="1.0" maxSpeed="12"/>
    <route id="through" edges="main out"/>
    <vehicle id="first" type="lorry" route="through" depart="0" departLane="first" departPos="120" departSpeed="10"/>
    <vehicle id="late" depart="2.5"><route edges="slip out"/></vehicle>
    <flow id="stream" route="through" begin="4" end="14" number="5" departSpeed="max"/>
"""


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network of netgenerate."""
    options = ["--grid.number=3", "--grid.length=150", "-L=2", "--no-turnarounds"]
    return grid(tmp_path_factory.mktemp("grid"), *options)


@pytest.fixture(scope="module")
def merge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network written by hand, and its demand beside it."""
    folder = tmp_path_factory.mktemp("merge")
    route_file(folder, DEMAND)
    return build(folder, MERGE)


def test_lanes_limits_and_junctions_are_read(blocks: Path, merge: Path) -> None:
    road = files.network(merge).road
    assert road.count("main:from", "main:to") == 2 and road.count("slip:from", "slip:to") == 1
    assert road.lane(files.lane("main")).speed_limit == 25.0
    left, right = (road.lane(files.lane("out", k)) for k in (0, 1))
    assert left.length < right.length  # it bends to the left
    assert ("slip:to", "out:from", 0) in road.lanes
    for net in (blocks, merge):
        for index, lane in files.network(net).road.lanes.items():
            for s in np.linspace(0.5, lane.length - 0.5, 7).tolist():
                found = lane.local_coordinates(*lane.position(s, 0.0))
                assert found == pytest.approx((s, 0.0), abs=0.3), index
    stops, crossing = files.network(blocks).road.stops, ("A1B1", "C1B1", "B0B1", "B2B1")
    # of two roads that cross one has right of way
    assert {files.lane(edge) in stops for edge in crossing} == {True, False}


def test_ways_through_junctions_are_as_long_as_sumo_says(blocks: Path) -> None:
    """Also those of several lanes."""
    env = SumoDrivingEnv(blocks, ROUTES, EGO, QUIET)
    env.reset(seed=0)
    for (start, end), way in files.network(blocks).junctions.items():
        length = env.sumo.lane.getLength(f"{start}_0")
        known = env.sumo.simulation.getDistanceRoad(start, length, end, 0.0, isDriving=True)
        assert way == pytest.approx(known, abs=0.01)


@pytest.mark.parametrize("frequency", [1, 10])
def test_drawn_vehicles_depart_as_often_at_any_policy_frequency(merge: Path, frequency: int) -> None:
    config = {"spawn_probability": 0.5, "duration": 1000, "policy_frequency": frequency}
    env = SumoDrivingEnv(merge, [["main", "out"]], ["slip", "out"], config)
    drawn = env.task.scenario(env.config, 0).traffic.elements
    assert drawn.count('<vehicle id="s') == pytest.approx(500, abs=70)  # three standard deviations


def test_a_network_written_by_hand_with_its_demand(merge: Path) -> None:
    env = SumoDrivingEnv(merge, merge.with_name("d.rou.xml"), ["main", "out"], {"duration": 20})
    assert env.target_speeds == (0.0, 12.5, 25.0)
    seen: dict[str, float] = {}
    for _ in drive(env, seed=0):
        for vehicle in env.road.vehicles:
            seen.setdefault(vehicle.id, env.scene.time)
    assert {"ego", "first", "late", "stream.0"} <= set(seen)
    assert 2.0 <= seen["late"] <= 3.0  # at the end of the policy step in which it departs
    assert env.sumo.vehicle.getTypeID("first") == "lorry"


@pytest.mark.parametrize(
    ("element", "words"),
    [
        ('<trip id="t" from="out" to="main" depart="0"/>', "no valid route"),
        (DEPARTING.format('departLane="7"'), "departLane"),
        ('<vehicle id="v"><route edges="main"/></vehicle>', "depart"),
        (2 * DEPARTING.format(""), "'v' already exists"),
    ],
)
def test_what_sumo_refuses_is_an_error_in_sumo_s_own_words(merge, tmp_path, element, words, capfd) -> None:
    env = SumoDrivingEnv(merge, route_file(tmp_path, element), ["main", "out"])
    with pytest.raises(SimulatorError, match="SUMO cannot begin") as caught:
        env.reset(seed=0)
    assert words in str(caught.value) + capfd.readouterr().err
    assert ".rou.xml" in str(caught.value)


# -- networks as they are found --------------------------------------------------------------------------------------

SHIPPED = Path(SUMO_HOME) / "tools"

# A road that gets from two lanes to one by edges of a metre; the right lane goes on.
NODES, JOINTS = "a 0 0, b 200 0, c 201 0, d 202 0, e 203 0, f 330 0", "ab 0 bc 0, ab 1 bc 1, bc 0 cd 0"
PIECES = NODES, "ab a b 2 14, bc b c 2 14, cd c d 1 14, de d e 1 14, ef e f 1 14", JOINTS
WAY = ["ab", "bc", "cd", "de", "ef"]


@pytest.fixture(scope="module")
def pieces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A road of which three edges are a metre long; the lanes that join them have no length."""
    return build(tmp_path_factory.mktemp("pieces"), PIECES, "--default.junctions.radius=0")


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network of hundreds of lanes."""
    return grid(tmp_path_factory.mktemp("town"), "--grid.number=6", "--grid.length=60", "-L=2")


def walk(network: Network, rng: random.Random, count: int) -> list[str]:
    """Edges for cars one after the other, none twice."""
    open_to = {node: after for node, after in network.road.successors.items() if files.CLOSED not in node}
    ends = {node: [end for end in after if files.CLOSED not in end] for node, after in open_to.items()}
    way = [rng.choice(sorted(node[:-5] for node in ends if node.endswith(":from")))]
    while len(way) < count:
        following = [node[:-5] for node in ends.get(f"{way[-1]}:to", ()) if node[:-5] not in way]
        if not following:
            break
        way.append(rng.choice(following))
    return way


def test_lanes_without_a_length_point_where_their_neighbours_do(pieces: Path) -> None:
    network = files.network(pieces)
    joint = network.road.lane(("cd:to", "de:from", 0))
    assert joint.length < 0.2 and joint.heading_at(0.0) == pytest.approx(0.0, abs=1e-6)
    assert joint.local_coordinates(*joint.position(0.0, 1.0)) == pytest.approx((0.0, 1.0))
    assert all(network.stretch(name) == pytest.approx(1.0, abs=0.01) for name in network.sumo_lanes)
    bend = (0.0, -9.0), (1.0, 0.0), (2.0, 0.0)  # its last piece is beside the joint
    assert files._stub(bend[-1], bend, ())[1] == pytest.approx((2.0 + files.CLOSE, 0.0))


def test_of_many_lanes_those_are_found_that_are_near(town: Path) -> None:
    road = files.network(town).road
    assert len(road.lanes) > 256
    for x, y, reach in np.random.default_rng(1).uniform((-90, -390, 1), (390, 90, 80), (30, 3)).tolist():
        near = road.lanes_near(x, y, reach)
        beside = {index for index, lane in road.lanes.items() if lane.distance(x, y) <= reach}
        assert beside <= set(near) and len(near) < len(road.lanes)


@pytest.mark.parametrize("rule", ["priority", "traffic_light"])
def test_where_people_walk_through_junctions_nothing_changes_for_cars(tmp_path: Path, rule: str) -> None:
    """On lanes of cars and people; walking areas and crossings may lead round a junction for ever."""
    options = "--grid.number=3", "--grid.length=150", f"--default-junction-type={rule}"
    cars = files.network(grid(tmp_path, *options)).road
    shared = files.network(grid(tmp_path, *options, "--walkingareas", "--crossings.guess"))
    assert shared.road.stops.keys() == cars.stops.keys() != set()
    assert shared.road.lanes.keys() == cars.lanes.keys()
    leads = {name: {*lane.following, *lane.preceding} for name, lane in shared.sumo_lanes.items()}
    on_foot = {name for name in leads if re.match(r":.*_[cw]\d+_0", name)}
    assert on_foot and not any(leads[name] for name in on_foot)
    assert on_foot.isdisjoint(set().union(*leads.values()))


def test_a_network_that_somebody_has_is_not_read_again(pieces: Path, tmp_path, monkeypatch) -> None:
    copies = [shutil.copy(pieces, tmp_path / f"{number}.net.xml") for number in range(12)]
    had = [files.network(copy) for copy in copies]
    with monkeypatch.context() as patched:
        patched.setattr(files, "_read", None)
        assert [files.network(copy) for copy in copies] == had
    Path(copies[0]).write_bytes(pieces.read_bytes() + b"\n")
    assert files.network(copies[0]) is not had[0]


def test_edges_of_a_metre_are_driven_and_turns_missed_beyond_them(pieces: Path) -> None:
    """The left lane ends behind the first of them, within one policy step."""
    env = SumoDrivingEnv(pieces, [WAY], WAY, QUIET)
    assert endings(env, range(2), 60 * [2]) == {"arrived_reward"}  # keeps to the right
    assert endings(env, range(2), 60 * [0]) == {"missed_turn_reward"}


def test_vehicles_depart_from_edges_of_a_metre(pieces: Path, tmp_path: Path) -> None:
    demand = route_file(tmp_path, '<vehicle id="v" depart="0"><route edges="bc cd de ef"/></vehicle>')
    env = SumoDrivingEnv(pieces, demand, WAY, {"duration": 5})
    env.reset(seed=0)
    assert (vehicle := env.road.vehicles[1]).id == "v" and vehicle.position[0] < 201.0


def test_short_routes_are_driven(pieces: Path) -> None:
    short = SumoDrivingEnv(pieces, [], ["bc", "cd", "de"], QUIET)
    assert endings(short, range(2), 60 * [3]) == {"arrived_reward"}


@pytest.mark.long
@pytest.mark.parametrize(
    "net", sorted(SHIPPED.rglob("*.net.xml*")), ids=lambda path: str(path.relative_to(SHIPPED))
)
def test_every_network_that_comes_with_sumo_is_driven_where_it_has_lanes_for_cars(net: Path) -> None:
    """Random routes, towns of OpenStreetMap among them (A10KW, bs3d, DRT)."""
    network = files.network(net)
    if all(files.CLOSED in start for start, _, _ in network.lanes):
        return  # rails alone
    rng, driven = random.Random(0), 0
    while driven < 3:
        routes = [walk(network, rng, rng.randint(2, 12)) for _ in range(20)]
        try:
            env = SumoDrivingEnv(net, routes, walk(network, rng, rng.randint(4, 14)), {"duration": 30})
        except ConfigError as error:
            assert "route" in str(error)
            continue
        endings(env, range(3))
        driven += 1
