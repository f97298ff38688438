"""Exported episodes: SUMO itself opens them, with every car where it was."""

import math
from contextlib import closing
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import gymnasium as gym
import pytest

from experiments.backends import make_env
from sumo_env.env import DrivingEnv
from sumo_env.scenarios import SumoDrivingEnv
from tests.sumo_env.plans import Rows, floating_car_data, grid, needs_sumo, opened, route_file
from tests.sumo_env.rollout import drive

pytestmark = [pytest.mark.slow, needs_sumo]

CASES: dict[str, tuple[int, dict[str, Any]]] = {
    "highway": (3, {"vehicles_count": 20, "risk": 1.0}),
    "two-way": (0, {"risk": 1.0}),
    "roundabout": (1, {"vehicles_count": 12}),
    "intersection": (1, {"initial_vehicle_count": 20}),
    "u-turn": (0, {}),
}


def driven(env: Any, action: int) -> DrivingEnv:
    """The environment at the end of an episode."""
    list(drive(env, action, seed=1))
    return env.unwrapped


def distances(recorded: Rows, shown: Rows) -> dict[str, float]:
    """Largest distance [m] of each vehicle from where it was, from the first step on; inf where it is missing."""
    found: dict[str, float] = {}
    for time, cars in recorded.items():
        for name, car in cars.items() if time > 0 else ():
            there = shown.get(time, {}).get(name)
            gap = math.inf
            if there is not None:
                gap = math.hypot(*(float(car[axis]) - float(there[axis]) for axis in "xy"))
            found[name] = max(gap, found.get(name, 0.0))
    return found


@pytest.mark.parametrize("task", CASES)
def test_sumo_shows_the_episode_with_its_cars(task: str, tmp_path: Path) -> None:
    action, config = CASES[task]
    env = driven(gym.make(f"sumo/{task}-v0", config=config), action)
    files = env.export(tmp_path / "episode")
    folder = (tmp_path / "episode").rename(tmp_path / "moved")  # nothing in it names its place
    assert sorted(file.name for file in files) == sorted(file.name for file in folder.iterdir())
    recorded = floating_car_data(folder / "recorded.fcd.xml")
    assert len(recorded) == 1 + env.steps * 10
    yellow = {name for cars in recorded.values() for name, car in cars.items() if car["type"] == "risky"}
    assert yellow <= {event.vehicle for event in env.scenario.events}
    assert bool(yellow) == (config.get("risk", 0.0) > 0.0)
    last = recorded[max(recorded)]
    assert set(last) == set(env.scene.ids)
    assert float(last["ego"]["speed"]) == pytest.approx(env.scene.speed[0], abs=1e-3)
    heading = float(env.scene.heading[0])
    assert float(last["ego"]["x"]) == pytest.approx(env.scene.x[0] + 2.5 * math.cos(heading), abs=1e-3)
    assert float(last["ego"]["y"]) == pytest.approx(-env.scene.y[0] - 2.5 * math.sin(heading), abs=1e-3)
    assert max(distances(recorded, opened(folder / "episode.sumocfg")).values()) < 0.1
    (viewport,) = ElementTree.parse(folder / "view.xml").iter("viewport")
    for axis in "xy":  # the middle of the window is that of the ego's way
        way = [float(cars["ego"][axis]) for cars in recorded.values()]
        assert min(way) <= float(viewport.get(axis, "")) <= max(way)


@pytest.mark.parametrize("backend", ["replica", "highway-env"])
def test_the_other_backends_export_as_well(backend: str, tmp_path: Path) -> None:
    env = driven(make_env(backend, "u-turn"), 1)
    env.export(tmp_path)
    recorded = floating_car_data(tmp_path / "recorded.fcd.xml")
    steps = len(env._car.episode.commands) if backend == "replica" else env.steps // 15
    assert len(recorded) == 1 + steps * 15
    assert max(distances(recorded, opened(tmp_path / "episode.sumocfg")).values()) < 0.1


def test_sumo_replays_vehicles_that_begin_or_change_lanes_within_junctions(tmp_path: Path) -> None:
    net = grid(tmp_path, "-L=2", "--turn-lanes=1", "--sidewalks.guess")
    routes = route_file(tmp_path, '<flow id="f" begin="0" end="99" period="2" from="A0A1" to="C1C2"/>')
    with closing(SumoDrivingEnv(net, routes, ego_trips=[("A0A1", "C1C2")], config={"warm_up": 40})) as env:
        for seed in range(3):
            env.reset(seed=seed)
            configuration = env.export(tmp_path / "episode")[-1]
            assert "lanechange.duration" not in configuration.read_text() and opened(configuration)


def test_an_export_follows_no_link(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("mine")
    for name in ("network.net.xml", "episode.sumocfg"):
        (tmp_path / name).symlink_to(precious)
    with closing(gym.make("sumo/u-turn-v0")) as env:
        env.reset(seed=0)
        env.unwrapped.export(tmp_path)  # type: ignore[attr-defined]
    assert precious.read_text() == "mine" and not (tmp_path / "episode.sumocfg").is_symlink()
