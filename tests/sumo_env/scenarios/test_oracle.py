"""SUMO drives its own files here as ``sumo`` does: every vehicle, with the same id, at the same place."""

import math
import re
import shlex
import subprocess
from contextlib import closing
from itertools import combinations
from pathlib import Path
from random import Random
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

import sumo_env
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scene import Scene
from sumo_env.simulator import EgoCommand
from sumo_env.traffic.sumo_schemas import schema
from tests.sumo_env.plans import SUMO, SUMO_DRIVES, Rows, floating_car_data, grid, needs_sumo, route_file
from tests.sumo_env.rollout import drive, mismatch
from tests.sumo_env.scenarios.driven import drawn
from tests.sumo_env.scenarios.files import SCENARIOS, written

pytestmark = [needs_sumo, pytest.mark.filterwarnings("ignore:.*outputs are off")]
SECONDS = 300
NOTHING = EgoCommand(None, None)


def plain(command: str, folder: Path, until: float) -> Rows:
    """What ``sumo`` itself does, without libsumo, up to a time [s]."""
    out = folder / "plain.fcd.xml"
    arguments = [str(SUMO), *shlex.split(command)[1:]]
    arguments += ["--fcd-output", str(out), "--fcd-output.attributes", "x,y,lane,speed"]
    arguments += ["--end", f"{until + 1.0:g}", "--precision", "6"]
    subprocess.run(arguments, check=True, capture_output=True)
    rows = floating_car_data(out)
    return {time: {name: car for name, car in cars.items() if "lane" in car} for time, cars in rows.items()}


def fronts(scene: Scene) -> dict[str, tuple[float, float]]:
    """Front bumpers of the vehicles, in SUMO's coordinates [m]."""
    found = {}
    for row, name in enumerate(scene.ids):
        half, heading = scene.size(name)[0] / 2.0, float(scene.heading[row])
        x, y = float(scene.x[row]), -float(scene.y[row])
        found[name] = x + half * math.cos(heading), y - half * math.sin(heading)
    return found


def differences(scenes: list[tuple[float, Scene]], rows: Rows, step: float, without: str = "") -> list[str]:
    """Vehicles that are missing, too many, or elsewhere; `scenes` are those after SUMO's step to each time [s]."""
    found = []
    for time, scene in scenes:
        there = rows[round(time - step, 2)]
        here = {name: front for name, front in fronts(scene).items() if name != without}
        if here.keys() != there.keys():
            found.append(f"{time:.1f} s: {sorted(here.keys() ^ there.keys())}")
            continue
        for name, (x, y) in here.items():
            car = there[name]
            if math.dist((x, y), (float(car["x"]), float(car["y"]))) > 0.01:
                found.append(f"{time:.1f} s: {name}")
    return found


def driven(env: SumoDrivingEnv, seconds: int, command: EgoCommand = NOTHING) -> list[tuple[float, Scene]]:
    """Scenes after every step of SUMO, with its time, from the ego's departure on."""
    inner: Any = env.unwrapped
    begin = float(inner.sumo.simulation.getTime())
    scenes = [inner.scene]
    for _ in range(seconds):
        step = inner._car.episode.simulator.step({inner.ego_id: command}, trace=True)
        scenes += step.trace
        if step.scene.place.ended:
            scenes.pop()
            break
    return [(begin + scene.time, scene) for scene in scenes]


@pytest.mark.parametrize("name", SCENARIOS)
def test_where_nothing_is_commanded_everybody_is_where_sumo_has_them(name: str, tmp_path: Path) -> None:
    """Also in a worker, and whatever was driven before."""
    config = written(tmp_path, name)
    env = SumoDrivingEnv(config, ego_vehicle="ego", config={"duration": SECONDS})
    env.reset(seed=1)
    of_another_seed = driven(env, 30)
    env.reset(seed=7)
    scenes = driven(env, SECONDS)
    rows = plain(env.sumo_command, tmp_path, scenes[-1][0])
    assert len(scenes) > 100 and len({car for _, scene in scenes for car in scene.ids}) > 15
    assert differences(scenes, rows, 0.1) == []
    assert differences(of_another_seed, rows, 0.1)  # the comparison can fail


