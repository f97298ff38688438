"""Outlines that touch where SUMO sees no collision: at lane changes, sideways, on ways through a junction."""

from contextlib import closing
from pathlib import Path
from random import Random
from typing import Any

import pytest

from sumo_env.networks import files
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scenarios.route_ego import RouteEgo
from sumo_env.sumo.session import Session
from tests.sumo_env.plans import QUIET, SUMO_DRIVES, another, build, needs_sumo, route_file, streets
from tests.sumo_env.rollout import drive
from tests.sumo_env.scenarios.driven import KINDS

pytestmark = [needs_sumo, pytest.mark.filterwarnings("ignore:.*")]
LEFT, IDLE, RIGHT, FASTER, _ = range(5)
KEY = "overlaps_are_crashes"

ROAD = "a 0 0, b 300 0"
TWO, WIDE = (ROAD, "ab a b 2 20"), (ROAD, "ab a b 3 20")
ARMS, WAYS = "w -100 0, e 100 0, s 0 -100, n 0 100, c 0 0 {}", "wc 0 ce 0, sc 0 cn 0"


def drawn_elsewhere(net: Path, lane: str, shape: str) -> Path:
    """A network with another shape of a lane, which netconvert itself would make even."""
    text = net.read_text()
    assert lane in text
    net.write_text(text.replace(lane, shape))
    return net


@pytest.mark.parametrize("by_sumo", [False, True])
def test_lanes_that_are_drawn_over_each_other(tmp_path: Path, by_sumo: bool) -> None:
    """Who drives past a car there crashes by command; where SUMO drives, which sees two lanes, nobody does."""
    net = drawn_elsewhere(build(tmp_path, TWO), "0.00,-1.60 300.00,-1.60", "0.00,-4.00 300.00,-4.00")
    config = {**QUIET, "initial_speed": 5, **({"action": SUMO_DRIVES} if by_sumo else {})}
    with closing(SumoDrivingEnv(net, [["ab"]], ["ab"], config)) as env:
        env.reset(seed=0)
        another(env, ["ab"], "ab_1", 60.0)
        infos = [result[-1] for result in drive(env, 0 if by_sumo else FASTER)]
    assert infos[-1]["crash"].get("detected_by") == (None if by_sumo else "geometry")
    assert {info["overlap"] for info in infos} - {""} == ({"another"} if by_sumo else set())


@pytest.mark.parametrize(("ahead", "crashes"), [(-4.6, False), (-1.0, True)])
def test_a_lane_change_that_sumo_makes_at_once_sweeps_nothing(tmp_path, ahead: float, crashes: bool) -> None:
    """From beside a car to a place before it that is free; where the place is taken, it is a crash."""
    net = drawn_elsewhere(build(tmp_path, TWO), "0.00,-4.80 300.00,-4.80", "8.00,-4.80 308.00,-4.80")
    config = {**QUIET, "policy_frequency": 10, "initial_speed": 5}
    with closing(SumoDrivingEnv(net, [["ab"]], ["ab"], config)) as env:
        env.reset(seed=0)
        env.sumo.vehicle.moveTo("ego", "ab_0", 60.0)
        env.step(LEFT)
        assert env.sumo.vehicle.getLaneID("ego") == "ab_1"
        another(env, ["ab"], "ab_0", env.sumo.vehicle.getLanePosition("ego") + ahead)
        env.step(IDLE)
        info = env.step(RIGHT)[-1]
        assert env.sumo.vehicle.getLaneID("ego") == "ab_0"
        assert (info["crash"].get("detected_by"), info["crashed"]) == (("both" if crashes else None), crashes)


def test_in_the_sublane_model_a_vehicle_is_as_its_lane_is(tmp_path: Path) -> None:
    """SUMO draws a vehicle that moves sideways at a standstill across its lane."""
    net = build(tmp_path, WIDE)
    routes = route_file(tmp_path, '<trip id="ego" depart="0" from="ab" to="ab"/>')
    config = {"policy_frequency": 10, "action": SUMO_DRIVES}
    options = ["--lateral-resolution", "0.8"]
    with closing(SumoDrivingEnv(net, routes, ego_vehicle="ego", config=config, sumo_options=options)) as env:
        env.reset(seed=0)
        env.sumo.vehicle.setSpeed("ego", 1.0)
        drawn = []
        for step in range(60):
            if step % 10 == 0:
                env.sumo.vehicle.changeSublane("ego", -2.0 if step % 20 else 2.0)
            env.step(0)
            drawn.append(abs(env.sumo.vehicle.getAngle("ego") - 90.0))
            assert env.scene.heading[0] == pytest.approx(0.0, abs=1e-6)
        assert max(drawn) > 10.0


