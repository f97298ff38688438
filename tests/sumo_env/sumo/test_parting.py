"""Random small roads whose lanes part: whenever an ego begins to change lanes there, SUMO does not break down."""

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sumo_env.env import DrivingEnv
from sumo_env.networks.lanes import StraightLane
from sumo_env.networks.mapping import read_net, sumo_lanes_of
from sumo_env.networks.roads import Road
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.sumo.process import SumoProcess
from sumo_env.tasks.base import ego_driver, make_on_lane
from sumo_env.tasks.u_turn import UTurn
from tests.sumo_env.plans import SUMO_DRIVES, build, needs_sumo, route_file
from tests.sumo_env.rollout import drive

pytestmark = needs_sumo
LEFT, IDLE, RIGHT = range(3)
FAR = 200.0  # [m] from where the lanes part to the ends of the roads
NEAR = 40.0  # [m] from where the ego begins at most to there
WIDE = 4.0  # [m] lanes
LASTING = {"lanechange.duration": "0.8"}  # [s]


def plan(rng: np.random.Generator, length: float) -> tuple[str, ...]:
    """The edge a-b and what its lanes lead to: the left ones straight on to c, the others to the right, to k.

    Between them is a joint of any length; SUMO needs 0.1 m.
    """
    count = int(rng.integers(2, 5))
    right, angle, gap = int(rng.integers(1, count)), rng.uniform(0.0, 1.0), 10 ** rng.uniform(-1.5, 0.3)
    x, y, aside = length + FAR * np.cos(angle), -FAR * np.sin(angle), -WIDE * (count - right)
    before, after, bottom = length - gap, length + gap, -WIDE * count
    joint = f"{before:.2f},0 {before:.2f},{bottom:.2f} {after:.2f},{bottom:.2f} {after:.2f},0"
    node = '<node id="{}" x="{:.2f}" y="{:.2f}"{}/>'
    nodes = node.format("a", 0, 0, "") + node.format("b", length, 0, f' shape="{joint}"')
    nodes += node.format("c", length + FAR, 0, "") + node.format("k", x, y, "")
    edge = '<edge id="{0}-{1}" from="{0}" to="{1}" numLanes="{2}" speed="40" spreadType="right"{3}/>'
    fork = f' shape="{length:.2f},{aside:.2f} {x:.2f},{y + aside:.2f}"'
    edges = edge.format("a", "b", count, "") + edge.format("b", "c", count - right, "")
    edges += edge.format("b", "k", right, fork)
    lead_off = [f"a-b {lane} b-k {lane}" for lane in range(right)]
    lead_on = [f"a-b {lane} b-c {lane - right}" for lane in range(right, count)]
    return nodes, edges, ", ".join([*lead_off, *lead_on])


class Parting(UTurn):
    """An ego alone on such a road, anywhere."""

    name = "parting"

    def __init__(self, folder: Path, rng: np.random.Generator) -> None:
        self.length = float(rng.uniform(NEAR + 5.0, 2.0 * NEAR))
        options = "--offset.disable-normalization=true", "--default.lanewidth=4"
        net = build(folder, plan(rng, self.length), *options)
        lanes: dict[Any, StraightLane] = {}
        for lane in reversed(sumo_lanes_of(read_net(net)).values()):  # SUMO counts lanes from the right
            if not lane.id.startswith(":"):
                start, end = lane.id.rpartition("_")[0].split("-")
                number = sum(index[:2] == (start, end) for index in lanes)
                lanes[start, end, number] = StraightLane(lane.shape[0], lane.shape[-1])
        self.its_road = Road(self.name, lanes, ends=("c", "k"), net_file=str(net))

    def road(self, config: Any) -> Road:
        return self.its_road

    def ego(self, config: Any, road: Road, rng: np.random.Generator) -> Any:
        lane = ("a", "b", int(rng.integers(road.count("a", "b"))))
        place = rng.uniform(road.lane(lane).length - NEAR, road.lane(lane).length)
        return make_on_lane(road, "ego", lane, place, float(rng.uniform(5.0, 30.0)), ego_driver(self))

    def vehicles(self, *_: Any) -> list[Any]:
        return []