def test_an_ego_that_sumo_drives_is_where_sumo_has_it(tmp_path: Path) -> None:
    """By the actions' configuration, and by a hand-over, after which the car's own way goes on."""
    config = written(tmp_path, "actuated")
    both = {"type": "ContinuousAction", "longitudinal": "sumo", "lateral": "sumo"}
    for action in (both, {"type": "DiscreteMetaAction"}):
        settings = {"duration": SECONDS, "action": action, "policy_frequency": 10}
        env = SumoDrivingEnv(config, ego_vehicle="ego", config=settings)
        env.reset(seed=7)
        begin = float(env.sumo.simulation.getTime())
        scenes, over = [(begin, env.scene)], False
        while not over:
            if action is not both:
                env.hand_over()
            over = env.step(0)[2]
            scenes.append((begin + env.scene.time, env.scene))
        assert env.scene.place is not None and env.scene.place.ended == "arrived" and len(scenes) > 100
        assert differences(scenes[:-1], plain(env.sumo_command, tmp_path, scenes[-1][0]), 0.1) == []
        env.close()


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_added_car_changes_nothing_before_it_comes_and_little_later(name: str, tmp_path) -> None:
    config = written(tmp_path, name)
    env = SumoDrivingEnv(config, ego_trips=[("B2B1", "A1A0")], config={"warm_up": 60, "duration": SECONDS})
    env.reset(seed=3)
    assert env.ego_id != "ego" and env.scene.ids[0] == env.ego_id
    later = driven(env, SECONDS)
    rows = plain(env.sumo_command, tmp_path, later[-1][0])
    begin, first = later[0]
    before = {name: car for name, car in rows[round(begin - 0.1, 2)].items() if name in first.ids}
    assert len(before) == len(first) - 1  # without the ego
    assert differences([(begin, first)], {round(begin - 0.1, 2): before}, 0.1, without=env.ego_id) == []
    ours, theirs = [], []  # counts and speeds
    for time, scene in later:
        cars = rows[round(time - 0.1, 2)]
        if len(scene) > 1 and cars:
            ours.append((len(scene) - 1, float(np.mean(scene.speed[1:]))))
            theirs.append((len(cars), float(np.mean([float(car["speed"]) for car in cars.values()]))))
    assert np.mean(ours, axis=0) == pytest.approx(np.mean(theirs, axis=0), rel=0.05)


# -- what is paid --------------------------------------------------------------------------------------------------

CARS = ["ego", "t3", "t4"]
MOST_BEFORE = 20.0  # [m] that a car drives before the policy step in which its agent takes over


MANY = [pytest.param(seed, marks=pytest.mark.long) for seed in range(6, 80)]


@pytest.mark.parametrize("seed", [*range(6), *MANY])
def test_a_car_is_paid_for_what_it_drove_and_has_arrived_where_sumo_says_so(seed: int, tmp_path) -> None:
    """One car or several, of any kind and with any way, driven by SUMO or by an agent, among risky drivers or not.

    Without commands and risk everybody is where ``sumo`` has them; two cars that touch tell the same of it.
    """
    rng = Random(seed)
    net, routes, beside = drawn(tmp_path, rng)
    trips, by_sumo = tmp_path / "trips.xml", seed % 2 == 0
    config = {"duration": 150, "policy_frequency": rng.choice([1, 2, 10]), "risk": float(rng.random() < 0.5)}
    teleports = seed % 3 == 0
    options = ["--tripinfo-output", str(trips), "--ignore-route-errors"]
    options += ["--time-to-teleport", "30" if teleports else "-1"]
    given = {"routes": routes, "additional": beside, "vehicles": CARS[: rng.choice([1, 3])]}
    given |= {"remove_crashed": seed % 4 == 1, "sumo_options": options}
    env = sumo_env.parallel_env(net, config, **given)
    env.reset(seed=seed)
    first, scenes = env.cars["car_0"], list[tuple[float, Scene]]()
    begin = float(first.sumo.simulation.getTime()) - first.scene.time
    steps: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    while env.agents:
        for agent in env.agents:
            env.cars[agent].hand_over(by_sumo)
        acting = env.agents
        _, rewards, *_, infos = env.step({agent: rng.choice([0, 1, 2, 3, 3, 3]) for agent in acting})
        for agent in acting:
            steps.setdefault(env.ids[agent], []).append((rewards[agent], infos[agent]))
        ends = any(info["ending"] for info in infos.values())  # then the scene still has the car
        if by_sumo and config["risk"] == 0.0 and not (ends or any(first.scene.crashed)):
            scenes.append((begin + first.scene.time, first.scene))
    command = first.sumo_command
    env.close()
    crashes = {name: driven[-1][1]["crash"] for name, driven in steps.items() if driven[-1][1]["crash"]}
    for one, other in combinations(crashes, 2):
        if (crashes[one]["other"], crashes[other]["other"]) == (other, one):
            assert mismatch(crashes[one], crashes[other]) == []
    said = {trip.get("id"): trip for trip in ElementTree.parse(trips).getroot()}
    assert not scenes or differences(scenes, plain(command, tmp_path, scenes[-1][0]), 0.1) == []
    for name, driven in steps.items():
        trip, has_left = said.get(name), teleports and driven[-1][1]["removed"]
        has_arrived = trip is not None and trip.get("vaporized") == "" and not has_left
        assert not wrongly_paid(driven, trip, has_arrived, env.cars["car_0"].config), name


