"""Traffic lights on a real crossing (RiLSA, of eclipse-sumo): what `info` says of them, and an ego that obeys."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scenarios.lights import speed_before
from sumo_env.scene import GREEN, NO_LIGHT, RED, UNLIT, YELLOW, Light
from tests.sumo_env.plans import SUMO_DRIVES, build, streets
from tests.sumo_env.rollout import drive

sumo = pytest.importorskip("sumo", reason="needs eclipse-sumo: pip install '.[gui]'")
SCENARIOS = Path(sumo.SUMO_HOME) / "tools/sumolib/scenario/scenarios/RealWorld"
CROSSING = SCENARIOS / "RiLSA_example1/rilsa1.net.xml"
QUIET = {"vehicles_count": 0, "spawn_probability": 0.0, "duration": 90, "policy_frequency": 10}
FASTER, IDLE = 3, 1


def infos(**config: Any) -> Iterator[dict[str, Any]]:
    """Of an episode at full speed, straight on, ten times a second."""
    env = SumoDrivingEnv(CROSSING, [["em", "mw"]], ["sm", "mn"], {**QUIET, **config})
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
    env = SumoDrivingEnv(net, ego_route=["ab", "bc", "cd"], config={**QUIET, **config})
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
