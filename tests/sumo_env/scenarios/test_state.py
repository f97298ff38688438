"""What SUMO says of the ego's state, and no guess: lane changes, parking, speeds of its type, lights, metres.

Lights also on a real crossing: what `info` says of them, and an ego that obeys.
"""

from collections.abc import Iterator
from contextlib import closing
from itertools import chain, repeat
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scenarios.lights import speed_before
from sumo_env.scene import GREEN, NO_LIGHT, RED, SECONDS_LEFT, UNLIT, YELLOW, Light
from tests.sumo_env.plans import QUIET, SUMO_DRIVES, SUMO_HOME, build, grid, needs_sumo, route_file, streets
from tests.sumo_env.rollout import drive

pytestmark = [needs_sumo, pytest.mark.filterwarnings("ignore:.*")]
LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)
NODES = "a 0 0, b 1500 0"
WIDE = NODES, "ab a b 4 20"
SUBLANES = "--lateral-resolution"
LANES = {"": [], "sublanes": [SUBLANES, "0.8"], "wide sublanes": [SUBLANES, "3.2"]}
LANES |= {"duration": ["--lanechange.duration", "2"]}


@pytest.mark.parametrize("options", LANES)
@pytest.mark.parametrize("place", ["left", "right", "center"])
def test_an_offered_lane_change_is_made_within_5_s(tmp_path: Path, options: str, place: str) -> None:
    car = f'<vType id="own" latAlignment="{place}"/>'
    start = '<vehicle id="ego" type="own" depart="0" departLane="1" departPosLat="{}"><route edges="ab"/></vehicle>'
    routes = route_file(tmp_path, car + start.format(place))
    config = {"duration": 90, "action": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10]}}
    given: dict[str, Any] = {"ego_vehicle": "ego", "config": config, "sumo_options": LANES[options]}
    with closing(SumoDrivingEnv(build(tmp_path, WIDE), routes, **given)) as env:
        env.reset(seed=0)
        env.step(FASTER)
        rng, made = Random(options + place), 0
        for _ in range(8):
            action = rng.choice([one for one in env.get_available_actions() if one in (LEFT, RIGHT)])
            before = env.scene.place.lane[2]
            for _ in range(5):
                env.step(action if env.scene.place.lane[2] == before else IDLE)
            made += env.scene.place.lane[2] == before + (1 if action == RIGHT else -1)
        assert made == 8


@pytest.mark.parametrize(
    ("attributes", "most"), [('vClass="bicycle"', 13.9), ('maxSpeed="8"', 8.0), ('vClass="truck"', 36.2)]
)
@pytest.mark.parametrize("kind", ["DiscreteMetaAction", "ContinuousAction"])
def test_the_fastest_speed_of_a_type_holds(tmp_path: Path, attributes: str, most: float, kind: str) -> None:
    net = build(tmp_path, (NODES, "ab a b 1 25"))
    ego = '<vehicle id="ego" type="own" depart="0"><route edges="ab"/></vehicle>'
    routes = route_file(tmp_path, f'<vType id="own" {attributes}/>{ego}')
    config = {"action": {"type": kind}, "duration": 40}
    with closing(SumoDrivingEnv(net, routes, ego_vehicle="ego", config=config)) as env:
        env.reset(seed=0)
        faster = FASTER if kind == "DiscreteMetaAction" else repeat(np.array([1.0, 0.0]))
        speeds = [result[-1]["speed"] for result in drive(env, faster)]
    assert max(speeds) <= most + 1e-6
    if most < 25.0:
        assert max(speeds) == pytest.approx(most, abs=0.1)


def test_a_car_that_parks_makes_no_progress_and_is_paid_no_more_than_the_way(tmp_path: Path) -> None:
    net = build(tmp_path, ("a 0 0, b 200 0, c 400 0", streets("ab", "bc")))
    for parks in ("true", "false"):
        stop = f'<stop lane="bc_0" endPos="60" duration="6" parking="{parks}"/>'
        routes = route_file(tmp_path, f'<vehicle id="ego" depart="0"><route edges="ab bc"/>{stop}</vehicle>')
        for config in ({"action": SUMO_DRIVES}, {}):
            settings = {"duration": 120, "policy_frequency": 2, **config}
            with closing(SumoDrivingEnv(net, routes, ego_vehicle="ego", config=settings)) as env:
                env.reset(seed=0)
                action, stopped = (0 if config else FASTER), 0
                results = []
                for result in drive(env, action):
                    results.append(result)
                    stopped += env.sumo.vehicle.isStopped("ego") if not result[2] else 0
                progress = [result[-1]["rewards"]["progress_reward"] for result in results]
                assert sum(result[1] for result in results) <= 10.0 + 1e-6
                assert min(progress) > -0.01 and max(progress) < 0.1
                if results[-1][-1]["arrived"]:
                    assert sum(progress) == pytest.approx(1.0, abs=1e-6)
                if config:
                    assert stopped and results[-1][-1]["arrived"]