def wrongly_paid(
    steps: list[tuple[float, dict[str, Any]]], trip: Any, has_arrived: bool, config: dict[str, Any]
) -> list[str]:
    """What is wrong with the rewards and infos of a car's policy steps; trip: what SUMO says of it."""
    shares = np.array([info["rewards"]["progress_reward"] for _, info in steps])
    metres = np.array([info["distance"] for _, info in steps])
    last, wrong = steps[-1][1], []
    for reward, info in steps:
        if reward != pytest.approx(sum(config.get(name, 0) * term for name, term in info["rewards"].items())):
            wrong.append(f"{reward} for {info['rewards']}")
    costs = [info["rewards"]["collision_reward"] + info["rewards"]["missed_turn_reward"] for _, info in steps]
    if any(costs[:-1]) or costs[-1] != last["crashed"] + last["missed_turn"]:
        wrong.append(f"costs {costs}")
    if last["arrived"] != has_arrived:
        wrong.append(f"{last['ending']!r}, SUMO: {trip is not None and trip.attrib}")
    if not all(info["on_road"] or info["removed"] for _, info in steps):
        wrong.append("off the road")
    if shares.min() < 0.0 or np.any((shares[:-1] > 0.0) & (metres[:-1] == 0.0)):
        wrong.append(f"shares {shares} for {metres} m")
    if has_arrived and trip.get("rerouteNo") == "0" and metres.sum() > 0.0:
        # a way through a junction is a little longer on one lane than on another
        if not np.allclose(shares, metres / metres.sum(), atol=0.01) or abs(shares.sum() - 1.0) > 1e-9:
            wrong.append(f"shares {shares} for {metres} m, {shares.sum()} in all")
        if not -0.1 < float(trip.get("routeLength")) - metres.sum() < MOST_BEFORE:
            wrong.append(f"{metres.sum()} m, SUMO: {trip.attrib}")
    return wrong


# -- reading changes nothing -----------------------------------------------------------------------------------------

MINUTE = 60
# Of SUMO's junction models, each with a value that matters; probabilities are those of drawing.
JUNCTIONS = """
    jmAdvance="0.5" jmAllwayStopWait="0.5" jmCrossingGap="5" jmDriveAfterRedTime="2" jmDriveAfterYellowTime="1"
    jmDriveRedSpeed="5" jmExtraGap="1" jmIgnoreFoeProb="0.5" jmIgnoreFoeSpeed="20" jmIgnoreJunctionFoeProb="0.5"
    jmIgnoreKeepClearTime="5" jmSigmaMinor="0.5" jmStopSignWait="1" jmStoplineCrossingGap="2" jmStoplineGap="2"
    jmStoplineGapMinor="2" jmTimegapMinor="1.5" impatience="0.5"
"""


def crowded(folder: Path, kind: str) -> tuple[Path, Path]:
    """Much traffic on a grid, whose junctions are of one kind, of drivers with all these attributes."""
    net = grid(folder, "--grid.number=3", "--grid.length=120", "-L=2", f"--default-junction-type={kind}")
    ways = ("A0A1", "C2C1"), ("C0B0", "A2A1"), ("A2B2", "C1C0"), ("C2C1", "A0B0")
    flows = "".join(
        f'<flow id="f{k}" type="t" begin="0" end="60" probability="0.25" from="{start}" to="{end}"/>'
        for k, (start, end) in enumerate(ways)
    )
    ego = '<trip id="ego" type="t" depart="10" from="A1B1" to="C1C2"/>'
    return net, route_file(folder, f'<vType id="t" {JUNCTIONS}/>{flows}{ego}')


def test_all_attributes_of_junction_models_are_looked_at() -> None:
    known = {name for names in schema("route").values() for name in names if name.startswith("jm")}
    assert known - {"jmIgnoreIDs", "jmIgnoreTypes"} <= {*re.findall(r"\w+(?==)", JUNCTIONS)}


@pytest.mark.parametrize("kind", ["priority", "traffic_light", "right_before_left"])
def test_whatever_is_read_an_episode_is_sumo_s(tmp_path: Path, kind: str) -> None:
    """Read with and without sub-steps, ten times as often, filmed, and with all features that ask SUMO."""
    given, found = crowded(tmp_path, kind), []
    features: dict[str, Any] = {"type": "Kinematics", "features": ["x", "y", "foe_gap", "foe_speed"]}
    for read in ({}, {"observation": features}, {"policy_frequency": 10, "observation": features}):
        config = {"duration": MINUTE, "action": SUMO_DRIVES, **read}
        with closing(SumoDrivingEnv(*given, ego_vehicle="ego", config=config)) as env:
            env.reset(seed=3)
            scenes = driven(env, MINUTE * env.config["policy_frequency"])
            assert differences(scenes, plain(env.sumo_command, tmp_path, scenes[-1][0]), 0.1) == []
    for filmed in (False, True):
        config = {"duration": MINUTE, "action": SUMO_DRIVES, "observation": features}
        with closing(
            SumoDrivingEnv(*given, ego_vehicle="ego", config=config, render_mode="rgb_array")
        ) as env:
            film = RecordVideo(env, str(tmp_path / "film")) if filmed else env
            film.reset(seed=3)
            begin = float(env.sumo.simulation.getTime())
            results = list(drive(film, 0))
            scene = begin + env.scene.time, env.scene
            found.append([reward for _, reward, *_ in results])
            rows = plain(env.sumo_command, tmp_path, scene[0])
            assert env.scene.place.ended or differences([scene], rows, 0.1) == []
    assert found[0] == found[1]
