"""Networks of a user's own, and their demand, with nothing but what docs/own-parts.md names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from sumo_env.networks import files
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.simulator import SimulatorError
from tests.sumo_env.plans import build, grid, needs_sumo, route_file
from tests.sumo_env.rollout import drive, observations

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


@pytest.mark.slow
def test_a_generated_network_is_driven(blocks: Path) -> None:
    config = {"vehicles_count": 15, "risk": 1.0, "duration": 20}
    env = SumoDrivingEnv(blocks, ROUTES, EGO, config, render_mode="rgb_array")
    check_env(env, skip_render_check=True)
    first = observations(env, 1, seed=3)
    other = SumoDrivingEnv(blocks, ROUTES, EGO, config)  # in a worker
    np.testing.assert_array_equal(observations(other, 1, seed=3), first)
    picture = env.render()
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 4


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