@pytest.mark.parametrize("length", [4.0, 5.0, 5.2, 5.8, 7.0])
def test_the_whole_way_is_paid_however_short_it_is(tmp_path: Path, length: float) -> None:
    """The ego begins with its front 5 m after the start of the road, or at its end."""
    road = build(tmp_path, (f"a 0 0, b {length} 0", "ab a b 1 10"))
    with closing(SumoDrivingEnv(road, [], ["ab"], {"duration": 20})) as env:
        env.reset(seed=0)
        results = list(drive(env, FASTER))
    assert results[-1][4]["ending"] == "arrived"
    assert sum(info["rewards"]["progress_reward"] for *_, info in results) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("ballistic", [False, True])
@pytest.mark.parametrize("frequency", [1, 2, 10])
def test_the_metres_of_a_step_are_sumo_s(tmp_path: Path, ballistic: bool, frequency: int) -> None:
    """Over random commands: what the ego has driven is where it is."""
    options = ["--step-method.ballistic", "true"] if ballistic else []
    config = {**QUIET, "simulation_frequency": frequency, "duration": 60, "policy_frequency": 1}
    net = build(tmp_path, WIDE)
    with closing(SumoDrivingEnv(net, [["ab"]], ["ab"], config, sumo_options=options)) as env:
        env.reset(seed=0)
        start, total, rng = env.sumo.vehicle.getLanePosition("ego"), 0.0, Random(frequency)
        for _ in range(30):
            info = env.step(rng.choice([IDLE, FASTER, FASTER, SLOWER, LEFT, RIGHT]))[-1]
            total += info["distance"]
            assert total == pytest.approx(env.sumo.vehicle.getLanePosition("ego") - start, abs=1e-6)


@pytest.mark.parametrize("kind", ["static", "actuated", "delay_based", "NEMA"])
def test_no_light_changes_before_the_seconds_that_are_said(tmp_path: Path, kind: str) -> None:
    lights = "--tls.set=B1", f"--tls.default-type={kind}"
    net = grid(tmp_path, "--grid.number=3", "-L=2", "--no-turnarounds", *lights)
    flows = "".join(
        f'<flow id="{name}" begin="0" end="300" probability="0.3" from="{start}" to="{end}"/>'
        for name, start, end in (("we", "A1B1", "B1C1"), ("ns", "B2B1", "B1B0"), ("ew", "C1B1", "B1A1"))
    )
    routes = route_file(tmp_path, flows + '<trip id="ego" depart="30" from="A1B1" to="B1C1"/>')
    features: dict[str, Any] = {"type": "Kinematics", "features": ["x", SECONDS_LEFT]}
    config = {"observation": features, "duration": 200, "policy_frequency": 10, "wait": 900}
    with closing(SumoDrivingEnv(net, routes, ego_vehicle="ego", config=config)) as env:
        env.reset(seed=3)
        said: list[float] = []  # until when [s] the present phase lasts, by what was said in it
        largest, changes, before = 0.0, 0, None
        for _ in range(900):
            if env.step(IDLE if env.scene.light.distance > 40.0 else SLOWER)[2]:
                break
            if env.scene.light.distance == np.inf:
                continue
            phase, now = env.sumo.trafficlight.getPhase("B1"), env.scene.time
            if said and phase != before:
                changes += 1
                assert now >= max(said) - 0.11, (kind, now, said)
                if kind == "static":
                    assert now == pytest.approx(said[-1], abs=0.21)
                said = []
            said.append(now + env.scene.light.seconds)
            before = phase
            largest = max(largest, env.scene.light.seconds)
        assert changes > 2
        assert (largest == 0.0) == (kind == "NEMA")


# -- lights on a real crossing (RiLSA, of eclipse-sumo) --------------------------------------------------------------

SCENARIOS = Path(SUMO_HOME) / "tools/sumolib/scenario/scenarios/RealWorld"
CROSSING = SCENARIOS / "RiLSA_example1/rilsa1.net.xml"
TENTHS = {**QUIET, "duration": 90, "policy_frequency": 10}


def infos(**config: Any) -> Iterator[dict[str, Any]]:
    """Of an episode at full speed, straight on, ten times a second."""
    env = SumoDrivingEnv(CROSSING, [["em", "mw"]], ["sm", "mn"], {**TENTHS, **config})
    yield env.reset(seed=1)[1]
    yield from (result[4] for result in drive(env, chain([FASTER], repeat(IDLE))))


def entered(episode: list[dict[str, Any]]) -> int:
    """Number of the step in which the ego drives into the crossing."""
    return next(k for k, info in enumerate(episode) if info["traffic_light"] == UNLIT)


def test_an_obedient_ego_waits_at_red_and_goes_on_at_green() -> None:
    episode = list(infos(obey_traffic_lights=True))
    first = entered(episode)
    assert episode[first - 1]["traffic_light"] == GREEN
    waiting = [info["traffic_light_distance"] for info in episode[:first] if info["speed"] < 0.01]
    assert len(waiting) > 50 and 0.5 < min(waiting) <= max(waiting) < 1.5
    assert episode[-1]["arrived"]
    speeds = [info["speed"] for info in episode[:first]]
    assert np.diff(speeds).min() > -0.95  # [m/s] in a tenth of a second


