"""Spawn laws: what highway-env's specification says about where vehicles start (docs/decisions.md)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sumo_env.config import resolve
from sumo_env.scenario import Scenario
from sumo_env.tasks import TASKS

SEEDS = range(40)


def draw(task: str, seed: int = 0, **config: object) -> Scenario:
    the_task = TASKS[task]
    return the_task.scenario(resolve(task, the_task.defaults, config), seed)


@pytest.mark.parametrize("task", TASKS)
def test_a_scenario_is_a_function_of_its_seed(task: str) -> None:
    assert draw(task, 3) == draw(task, 3)
    assert draw(task, 3) != draw(task, 4)


@pytest.mark.parametrize("task", TASKS)
def test_the_dose_changes_drivers_and_adds_events_but_no_place(task: str) -> None:
    calm, risky = draw(task, 5, risk=0.0), draw(task, 5, risk=1.0)
    assert calm.events == () and len(risky.events) > 0
    assert calm.ego == risky.ego
    if task == "intersection":  # its first vehicles drive for 3 s before the episode, each in its own way
        assert [v.driver.type.split("@")[0] for v in calm.vehicles] != []
        return
    for one, other in zip(calm.vehicles, risky.vehicles, strict=True):
        assert (one.lane, one.s, one.speed) == (other.lane, other.s, other.speed)
        assert one.driver.type.split("@")[0] == other.driver.type.split("@")[0]


@pytest.mark.parametrize(("task", "level"), [(t, level) for t in TASKS for level in TASKS[t].levels])
def test_no_vehicles_overlap_and_all_are_on_their_lane(task: str, level: str) -> None:
    for seed in range(10):
        scenario = draw(task, seed, **TASKS[task].levels[level])
        road = TASKS[task].road(resolve(task, TASKS[task].defaults, TASKS[task].levels[level]))
        places = [(v.x, v.y) for v in scenario.specs]
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


def test_highway_ego_stands_behind_everybody() -> None:
    for seed in SEEDS:
        scenario = draw("highway", seed)
        assert scenario.ego.speed == 25.0
        assert 175.0 < scenario.ego.s < 185.0
        assert min(v.s for v in scenario.vehicles) > scenario.ego.s
        assert all(21.0 <= v.speed <= 24.0 for v in scenario.vehicles)


def test_two_way_columns() -> None:
    own = np.array([[v.s for v in draw("two-way", s).vehicles[:3]] for s in SEEDS])
    oncoming = np.array([[v.x for v in draw("two-way", s).vehicles[3:]] for s in SEEDS])
    assert own.mean(axis=0) == pytest.approx([70.0, 110.0, 150.0], abs=7.0)
    assert oncoming.mean(axis=0) == pytest.approx([500.0, 600.0], abs=7.0)


@pytest.mark.parametrize("level", TASKS["two-way"].levels)
def test_two_way_traffic_of_every_level_is_on_the_road_and_ahead(level: str) -> None:
    config = TASKS["two-way"].levels[level]
    for seed in SEEDS:
        scenario = draw("two-way", seed, **config)
        assert len(scenario.vehicles) == config["vehicles_count"] + config["oncoming_vehicles_count"]
        for v in scenario.vehicles:
            assert scenario.ego.x < v.x < config["road_length"] + 20.0


def test_roundabout_slots_and_counts() -> None:
    first = draw("roundabout").vehicles
    assert [v.lane[:2] for v in first[:1]] == [("we", "sx")] and len(first) == 4
    assert [len(draw("roundabout", s, vehicles_count=15).vehicles) for s in SEEDS] == [15] * len(SEEDS)


def test_intersection_traffic_has_driven_for_three_seconds() -> None:
    counts, speeds = [], []
    for seed in SEEDS:
        scenario = draw("intersection", seed)
        counts.append(len(scenario.vehicles))
        speeds += [v.speed for v in scenario.vehicles]
        assert all(math.hypot(v.x - scenario.ego.x, v.y - scenario.ego.y) >= 20.0 for v in scenario.vehicles)
        assert scenario.ego.speed == 10.0 and scenario.ego.target_speed == 9.0
    assert 4.0 < np.mean(counts) < 6.2  # highway-env: 5.1 in 10 resets
    assert 6.0 < np.mean(speeds) < 8.5


def test_intersection_tries_to_spawn_after_every_step() -> None:
    steps = [spawn.step for s in SEEDS for spawn in draw("intersection", s, spawn_probability=1.0).spawns]
    assert sorted(set(steps)) == list(range(1, 14)) and len(steps) == 13 * len(SEEDS)
    share = np.mean([len(draw("intersection", s).spawns) / 13 for s in SEEDS])
    assert share == pytest.approx(0.6, abs=0.1)


def test_u_turn_has_at_most_twelve_slots() -> None:
    assert len(draw("u-turn", vehicles_count=12).vehicles) == 12
    with pytest.raises(ValueError, match="at most 12"):
        draw("u-turn", vehicles_count=13)