@pytest.mark.parametrize("by_sumo", [False, True])
def test_ways_that_sumo_lets_pass_through_each_other_are_named(tmp_path, monkeypatch, by_sumo: bool) -> None:
    """On a junction without rules SUMO knows no conflict; on a regulated one a touch is a crash, also unreported."""
    step = Session.step
    monkeypatch.setattr(Session, "step", lambda session: step(session)[:0])  # SUMO reports no collision
    found = {}
    for rule in ("unregulated", "priority"):
        plan = ARMS.format(rule), streets("wc", "ce", "sc", "cn"), WAYS
        net = build(tmp_path, plan, "--no-turnarounds")
        (inside,) = files.network(net).sumo_lanes["sc_0"].following
        for counts in (False, True):
            config = {**QUIET, "policy_frequency": 10, KEY: counts}
            config |= {"action": SUMO_DRIVES} if by_sumo else {}
            with closing(SumoDrivingEnv(net, [["wc", "ce"]], ["wc", "ce"], config)) as env:
                env.reset(seed=0)
                another(env, ["sc", "cn"], inside, env.sumo.lane.getLength(inside) * 0.8)
                infos = [result[-1] for result in drive(env, 0 if by_sumo else FASTER)]
                names = {info["overlap"] for info in infos} - {""}
                found[rule, counts] = infos[-1]["crash"].get("detected_by"), names
    assert found["unregulated", False] == (None, {"another"})
    assert found["unregulated", True] == ("geometry", set())
    if not by_sumo:
        assert found["priority", False] == found["priority", True] == ("geometry", set())


FEW = pytest.param(range(3), True, marks=pytest.mark.slow)
TENS = [range(first, first + 10) for first in range(0, 50, 10)]
MANY = [pytest.param(episodes, False, marks=pytest.mark.long) for episodes in TENS]


@pytest.mark.parametrize(("episodes", "by_outlines"), [FEW, *MANY])
@pytest.mark.parametrize("kind", KINDS)
def test_an_ego_that_sumo_drives_crashes_where_sumo_reports_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind, episodes: range, by_outlines: bool
) -> None:
    """At risk 0. In a few episodes by outlines as well, as for an ego of the agent's: these touch nowhere."""
    if by_outlines:
        monkeypatch.setattr(RouteEgo, "is_sumos", False)
    overlaps = 0
    for number in episodes:
        net, routes, options = kind(tmp_path, Random(number))
        config = {"action": SUMO_DRIVES, "duration": 60, "policy_frequency": 2}
        given: dict[str, Any] = {"ego_vehicle": "ego", "config": config, "sumo_options": options}
        with closing(SumoDrivingEnv(net, str(routes), **given)) as env:
            infos = [result[-1] for result in drive(env, 0, number)]
        assert infos[-1]["crash"].get("detected_by") != "geometry", number
        way = sum(info["rewards"]["progress_reward"] for info in infos)
        assert way == pytest.approx(1.0) if infos[-1]["arrived"] else -0.01 <= way < 1.0
        overlaps += any(info["overlap"] for info in infos)
    if by_outlines and kind.__name__ == "junctions":
        assert overlaps  # there is something to judge


CORNER = ("a 0 0, b 150 0, c 150 -150", "ab a b 2 14, bc b c 2 14", "ab 0 bc 0, ab 1 bc 1")


def test_a_long_vehicle_beside_the_ego_in_a_turn_is_no_crash_unless_sumo_says_so(tmp_path: Path) -> None:
    """It turns on the outer lane; the ego keeps the inner one, driven by SUMO among risky drivers."""
    car = '<vehicle id="{}" type="{}" depart="{}" departLane="{}" departSpeed="8"><route edges="ab bc"/></vehicle>'
    cars = [car.format(f"l{k}", "long", 2.5 * k, 1) for k in range(8)]
    cars.insert(4, car.format("ego", "DEFAULT_VEHTYPE", 9.5, 0))
    routes = route_file(tmp_path, '<vType id="long" vClass="truck" length="16"/>' + "".join(cars))
    net = build(tmp_path, CORNER, "--no-turnarounds")
    overlaps, config = set(), {"duration": 40, "risk": 0.02, "policy_frequency": 2, "action": SUMO_DRIVES}
    for seed in (0, 4):
        with closing(SumoDrivingEnv(net, routes, ego_vehicle="ego", config=config)) as env:
            infos = [result[-1] for result in drive(env, 0, seed)]
        assert infos[-1]["crash"].get("detected_by") != "geometry"
        overlaps |= {info["overlap"] for info in infos} - {""}
    assert overlaps


@pytest.mark.parametrize(("length", "brakes"), [(400, True), (1200, True), (1200, False)])
def test_where_an_edge_is_longer_than_drawn_sumo_s_report_counts(tmp_path, length: int, brakes: bool) -> None:
    """A queue at a red light: who stops behind it has not crashed, who does not stop has."""
    edges = f'<edge id="ab" from="a" to="b" speed="14" length="{length}"/>'
    edges += '<edge id="bc" from="b" to="c" speed="14"/><edge id="sb" from="s" to="b" speed="14"/>'
    net = build(tmp_path, ("a 0 0, b 400 0 traffic_light, c 600 0, s 400 -90", edges))
    car = '<vehicle id="{}" depart="{}" departPos="{}"><route edges="ab bc"/></vehicle>'
    cars = [car.format(f"q{k}", k, "last") for k in range(12)] + [car.format("ego", 13, "base")]
    config = {"duration": 150, "policy_frequency": 2, "risk": 0.2}
    routes = route_file(tmp_path, "".join(cars))
    with closing(SumoDrivingEnv(net, routes, ego_vehicle="ego", config=config)) as env:
        env.reset(seed=0)
        (light,) = env.sumo.trafficlight.getIDList()
        env.sumo.trafficlight.setRedYellowGreenState(light, "rr")
        env.hand_over(brakes)
        infos = [result[-1] for result in drive(env, FASTER)]
    assert infos[-1]["ending"] == ("time" if brakes else "crash")
    assert (infos[-1]["speed"] < 0.1) == brakes
