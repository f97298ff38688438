"""Scenarios: values that need no simulator, and highway-env's laws of where vehicles start."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from sumo_env.config import resolve
from sumo_env.tasks import TASKS
from sumo_env.traffic.scenario import fits
from tests.sumo_env.scenarios import draw
from tests.tasks import every_task

SEEDS = range(40)


@every_task
def test_a_scenario_is_a_value_that_its_seed_decides(task: str) -> None:
    """It can be sent to another process, and nothing can change it, so that copies of episodes share it."""
    scenario = draw(task, 3, risk=1.0, policy_frequency=2, simulation_frequency=20)
    sent = pickle.loads(pickle.dumps(scenario))
    again = draw(task, 3, risk=1.0, policy_frequency=2, simulation_frequency=20)
    assert scenario == sent == again and hash(scenario) == hash(sent)
    assert scenario != draw(task, 4, risk=1.0, policy_frequency=2, simulation_frequency=20)
    assert copy.deepcopy(scenario) is scenario
    with pytest.raises(FrozenInstanceError):
        scenario.risk = 1.0  # type: ignore[misc]
    assert (scenario.task, scenario.policy_frequency, scenario.simulation_frequency) == (task, 2, 20)
    assert scenario.road == TASKS[task].road(resolve(task, TASKS[task].defaults))
    names = [spec.id for spec in scenario.specs] + [spawn.vehicle.id for spawn in scenario.spawns]
    assert names[0] == "ego" and len(set(names)) == len(names)


@pytest.mark.parametrize("frequency", [1, 5])
def test_events_of_vehicles_that_come_later_wait_for_them(frequency: int) -> None:
    scenario = draw("intersection", 1, risk=1.0, spawn_probability=1.0, policy_frequency=frequency)
    start = {spawn.vehicle.id: spawn.step / frequency for spawn in scenario.spawns}
    later = [event for event in scenario.events if event.vehicle in start]
    assert later and all(start[event.vehicle] <= event.time < 13.0 for event in later)


@every_task
def test_the_dose_changes_drivers_and_adds_events_but_no_place(task: str) -> None:
    calm, risky = draw(task, 5, risk=0.0), draw(task, 5, risk=1.0)
    assert calm.events == () and len(risky.events) > 0
    assert calm.ego == risky.ego
    for one, other in zip(calm.vehicles, risky.vehicles, strict=True):
        assert (one.lane, one.s, one.speed) == (other.lane, other.s, other.speed)
        assert one.driver.type.split("@")[0] == other.driver.type.split("@")[0]
    assert [(s.step, s.vehicle.id) for s in calm.spawns] == [(s.step, s.vehicle.id) for s in risky.spawns]


@pytest.mark.parametrize(("task", "level"), [(t, level) for t in TASKS for level in TASKS[t].levels])
def test_no_vehicles_overlap_and_all_are_on_their_lane(task: str, level: str) -> None:
    for seed in range(10):
        scenario = draw(task, seed, **TASKS[task].levels[level])
        road = TASKS[task].road(resolve(task, TASKS[task].defaults, TASKS[task].levels[level]))
        # the ego comes after the warm-up
        together = scenario.vehicles if scenario.warm_up else scenario.specs
        places = [(v.x, v.y) for v in together]
        if task != "two-way":  # there two lanes share a strip
            for i, (x, y) in enumerate(places):
                assert all(math.hypot(x - a, y - b) > 2.0 for a, b in places[:i])
        for v in scenario.specs:
            assert road.lane(v.lane).on_lane(v.x, v.y)


def test_highway_spacing_follows_the_density() -> None:
    for density, spacing in ((1.0, 21.0), (2.0, 10.5)):  # metres between consecutive vehicles
        gaps = [np.diff([v.s for v in draw("highway", s, vehicles_density=density).vehicles]) for s in SEEDS]
        assert np.mean(gaps) == pytest.approx(spacing, rel=0.02)
        assert np.min(gaps) > 0.0


def test_intersection_traffic_starts_on_its_approach_and_has_three_seconds_to_drive() -> None:
    """IntersectionEnv._make_vehicles: tries at 0 to 80 m, refused within 15 m, then the challenger."""
    counts, speeds = [], []
    for seed in SEEDS:
        scenario = draw("intersection", seed)
        assert scenario.warm_up == 3.0
        assert scenario.ego.speed == 10.0 and scenario.ego.target_speed == 9.0
        counts.append(len(scenario.vehicles))
        speeds += [v.speed for v in scenario.vehicles]
        for k, v in enumerate(scenario.vehicles):
            assert v.lane[0].startswith("o") and v.lane[1].startswith("ir") and v.destination != v.lane[0]
            assert fits(v, [(w.x, w.y) for w in scenario.vehicles[:k]])
        (challenger,) = (spawn.vehicle for spawn in scenario.spawns if spawn.step == 0)
        assert challenger.id == "challenger" and challenger.speed == 8.0
        assert challenger.destination == f"o{(int(challenger.lane[0][1:]) + 2) % 4}"  # straight on
        assert challenger.s == pytest.approx(65.0, abs=0.5)
    assert 4.0 < np.mean(counts) < 6.5
    assert np.mean(speeds) == pytest.approx(8.0, abs=0.3)


def test_intersection_tries_to_spawn_after_every_step() -> None:
    steps = [s.step for k in SEEDS for s in draw("intersection", k, spawn_probability=1.0).spawns if s.step]
    assert sorted(set(steps)) == list(range(1, 14)) and len(steps) == 13 * len(SEEDS)
    share = np.mean([(len(draw("intersection", k).spawns) - 1) / 13 for k in SEEDS])
    assert share == pytest.approx(0.6, abs=0.1)
