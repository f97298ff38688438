"""Which lanes are driven: forks inside junctions, lanes for buses and bicycles, lanes that are closed to cars."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from sumo_env.config import ConfigError
from sumo_env.env import SumoDrivingEnv
from sumo_env.networks import files
from tests.sumo_env.plans import QUIET, build, needs_sumo, opened
from tests.sumo_env.rollout import drive

pytestmark = needs_sumo

# A lane that forks inside the junction b; of the two behind it, one ends at c after 17 m.
FORK = {
    "nod": """<nodes>
        <node id="a" x="0" y="0"/> <node id="b" x="150" y="0"/> <node id="c" x="175" y="0"/>
        <node id="d" x="330" y="0"/>
    </nodes>""",
    "edg": """<edges>
        <edge id="ab" from="a" to="b" numLanes="1" speed="14"/> <edge id="bc" from="b" to="c" numLanes="2" speed="14"/>
        <edge id="cd" from="c" to="d" numLanes="1" speed="14"/>
    </edges>""",
    "con": """<connections>
        <connection from="ab" to="bc" fromLane="0" toLane="0"/> <connection from="ab" to="bc" fromLane="0" toLane="1"/>
        <connection from="bc" to="cd" fromLane="{}" toLane="0"/>
    </connections>""",
}
# Three lanes, of which the right one is closed; the two joints begin in the middle and the left one.
SHIFTED = {
    "nod": '<nodes><node id="a" x="0" y="0"/> <node id="b" x="150" y="0"/> <node id="c" x="300" y="0"/></nodes>',
    "edg": """<edges>
        <edge id="ab" from="a" to="b" numLanes="3" speed="14"/> <edge id="bc" from="b" to="c" numLanes="3" speed="14"/>
    </edges>""",
    "con": """<connections>
        <connection from="ab" to="bc" fromLane="1" toLane="0"/> <connection from="ab" to="bc" fromLane="2" toLane="1"/>
        <connection from="ab" to="bc" fromLane="2" toLane="2"/>
    </connections>""",
}


# The right lane of the main road is for bicycles, the left one for buses, which also have a short cut of their own.
LANES = {
    "nod": """<nodes>
        <node id="a" x="0" y="0"/> <node id="b" x="150" y="0"/> <node id="c" x="300" y="0"/>
        <node id="d" x="450" y="0"/>        <node id="n" x="225" y="90"/>
    </nodes>""",
    "edg": """<edges>
        <edge id="ab" from="a" to="b" numLanes="3" speed="14">
            <lane index="0" allow="bicycle" width="1.5"/> <lane index="1" disallow="bus bicycle"/>
            <lane index="2" allow="bus taxi"/>
        </edge>
        <edge id="bc" from="b" to="c" numLanes="1" speed="14" allow="bus"/>
        <edge id="bn" from="b" to="n" numLanes="1" speed="14"/> <edge id="nc" from="n" to="c" numLanes="1" speed="14"/>
        <edge id="cd" from="c" to="d" numLanes="1" speed="14"/>
    </edges>""",
    "con": """<connections>
        <connection from="ab" to="bc" fromLane="2" toLane="0"/> <connection from="ab" to="bn" fromLane="1" toLane="0"/>
        <connection from="ab" to="bn" fromLane="2" toLane="0"/>
    </connections>""",
}
TYPES = '<vType id="bus" vClass="bus"/> <vType id="bike" vClass="bicycle"/> <vType id="taxi" vClass="taxi"/>'
FAR = ["ab", "bn", "nc", "cd"]


@pytest.mark.parametrize("lane", [0, 1])
def test_where_a_lane_forks_the_ego_takes_the_way_that_leads_on(tmp_path: Path, lane: int) -> None:
    plan = {**FORK, "con": FORK["con"].format(lane)}
    env = SumoDrivingEnv(build(tmp_path, plan), [], ["ab", "bc", "cd"], {**QUIET, "policy_frequency": 10})
    results = [(env.vehicle.target_lane_index, info["arrived"]) for *_, info in drive(env, seed=0)]
    assert results[-1][1]
    assert {index for index, _ in results if index[0] == "bc:from"} == {files.lane("bc", 1 - lane)}
    env.close()


@pytest.mark.parametrize(("lane", "ends"), [(0, {0, 1}), (1, {2})])
def test_connections_decide_which_lane_follows(tmp_path: Path, lane: int, ends: set[int]) -> None:
    """As many joints as lanes, but not one for each."""
    net, way = build(tmp_path, SHIFTED), ("ab:from", "ab:to", "bc:from", "bc:to")
    road = files.network(net).road
    assert road.next_lane(road.next_lane(files.lane("ab", lane), way), way)[2] in ends
    env = SumoDrivingEnv(net, [], ["ab", "bc"], {**QUIET, "policy_frequency": 10, "initial_speed": 14})
    env.reset(seed=next(seed for seed in range(20) if starts(env, seed) == lane))
    driven = set()
    for _ in drive(env, 250 * [1]):
        driven |= {env.vehicle.lane_index[2]} if env.vehicle.lane_index[0] == "bc:from" else set()
    assert len(driven) == 1 and driven <= ends  # no lane change that nobody has asked for
    env.close()


def starts(env: SumoDrivingEnv, seed: int) -> int:
    """Number of the lane in which the ego starts."""
    env.reset(seed=seed)
    return env.vehicle.lane_index[2]


def test_vehicles_drive_where_their_class_may(tmp_path: Path) -> None:
    net, demand = build(tmp_path, LANES), tmp_path / "d.rou.xml"
    demand.write_text(
        f"""<routes>{TYPES}
            <vehicle id="b" type="bus" depart="0" departPos="95" departSpeed="8"><route edges="ab bc cd"/></vehicle>
            <trip id="t" type="bus" from="ab" to="cd" depart="0" departPos="135" departSpeed="8"/>
            <vehicle id="k" type="bike" depart="0" departPos="30"><route edges="ab"/></vehicle>
            <vehicle id="x" type="taxi" depart="0" departPos="60" departLane="2"><route edges="ab bn"/></vehicle>
        </routes>"""
    )
    env = SumoDrivingEnv(net, demand, FAR, {**QUIET, "duration": 20})
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
    env.close()
    assert opened(tmp_path / "episode" / "episode.sumocfg")


@pytest.mark.parametrize(
    ("demand", "message"),
    [
        (
            '<vehicle id="v" depart="0"><route edges="ab bc"/></vehicle>',
            "edge 'bc', .* not have for passenger cars",
        ),
        (
            '<vehicle id="v" depart="0" type="bike"><route edges="ab bc"/></vehicle>',
            "vehicles of class 'bicycle'",
        ),
        (
            '<trip id="v" depart="0" type="bike" from="ab" to="bc"/>',
            "no route leads from edge 'ab' to edge 'bc'",
        ),
        ('<vehicle id="v" depart="0" departLane="2"><route edges="ab"/></vehicle>', "departs on lane 2"),
    ],
)
def test_a_route_that_a_class_may_not_drive_is_named(tmp_path: Path, demand: str, message: str) -> None:
    file = tmp_path / "d.rou.xml"
    file.write_text(f"<routes>{TYPES}{demand}</routes>")
    with pytest.raises(ConfigError, match=message):
        SumoDrivingEnv(build(tmp_path, LANES), file, FAR).reset(seed=0)
