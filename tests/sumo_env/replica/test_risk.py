"""Risk events: what drivers look at, against `sumo_env.traffic.risk`, and what they do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sumo_env.replica.geometry import heading_at, locate, no_places, position
from sumo_env.replica.risk import has_free_way, has_room
from sumo_env.replica.simulator import Replica
from sumo_env.replica.tables import CAR, lanes_of
from sumo_env.scene import Scene
from sumo_env.simulator import EgoCommand
from sumo_env.traffic import risk
from sumo_env.traffic.risk import RiskEvent
from sumo_env.traffic.scenario import Scenario
from tests.sumo_env.situations import draw


@pytest.mark.parametrize("task", ["highway", "u-turn", "roundabout"])
def test_drivers_look_at_what_sumo_s_drivers_look_at(task: str) -> None:
    lanes = lanes_of(draw(task).road, connected=True).table
    rng = np.random.default_rng(8)
    answers = np.zeros(2, int)
    for _ in range(30):
        cars = np.zeros(14, CAR)
        cars["heading"], cars["speed"] = rng.uniform(-4.0, 4.0, 14), rng.uniform(0.0, 30.0, 14)
        cars["cos"], cars["sin"] = np.cos(cars["heading"]), np.sin(cars["heading"])
        cars["push_way"] = rng.uniform(5.0, 60.0, 14)
        on = rng.integers(len(lanes), size=14)
        for car, lane in zip(cars, on, strict=True):
            car["x"], car["y"] = position(lanes[lane], rng.uniform(0.0, min(lanes[lane]["length"], 120.0)))
            car["y"] += rng.normal()
        places = no_places(lanes, cars)
        locate(lanes, cars, places)
        states = [(car["x"], car["y"], car["speed"], car["heading"]) for car in cars]
        for i, (car, lane) in enumerate(zip(cars, on.tolist(), strict=True)):
            others = states[:i] + states[i + 1 :]
            free = has_free_way(cars, i)
            assert free == risk.free_way(states[i], others, car["push_way"])
            s = places.s[lane, i]
            there = (*position(lanes[lane], s), car["speed"], heading_at(lanes[lane], s))
            room = has_room(lanes, cars, places, i, lane)
            assert room == risk.has_room(there, others)
            answers += free, room
    assert (answers > 20).all() and (answers < 400).all()


def scenario(task: str, *events: RiskEvent, **config: object) -> Scenario:
    """A regular scenario with these events."""
    return replace(draw(task, 1, simulation_frequency=15, **config), events=events)


def driven(drawn: Scenario, steps: int, name: str) -> list[tuple[Scene, int]]:
    """The scenes of all sub-steps and the row of a vehicle in them; the ego keeps its lane and speed."""
    simulator = Replica()
    simulator.reset(drawn)
    seen: list[tuple[Scene, int]] = []
    lane = drawn.ego.lane
    for _ in range(steps):
        step = simulator.step({"ego": EgoCommand(drawn.ego.target_speed, lane)}, trace=True)
        lane = step.ego.target_lane
        seen += [(scene, scene.ids.index(name)) for scene in step.trace]
    return seen


def marked(seen: list[tuple[Scene, int]], name: str) -> list[int]:
    """The sub-steps in which an event acts on this vehicle, and on no other."""
    assert all(scene.in_event <= {name} for scene, _ in seen)
    return [k for k, (scene, _) in enumerate(seen) if scene.in_event]


def test_sudden_braking_lasts_as_long_as_the_event_says() -> None:
    drawn = scenario("highway", RiskEvent(1.01, "v5", "brake", accel=-9.0, duration=1.0), vehicles_count=12)
    seen = driven(drawn, 3, "v5")
    speed = [scene.speed[row] for scene, row in seen]
    hard = np.flatnonzero(np.diff(speed) * 15 <= -9.0 + 1e-9) + 1
    assert hard.tolist() == list(range(16, 31))  # the first sub-step that begins after 1.01 s is number 16
    assert marked(seen, "v5") == list(range(16, 31))
    longer = scenario("highway", RiskEvent(0.0, "v5", "brake", accel=-9.0, duration=4.0), vehicles_count=12)
    assert min(scene.speed[row] for scene, row in driven(longer, 4, "v5")) == pytest.approx(0.0, abs=1e-9)


def test_a_surge_that_pauses_is_not_marked() -> None:
    surge = RiskEvent(0.0, "v0", "surge", accel=4.0, duration=1.0, way=1000.0)
    assert marked(driven(scenario("highway", surge, lanes_count=1), 1, "v0"), "v0") == []


@pytest.mark.parametrize("direction", [-1, 1])
def test_a_cut_in_goes_to_the_only_lane_there_is(direction: int) -> None:
    event = RiskEvent(0.0, "v0", "cut-in", direction=direction)
    seen = driven(scenario("highway", event, lanes_count=2, vehicles_count=1), 4, "v0")
    y = [scene.y[row] for scene, row in seen]
    assert abs(y[-1] - y[0]) == pytest.approx(4.0, abs=0.5), "no lane on the event's side: the other one"


def test_a_swerve_on_the_two_way_road_comes_back() -> None:
    swerve = RiskEvent(0.2, "v0", "cut-in", direction=1)
    drawn = scenario("two-way", swerve, vehicles_count=1, oncoming_vehicles_count=0)
    slow = replace(drawn, ego=drawn.ego._replace(speed=0.0, target_speed=0.0))
    seen = driven(slow, 7, "v0")
    assert marked(seen, "v0") == list(range(3, 48))  # for 3 s
    y = np.array([scene.y[row] for scene, row in seen])
    assert y.min() < 0.1
    assert y[-1] == pytest.approx(4.0, abs=0.1)


def test_events_of_vehicles_that_are_not_there_are_dropped() -> None:
    surge = RiskEvent(0.0, "s13", "surge", accel=4.0, duration=1.0)
    drawn = scenario("intersection", surge, spawn_probability=1.0)
    assert "s13" in {spawn.vehicle.id for spawn in drawn.spawns}
    Replica().reset(drawn)
    driven(drawn, 1, "ego")