@pytest.mark.parametrize("speed", [0.5, 5.0, 14.0, 30.0])
@pytest.mark.parametrize(("state", "braking"), [(RED, 8.0), (YELLOW, 5.0)])
@pytest.mark.parametrize("dt", [0.02, 0.1, 0.2])
def test_who_can_stop_does(speed: float, state: int, braking: float, dt: float) -> None:
    for distance in np.linspace(speed**2 / (2 * braking) + 0.01, speed**2 / 4.0 + 20.0, 20).tolist():
        left, now = distance, speed
        for _ in range(round(60.0 / dt)):
            allowed = min(speed_before(Light(state, left), now, dt), now)
            assert allowed >= now - 9.0 * dt - 1e-9
            now, left = allowed, left - (now + allowed) / 2.0 * dt
        assert now < 0.01 and left > -0.05


def test_who_cannot_stop_drives_on() -> None:
    assert speed_before(Light(YELLOW, 19.0), 14.0, 0.1) == np.inf
    assert speed_before(Light(RED, 10.0), 14.0, 0.1) == np.inf
    assert speed_before(Light(GREEN, 5.0), 14.0, 0.1) == speed_before(NO_LIGHT, 14.0, 0.1) == np.inf


def test_info_names_the_next_light_and_its_distance_and_who_need_not_obey_drives_through_red() -> None:
    episode = list(infos())
    first = entered(episode)
    distances = [info["traffic_light_distance"] for info in episode]
    assert distances[0] == pytest.approx(484.0, abs=3.0)  # the edge is 492 m long
    driven = np.cumsum([info["distance"] for info in episode])
    np.testing.assert_allclose(distances[0] - driven[:first], distances[:first], atol=0.1)
    assert set(distances[first:]) == {np.inf}
    assert {info["traffic_light"] for info in episode[:first]} == {RED}
    assert min(info["speed"] for info in episode[20:]) > 10.0


# -- lights close together, and a light that lets vehicles turn ----------------------------------------------------


def two_lights(folder: Path, apart: int, first: str, second: str, **config: Any) -> Iterator[tuple[Any, ...]]:
    """Full speed over two lights that show these letters; what `step` returns, and the scene."""
    nodes = f"a 0 0, b 200 0 traffic_light, c {200 + apart} 0 traffic_light, d 500 0"
    sides = f", s 200 -90, t {200 + apart} -90"
    plan = nodes + sides, streets("ab", "bc", "cd", "sb", "tc")
    net = build(folder, plan, "--default.junctions.radius=1")
    env = SumoDrivingEnv(net, ego_route=["ab", "bc", "cd"], config={**TENTHS, **config})
    env.reset(seed=0)
    lights = env.sumo.trafficlight
    for light, letter in (("b", first), ("c", second)):
        lights.setRedYellowGreenState(light, letter * len(lights.getRedYellowGreenState(light)))
    for result in drive(env, FASTER if len(env.actions) > 1 else 0):
        yield (*result, env.scene)
    env.close()


@pytest.mark.parametrize("apart", [8, 15, 40])
def test_a_red_light_behind_a_green_one_is_seen_and_obeyed(tmp_path: Path, apart: int) -> None:
    steps = list(two_lights(tmp_path, apart, "G", "r", obey_traffic_lights=True, duration=60))
    assert not any(info["red_light"] for *_, info, _ in steps) and steps[-1][4]["ending"] == "time"
    scenes = [scene for *_, scene in steps]
    assert {scene.light.state for scene in scenes if scene.x[0] > 50.0} == {RED}
    last = scenes[-1]
    assert last.speed[0] < 0.01 and 0.5 < last.light.distance < 1.5 and last.x[0] > 190.0


def test_each_red_light_that_is_run_in_a_step_is_paid(tmp_path: Path) -> None:
    """Also in one step of SUMO."""
    most = set()
    for speed in (6, 8, 10, 12, 14):
        usual = {"policy_frequency": 1, "simulation_frequency": 1, "initial_speed": speed}
        steps = list(two_lights(tmp_path, 5, "r", "r", **usual))
        terms = [info["rewards"]["red_light_reward"] for *_, info, _ in steps]
        most.add(max(terms))
        assert sum(terms) == 2.0 and sum(reward for _, reward, *_ in steps) == pytest.approx(0.0)
        assert [info["red_light"] for *_, info, _ in steps] == [term > 0.0 for term in terms]
    assert 2.0 in most


def test_at_a_light_that_lets_vehicles_turn_an_obedient_ego_stops_and_goes_as_sumo_does(tmp_path) -> None:
    when = []
    for config in ({"obey_traffic_lights": True}, {"action": SUMO_DRIVES}):
        steps = list(two_lights(tmp_path, 100, "s", "G", **config))
        assert steps[-1][4]["arrived"] and not any(info["red_light"] for *_, info, _ in steps)
        at_line = [scene for *_, scene in steps if scene.light.state == RED and scene.light.distance < 3.0]
        assert min(scene.speed[0] for scene in at_line) < 1.0
        when.append(at_line[-1].time)
    assert when[0] == pytest.approx(when[1], abs=0.5)