@pytest.mark.parametrize("seed", range(4))
def test_no_change_of_lanes_breaks_sumo_down_where_lanes_part(tmp_path: Path, seed: int) -> None:
    """The ego begins one anywhere, at any speed, and ends on the road that its lane leads to; nothing holds it up.

    SUMO has broken down at steps of 0.2 s; the end of its worker is an error here.
    """
    rng, ends = np.random.default_rng(seed), set()
    frequency = {"simulation_frequency": 10 if seed == 3 else 5, "policy_frequency": 5, "duration": 60}
    action = {"type": "DiscreteMetaAction", "target_speeds": [5, 10, 15, 20, 25, 30]}
    task = Parting(tmp_path, rng)
    with closing(DrivingEnv(task, {**frequency, "action": action}, simulator=SumoProcess())) as env:
        for episode in range(40):
            env.reset(seed=1000 * seed + episode)
            begins = int(rng.integers(4))
            for step in range(12):
                env.step(int(rng.choice([LEFT, RIGHT])) if step == begins else IDLE)
                assert env.scene.speed[0] >= 4.0 and not env.ego_state.crashed
            if env.scene.x[0] > task.length + 10.0:
                ends.add(env.ego_state.lane[1])
                assert env.ego_state.target_lane == env.ego_state.lane
    assert ends == {"c", "k"}


@pytest.mark.parametrize("seed", [0, 2])
def test_nor_does_one_in_a_scenario_whose_lane_changes_take_their_time(tmp_path: Path, seed: int) -> None:
    rng, endings = np.random.default_rng(seed), set()
    net = build(tmp_path, plan(rng, float(rng.uniform(45.0, 80.0))), "--default.lanewidth=4")
    start = 'departLane="best" departPos="random" departSpeed="random"'
    routes = route_file(tmp_path, f'<vehicle id="ego" depart="0" {start}><route edges="a-b b-c"/></vehicle>')
    action = {"type": "DiscreteMetaAction", "target_speeds": [5, 10, 15, 20, 30]}
    config = {"policy_frequency": 5, "simulation_frequency": 5, "action": action}
    worker = SumoProcess(options=LASTING)
    with closing(SumoDrivingEnv(net, routes, ego_vehicle="ego", config=config, simulator=worker)) as env:
        for episode in range(45):
            env.reset(seed=episode)
            begins = int(rng.integers(5))
            for result in drive(env, [IDLE] * begins + rng.choice([LEFT, RIGHT], 15 - begins).tolist()):
                endings.add(result[4]["ending"])
    assert endings == {"", "missed turn"}


def test_nor_does_a_cut_in(tmp_path: Path) -> None:
    net = build(tmp_path, plan(np.random.default_rng(2), 80.0), "--default.lanewidth=4")
    stop = '<stop lane="b-c_0" endPos="190" duration="900"/>'
    cars = f'<vehicle id="ego" depart="0"><route edges="a-b b-c"/>{stop}</vehicle>'
    for way in ("b-c", "b-k"):
        start = 'begin="0" end="900" probability="0.5" departLane="best" departSpeed="10"'
        cars += f'<flow id="{way}" {start}><route edges="a-b {way}"/></flow>'
    routes = route_file(tmp_path, cars)
    config = {"risk": 1.0, "duration": 90, "simulation_frequency": 5, "action": SUMO_DRIVES}
    worker = SumoProcess(options=LASTING)
    with closing(SumoDrivingEnv(net, routes, ego_vehicle="ego", config=config, simulator=worker)) as env:
        for seed in range(8):
            env.reset(seed=seed, options={"risk_rates": {"cut_in": 1.0}})
            list(drive(env, 0))
