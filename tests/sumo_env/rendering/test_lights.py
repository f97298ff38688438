"""Traffic lights, stop lines and the line between directions, on SUMO's own networks: what SUMO says is shown."""

from ast import literal_eval
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sumo_env.networks.files import network
from sumo_env.rendering.markings import markings
from sumo_env.rendering.scenery import FILM, HIGHWAY_ENVS, Camera, scenery
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scene import LETTERS
from sumo_env.tasks import TASKS
from tests.processes import python
from tests.sumo_env.plans import QUIET, grid, needs_sumo
from tests.sumo_env.rollout import assert_same_bits

pytestmark = needs_sumo
VIEW = {"screen_width": 90, "screen_height": 90, "scaling": 8.0, "centering_position": [0.5, 0.5]}
SLOWER = 4


@pytest.fixture(scope="module")
def lights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    options = "--grid.number=3", "--grid.length=120", "-L=2", "--default.junctions.type=traffic_light"
    return grid(tmp_path_factory.mktemp("lights"), *options)


def start(net: Path, **keywords: Any) -> SumoDrivingEnv:
    config = {**QUIET, "obey_traffic_lights": True, "policy_frequency": 2, "warm_up": 30}
    return SumoDrivingEnv(net, [["A0A1", "A1A2"]], ["A0A1", "A1A2"], config, **keywords)


def test_a_scene_has_what_sumo_says_and_watching_changes_nothing(lights: Path) -> None:
    plain, watched = start(lights), start(lights, render_mode="rgb_array")
    assert_same_bits(plain.reset(seed=0), watched.reset(seed=0))
    shown = set()
    for _ in range(50):
        watched.render()
        assert_same_bits(plain.step(SLOWER), watched.step(SLOWER))
        of = watched.sumo.trafficlight
        assert watched.scene.signals == {name: of.getRedYellowGreenState(name) for name in of.getIDList()}
        shown.add(watched.scene.signals["A1"])
    assert len(shown) > 2


REPLAY = """
import sys, libsumo
libsumo.start(["sumo", "-c", sys.argv[1]])
for _ in range(int(sys.argv[2])):
    libsumo.simulationStep()
    print({name: libsumo.trafficlight.getRedYellowGreenState(name) for name in libsumo.trafficlight.getIDList()})
"""


def test_an_exported_episode_shows_the_lights_that_it_had(lights: Path, tmp_path: Path) -> None:
    env = start(lights)
    env.configure({"policy_frequency": 10})
    env.reset(seed=0)
    seen = []
    for _ in range(200):
        env.step(SLOWER)
        seen.append(env.scene.signals)
    env.export(tmp_path / "episode")
    env.close()
    shown = python("-c", REPLAY, str(tmp_path / "episode" / "episode.sumocfg"), "200").splitlines()
    assert [literal_eval(line) for line in shown[-200:]] == seen and seen[0] != seen[-1]


@pytest.mark.parametrize("paint", [FILM, HIGHWAY_ENVS])
def test_each_way_on_has_its_colour_at_the_stop_line(lights: Path, paint: Any) -> None:
    env = start(lights)
    env.reset(seed=0)
    road, rng = env.task.road(env.config), np.random.default_rng(0)
    lane, light = env.scenario.ego.lane, "A1"
    of, states = env.sumo.trafficlight, list(LETTERS)
    for _ in range(3):
        letters = "".join(rng.choice(states, len(env.scene.signals[light])))
        of.setRedYellowGreenState(light, letters)
        env.step(SLOWER)
        assert env.scene.signals[light] == letters
        x, y = road.lane(lane).position(road.lane(lane).length - 0.4, 0.0)
        view = Camera.of(env.scene, VIEW)._replace(corner=np.rint(np.array([x, y]) * 8.0 - 45).astype(int))
        picture = scenery(env.scene, road, view, paint)
        ways = road.stops[lane]
        assert list(ways) == sorted(ways) and len(ways) > 1
        for number, (name, place) in enumerate(ways):
            lateral = road.lane(lane).width * (0.5 - (number + 0.5) / len(ways))
            spot = view.place(*road.lane(lane).position(road.lane(lane).length - 0.4, lateral))
            colour = picture.getpixel(tuple(np.rint(spot).astype(int).tolist()))
            assert name == light and colour == paint.lights[LETTERS[letters[place]]]


def test_a_line_divides_two_directions_where_they_meet_and_nowhere_else(lights: Path) -> None:
    road = network(lights).road
    lines = [line for line in markings(road).lines if len(line) > 4]
    edges = {index[:2] for index in road.lanes if index[0].endswith(":from")}
    assert len(lines) == len(edges) == 24  # from both sides
    for line in lines:
        for x, y in line.tolist():
            near = sorted(lane.distance(x, y) for index, lane in road.lanes.items() if index[:2] in edges)
            assert near[1] < road.lane(next(iter(road.lanes))).width / 2 + 0.2


def test_opposite_lanes_are_divided_by_one_dashed_line() -> None:
    divided = {"highway": 3, "two-way": 1, "intersection": 2}
    for task, lines in divided.items():
        road = TASKS[task].road({**TASKS[task].defaults})
        dashes = np.array([dash.mean(axis=0) for dash in markings(road).dashes])
        straight = [{round(float(x), 1) for x in axis if np.isclose(axis, x).sum() > 10} for axis in dashes.T]
        assert sum(map(len, straight)) == lines
