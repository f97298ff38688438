"""Which lanes are driven: forks inside junctions, lanes for buses and bicycles, lanes that are closed to cars."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from sumo_env.networks import files
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.simulator import SimulatorError
from tests.sumo_env.plans import QUIET, build, needs_sumo, opened, route_file
from tests.sumo_env.rollout import drive

pytestmark = needs_sumo

# A lane that forks inside the junction b; of the two behind it, one ends at c after 17 m.
FORK = (
    "a 0 0, b 150 0, c 175 0, d 330 0",
    "ab a b 1 14, bc b c 2 14, cd c d 1 14",
    "ab 0 bc 0, ab 0 bc 1, bc {} cd 0",
)
# Three lanes, of which the right one is closed; the two joints begin in the middle and the left one.
SHIFTED = ("a 0 0, b 150 0, c 300 0", "ab a b 3 14, bc b c 3 14", "ab 1 bc 0, ab 2 bc 1, ab 2 bc 2")
# The right lane of the main road is for bicycles, the left one for buses, which also have a short cut of their own.
LANES = (
    "a 0 0, b 150 0, c 300 0, d 450 0, n 225 90",
    """
        <edge id="ab" from="a" to="b" numLanes="3" speed="14">
            <lane index="0" allow="bicycle" width="1.5"/> <lane index="1" disallow="bus bicycle"/>
            <lane index="2" allow="bus taxi"/>
        </edge>
        <edge id="bc" from="b" to="c" numLanes="1" speed="14" allow="bus"/>
        <edge id="bn" from="b" to="n" numLanes="1" speed="14"/> <edge id="nc" from="n" to="c" numLanes="1" speed="14"/>
        <edge id="cd" from="c" to="d" numLanes="1" speed="14"/>
    """,
    "ab 2 bc 0, ab 1 bn 0, ab 2 bn 0",
)
TYPES = '<vType id="bus" vClass="bus"/> <vType id="bike" vClass="bicycle"/> <vType id="taxi" vClass="taxi"/>'
FAR = ["ab", "bn", "nc", "cd"]


@pytest.mark.parametrize("lane", [0, 1])
def test_where_a_lane_forks_the_ego_takes_the_way_that_leads_on(tmp_path: Path, lane: int) -> None:
    *plan, joints = FORK
    net = build(tmp_path, (*plan, joints.format(lane)))
    env: Any = SumoDrivingEnv(net, [], ["ab", "bc", "cd"], {**QUIET, "policy_frequency": 10})
    results = [(env.vehicle.target_lane_index, info["arrived"]) for *_, info in drive(env, seed=0)]
    assert results[-1][1]
    assert {index for index, _ in results if index[0] == "bc:from"} == {files.lane("bc", 1 - lane)}


@pytest.mark.parametrize(("lane", "ends"), [(0, {0, 1}), (1, {2})])
def test_connections_decide_which_lane_follows(tmp_path: Path, lane: int, ends: set[int]) -> None:
    """As many joints as lanes, but not one for each."""
    net = build(tmp_path, SHIFTED)
    env = SumoDrivingEnv(net, [], ["ab", "bc"], {**QUIET, "policy_frequency": 10, "initial_speed": 14})
    env.reset(seed=0)
    while (here := env.vehicle.lane_index[2]) != lane:
        env.step(0 if here > lane else 2)
    driven = set()
    for _ in drive(env, 250 * [1]):
        driven |= {env.vehicle.lane_index[2]} if env.vehicle.lane_index[0] == "bc:from" else set()
    assert len(driven) == 1 and driven <= ends  # no lane change that nobody has asked for


def test_vehicles_drive_where_their_class_may(tmp_path: Path) -> None:
    demand = route_file(
        tmp_path,
        f"""{TYPES}
            <vehicle id="b" type="bus" depart="0" departPos="95" departSpeed="8"><route edges="ab bc cd"/></vehicle>
            <trip id="t" type="bus" from="ab" to="cd" depart="0" departPos="135" departSpeed="8"/>
            <vehicle id="k" type="bike" depart="0" departPos="30"><route edges="ab"/></vehicle>
            <vehicle id="x" type="taxi" depart="0" departPos="60" departLane="2"><route edges="ab bn"/></vehicle>
        """,
    )
    env = SumoDrivingEnv(build(tmp_path, LANES), demand, FAR, {**QUIET, "duration": 20})
    lanes: dict[str, set[Any]] = {}
    for _ in drive(env, 12 * [4], seed=0):
        for vehicle in env.road.vehicles:
            lanes.setdefault(vehicle.id, set()).add(vehicle.lane_index)
    closed = files.lane("ab/closed", 0)
    assert lanes.keys() == {"ego", "b", "t", "k", "x"}
    assert files.lane("ab/closed", 1) in lanes["k"]
    assert closed in lanes["b"] | lanes["t"] and closed in lanes["x"]
    assert files.lane("bc/closed") in lanes["b"] and files.lane("bc/closed") in lanes["t"]  # the short cut
    assert all(index[0].startswith("ab:") for index in lanes["ego"])
    assert env.get_available_actions() == [1, 3]  # neither the bus lane nor the bicycles'
    assert env.scene.sizes["b"] == (12.0, 2.5) and env.scene.sizes["k"] == (1.6, 0.65)
    env.export(tmp_path / "episode")
    assert opened(tmp_path / "episode" / "episode.sumocfg")


def test_an_ego_of_another_class_drives_where_its_class_may(tmp_path: Path) -> None:
    file = route_file(tmp_path, TYPES)
    net = build(tmp_path, LANES)
    env = SumoDrivingEnv(net, file, ["ab", "bc", "cd"], ego_type="bus")
    env.reset(seed=0)
    assert env.ego_state.lane == files.lane("ab/closed", 0) and env.scene.sizes["ego"] == (12.0, 2.5)
    with pytest.raises(SimulatorError, match=r"valid route|no lane for vehicles of class 'bicycle'|'ego'"):
        SumoDrivingEnv(net, file, ["ab", "bc"], {"wait": 3}, ego_type="bike").reset(seed=0)
