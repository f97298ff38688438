"""What one may do on roads of other people: solid lines, turns, lights, driving on the left, lanes of other classes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sumo_env.networks import files
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.simulator import SimulatorError
from tests.sumo_env.plans import QUIET, SUMO_DRIVES, build, needs_sumo, opened, route_file, streets
from tests.sumo_env.rollout import drive

pytestmark = needs_sumo
LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)
AHEAD = '<edge id="bc" from="b" to="c" numLanes="2" speed="20"/><edge id="bd" from="b" to="d" speed="14"/>'
# The right lane turns right... to the left lane there is no way but straight on; of three lanes, 0 is the rightmost.
TURNS = "ab 0 bc 0, ab 1 bc 1, ab 2 bd 0"


def road(folder: Path, lanes: str, *options: str, light: str = "priority") -> Path:
    """600 m with three lanes; the left one leads to bd, the others to bc."""
    edge = f'<edge id="ab" from="a" to="b" numLanes="3" speed="20">{lanes}</edge>'
    nodes = f"a 0 0, b 600 0 {light}, c 900 0, d 600 300"
    return build(folder, (nodes, edge + AHEAD, TURNS), *options)


def start(net: Path, way: str = "bc", **config: object) -> SumoDrivingEnv:
    env = SumoDrivingEnv(net, [["ab", "bc"]], ["ab", way], {**QUIET, "duration": 90, **config})
    env.reset(seed=0)
    return env


def number(env: SumoDrivingEnv) -> int:
    """SUMO's number of the ego's lane."""
    return int(env.sumo.vehicle.getLaneID("ego")[-1])


def show(env: SumoDrivingEnv, letter: str) -> None:
    """All lights that there are show the same."""
    lights = env.sumo.trafficlight
    for light in lights.getIDList():
        lights.setRedYellowGreenState(light, letter * len(lights.getRedYellowGreenState(light)))


def test_a_lane_change_over_a_solid_line_is_not_available(tmp_path: Path) -> None:
    """Only lorries may change from lane 1 to the left; everybody may change to the right."""
    env = start(road(tmp_path, '<lane index="1" changeLeft="truck"/>'))
    while number(env) < 1:
        assert LEFT in env.get_available_actions()
        env.step(LEFT)
    assert (env.scene.place.left, env.scene.place.right) == (False, True)
    assert LEFT not in env.get_available_actions()
    for _ in range(8):
        env.step(LEFT)
        assert number(env) == 1 and env.ego_state.target_lane == env.ego_state.lane
    env.step(RIGHT)
    assert number(env) == 0
    for _ in range(10):  # what was asked for over the line is forgotten
        env.step(IDLE)
    assert number(env) == 0


def test_a_closed_lane_is_not_available_also_if_it_is_closed_on_the_way(tmp_path: Path) -> None:
    env = start(road(tmp_path, '<lane index="1" disallow="passenger"/>'))
    assert not env.scene.place.left and not env.scene.place.right
    env = start(road(tmp_path, ""))
    before = number(env)
    assert env.scene.place.left
    env.sumo.lane.setDisallowed(f"ab_{before + 1}", ["passenger"])
    env.step(LEFT)
    assert number(env) == before and not env.scene.place.left


def test_a_route_that_sumo_changes_on_the_way_is_the_ego_s(tmp_path: Path) -> None:
    """From then on its steps are paid their metres of the new way."""
    env = start(road(tmp_path, ""))
    infos = [env.step(IDLE)[4] for _ in range(12)]
    assert env.scene.place.ahead == ("ab", "bc")
    env.sumo.vehicle.setRoute("ego", ["ab", "bd"])
    infos.append(env.step(IDLE)[4])
    assert env.scene.place.ahead == ("ab", "bd") and np.isfinite(env.scene.place.free)
    env.hand_over()
    infos += [info for *_, info in drive(env, IDLE)]
    metres = np.array([info["distance"] for info in infos])
    shares = np.array([info["rewards"]["progress_reward"] for info in infos])
    assert infos[-1]["arrived"] and shares[12:] == pytest.approx(metres[12:] / metres.sum(), abs=1e-3)


def test_a_turn_is_missed_where_the_ego_can_no_longer_turn(tmp_path: Path) -> None:
    """At the end of its lane, not before; an ego that waits there can still go on."""
    net = road(tmp_path, "")
    env = start(net, "bd", policy_frequency=10)
    while number(env) == 2:
        env.step(RIGHT)
    while not (over := env.step(FASTER)[2]):
        free = env.scene.place.free
    assert over and env.scene.place.ended == "missed turn" and free < 3.0
    info = env._info(None)
    assert info["missed_turn"] and not info["arrived"] and not info["crashed"]
    assert info["speed"] == pytest.approx(20.0, abs=0.1)  # it would drive on; that is no hard braking
    env = start(net, "bd", policy_frequency=10)
    while number(env) == 2:
        env.step(RIGHT)
    while env.scene.speed[0] > 0.1 or env.scene.place.free > 60.0:  # stops before the end
        slow = env.scene.speed[0] ** 2 / 6.0 > env.scene.place.free - 8.0
        env.step(SLOWER if slow else FASTER if env.scene.speed[0] < 9.0 else IDLE)
        assert not env.scene.place.ended
    for _ in range(30):
        env.step(LEFT)
    assert number(env) == 1  # who stands changes no lane, but goes on wanting to
    for _ in range(10):
        env.step(FASTER)
    assert number(env) == 2 and np.isinf(env.scene.place.free)


@pytest.mark.parametrize("left_hand", ["false", "true", "1"])
def test_left_is_left_where_people_drive_on_the_left(tmp_path: Path, left_hand: str) -> None:
    net = road(tmp_path, "", f"--lefthand={left_hand}")
    net.write_text(net.read_text().replace('lefthand="true"', f'lefthand="{left_hand}"'))
    env = start(net)
    ways = {LEFT: -1.0, RIGHT: 1.0}  # along y, which points to the right of an ego that drives east
    for action, sign in (*ways.items(), *ways.items()):
        before = env.scene.y[0]
        if env.scene.place.left if action == LEFT else env.scene.place.right:
            env.step(action)
            assert sign * (env.scene.y[0] - before) == pytest.approx(3.2, abs=0.1)
    assert env.vehicle.lane_index == env.ego_state.lane


@pytest.mark.parametrize("light", ["priority", "traffic_light"])
def test_the_ego_sees_to_whom_it_has_to_give_way(tmp_path: Path, light: str) -> None:
    """Others come towards it: one turns to the road bd, to which the ego turns left, one drives straight on."""
    plan = f"a 0 0, b 200 0 {light}, c 400 0, d 200 200", streets("ab", "ba", "bc", "cb", "bd", "db")
    seen = {"type": "Kinematics", "features": ["foe_gap", "foe_speed"], "normalize": False}
    for way, sees in ((["ab", "bd"], True), (["ab", "bc"], False)):
        net = build(tmp_path, plan)
        env = SumoDrivingEnv(net, ego_route=way, config={**QUIET, "duration": 60, "observation": seen})
        assert env.reset(seed=0)[0][0].tolist() == [200.0, 0.0]
        vehicle = env.sumo.vehicle
        show(env, "g")
        env.sumo.route.add("straight", ["cb", "ba"])
        env.sumo.route.add("off", ["cb", "bd"])
        length = env.sumo.lane.getLength("cb_0")
        vehicle.add("turns off", "off", departPos=f"{length - 20}", departSpeed="10")
        vehicle.add("comes", "straight", departPos=f"{length - 70}", departSpeed="10")
        gaps: list[float] = []
        while env.scene.place.lane[0] == "ab:from" and len(gaps) < 15:
            gap, speed = env.step(SLOWER)[0][0]
            gaps.append(float(gap))
            where = {name: vehicle.getRoadID(name) for name in vehicle.getIDList() if name != "ego"}
            far = {name: length - vehicle.getLanePosition(name) for name in where if where[name] == "cb"}
            far |= {name: 0.0 for name in where if where[name].startswith(":")}
            coming = [(gap, vehicle.getSpeed(name)) for name, gap in far.items()]
            nearest = min(coming, default=(200.0, 0.0)) if sees else (200.0, 0.0)
            assert (gap, speed) == pytest.approx(nearest)
        assert (len(set(gaps)) > 5 and 0.0 in gaps) == sees
        if light == "traffic_light":  # a red one stops the others
            show(env, "r")
            vehicle.add("third", "straight", departPos=f"{length - 60}", departSpeed="10")
            assert env.step(SLOWER)[0][0].tolist() == [200.0, 0.0]
        env.close()


def test_an_ego_that_overtakes_on_the_lane_of_oncoming_traffic_makes_progress(tmp_path: Path) -> None:
    """SUMO drives it; there, SUMO counts positions from the other end."""
    roads = ("a 0 0,b 600 0,c 900 0", "ab a b 1 14,ba b a 1 14,bc b c 1 14,cb c b 1 14")
    net = build(tmp_path, roads, "--opposites.guess")
    slow = '<vehicle id="slow" depart="0" departPos="40"><route edges="ab bc"/></vehicle>'
    ego = '<trip id="ego" depart="3" from="ab" to="bc"/>'
    file = route_file(tmp_path, f'<vType id="DEFAULT_VEHTYPE"/>{slow}{ego}')
    env = SumoDrivingEnv(net, file, ego_vehicle="ego", config={"duration": 90, "action": SUMO_DRIVES})
    env.reset(seed=0)
    env.sumo.vehicle.setMaxSpeed("slow", 4.0)
    shares, edges = [], set()
    for *_, info in drive(env, 0):
        shares.append(info["rewards"]["progress_reward"])
        edges.add(env.scene.place.lane[0])
    assert info["arrived"] and "ba:from" in edges
    assert min(shares) >= 0.0 and max(shares) < 0.05 and sum(shares) == pytest.approx(1.0)


def test_a_junction_before_a_red_light_is_no_red_light(tmp_path: Path) -> None:
    """The next light on the way is red already when the ego drives over b."""
    nodes = "a 0 0, b 200 0, s 200 -100, c 400 0 traffic_light, t 400 -100, d 600 0"
    net = build(tmp_path, (nodes, streets("ab", "bc", "cd", "sb", "tc")))
    env = SumoDrivingEnv(net, ego_route=["ab", "bc", "cd"], config={**QUIET, "duration": 90})
    env.reset(seed=0)
    show(env, "r")
    seen = [(info["red_light"], env.scene.x[0] > 390.0) for *_, info in drive(env, FASTER)]
    assert [beyond for ran, beyond in seen if ran] == [True]


def test_a_light_that_is_run_is_an_event_that_can_be_priced_and_can_end_an_episode(tmp_path: Path) -> None:
    net = road(tmp_path, "", light="traffic_light")
    ends: dict[str, Any] = {"red_light_terminal": True, "red_light_reward": -3}
    for letter, more in (("r", {}), ("r", ends), ("G", {})):
        env = start(net, policy_frequency=10, **more)
        show(env, letter)
        *_, (_, reward, terminated, _, _) = results = list(drive(env, FASTER))
        seen = [info["red_light"] for *_, info in results]
        assert terminated and sum(seen) == (letter == "r")
        if more:
            assert seen[-1] and env.ego_state.lane[0] != "ab:from" and reward < -2.0
        else:
            assert env.scene.place.ended == "arrived"


def test_a_red_light_that_turns_green_as_the_ego_passes_is_not_run(tmp_path: Path) -> None:
    """What counts is the light in the very step of SUMO in which the stop line is passed."""
    env = start(road(tmp_path, "", light="traffic_light"), policy_frequency=1)
    show(env, "r")
    while env.step(FASTER)[4]["traffic_light_distance"] > 25.0:
        pass
    show(env, "G")
    for _ in range(4):
        assert not env.step(IDLE)[4]["red_light"]


# -- arrival -------------------------------------------------------------------------------------------------------


def test_who_stands_until_sumo_takes_it_off_the_last_edge_has_not_arrived(tmp_path: Path) -> None:
    net = build(tmp_path, ("a 0 0, b 3000 0", "ab a b 1 20"))
    stops = {"type": "DiscreteMetaAction", "target_speeds": [0.0, 5.0, 20.0]}
    config = {**QUIET, "duration": 60, "action": stops}
    env = SumoDrivingEnv(net, [], ["ab"], config, sumo_options=["--time-to-teleport=10"])
    *_, (_, reward, *_, info) = drive(env, SLOWER, seed=0)
    assert (info["ending"], info["arrived"]) == ("removed", False) and reward < 0.01


def test_the_way_ends_on_the_arrival_edge_also_for_who_is_there(tmp_path: Path) -> None:
    net = build(tmp_path, ("a 0 0, b 60 0, c 120 0, d 180 0", "ab a b 1 14, bc b c 1 14, cd c d 1 14"))
    ego = '<vehicle id="me" depart="0" arrivalEdge="1"><route edges="ab bc cd"/></vehicle>'
    env = SumoDrivingEnv(net, route_file(tmp_path, ego), ego_vehicle="me", config={"action": SUMO_DRIVES})
    env.reset(seed=0)
    left = [env.scene.place.ahead for *_, over, _, _ in drive(env, 0) if not over]
    assert {*left} == {("ab", "bc"), ("bc",)} and env.ego_state.ended == "arrived"


# -- which lanes are driven ------------------------------------------------------------------------------------------

# A lane that forks inside the junction b; of the two behind it, one ends at c after 17 m.
FORK = "a 0 0, b 150 0, c 175 0, d 330 0", "ab a b 1 14, bc b c 2 14, cd c d 1 14"
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
    net = build(tmp_path, (*FORK, f"ab 0 bc 0, ab 0 bc 1, bc {lane} cd 0"))
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
