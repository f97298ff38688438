"""The validation: its statistics, its verdicts, and that the stored reference is what highway-env drives."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.study.grid import level_names
from experiments.validation import compare, reference, validation_status
from experiments.validation.changes import beginnings
from experiments.validation.dynamics_checks import crossing
from experiments.validation.episodes import BIN, BINS, episode
from experiments.validation.jobs import CONNECTED, MATCHED, PATH, Job, Size, finished, parquet, plan
from experiments.validation.margins import EPISODES, RETURN_RANGE, Margin
from experiments.validation.scorecard import check
from experiments.validation.stage import Motion, Place, Scene, drive, open_env
from sumo_env.tasks import TASKS

MARGIN = Margin(1.0, "m", "for the test")


def row(engine: str, scenario: int, policy: str = "idle", drawn: int = 1, **values: Any) -> dict[str, Any]:
    return {
        "engine": engine, "task": "highway", "level": 1, "traffic": "regular", "policy": policy,
        "scenario": scenario, "drawn": drawn, **values,
    }  # fmt: skip


def both(values: dict[str, list[tuple[float, float]]], measure: str = "return") -> pd.DataFrame:
    rows = []
    for policy, cases in values.items():
        for scenario, (first, second) in enumerate(cases):
            rows += [
                row("a", scenario, policy, **{measure: first}),
                row("b", scenario, policy, **{measure: second}),
            ]
    return compare.pairs(pd.DataFrame(rows), "a", "b")


def test_episodes_of_other_scenarios_are_no_pairs() -> None:
    table = pd.DataFrame([row("a", 0, drawn=1), row("b", 0, drawn=2), row("a", 1), row("b", 1)])
    assert compare.pairs(table, "a", "b")["scenario"].tolist() == [1]
    assert compare.strangers(table, "a", "b") == 1


def test_the_scenario_is_the_unit() -> None:
    once = compare.mean_difference(both({"idle": [(1, 0), (3, 0), (2, 0)]}), "return")
    twice = compare.mean_difference(both({p: [(1, 0), (3, 0), (2, 0)] for p in ("idle", "faster")}), "return")
    assert once.difference == twice.difference == 2
    assert once.n == twice.n == 3
    assert (once.low, once.high) == pytest.approx((twice.low, twice.high))


def test_interval_covers_the_truth_nine_times_in_ten() -> None:
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(1000):
        low, high = compare.interval(rng.normal(1.0, 2.0, size=8))
        assert low is not None and high is not None
        covered += low <= 1.0 <= high
    assert 860 < covered < 940


def test_wasserstein_of_shifted_headways() -> None:
    first, second = np.zeros(BINS), np.zeros(BINS)
    first[4], second[10] = 3, 5
    assert compare.wasserstein(first, second) == pytest.approx(6 * BIN)
    assert np.isnan(compare.wasserstein(first, np.zeros(BINS)))


def test_order_counts_decided_pairs_only() -> None:
    values = {
        "idle": [(1.0, 1.0), (1.1, 1.1), (0.9, 0.9)],
        "faster": [(0.0, 3.0), (0.1, 3.2), (0.2, 3.1)],  # better in the second, worse in the first
        "slower": [(1.0, 0.5), (1.0, 1.5), (1.0, 1.0)],  # undecided against idle
    }
    share, decided = compare.order(both(values), "return")
    assert decided == 2
    assert share == 0.0


def test_verdicts() -> None:
    def verdict(difference: float, low: float, high: float, **options: Any) -> tuple[Any, Any]:
        found = compare.Difference(1.0 + difference, 1.0, difference, low, high, 5)
        record = check("name", "metric", found, level="1", margin=MARGIN, **options)
        return record["passed"], record["equivalent"]

    assert verdict(0.5, 0.1, 0.9) == (True, True)
    assert verdict(0.5, -0.5, 1.5) == (True, False)  # within the margin, but not shown to be equivalent
    assert verdict(-1.5, -2.0, -1.0) == (False, False)
    assert verdict(1.5, 1.0, 2.0, one_sided=True) == (True, True)
    few = check(
        "name", "metric", compare.Difference(1.0, 1.0, 0.0, None, None, 2), level="1", margin=MARGIN, least=3
    )
    assert few["passed"] is None  # too few scenarios for a verdict
    without = check("name", "metric", compare.Difference(2.0, 1.0, 1.0, None, None, 1), level="1")
    assert without["passed"] is None and without["margin"] is None


def test_margins_are_complete_and_have_reasons() -> None:
    assert set(RETURN_RANGE) == set(TASKS)
    assert {"return", "crashed", "traffic_speed", "headway", "agreement", "order"} <= set(EPISODES)
    assert all(margin.reason for margin in EPISODES.values())


def test_status_is_of_a_version(tmp_path: Path) -> None:
    path = tmp_path / "validation.json"
    assert set(validation_status("1.0", path).values()) == {"not validated"}
    tasks = {"highway": {"passed": True}, "u-turn": {"passed": False}}
    path.write_text(json.dumps({"versions": {"sumo_env": "1.0"}, "tasks": tasks}))
    status = validation_status("1.0", path)
    assert (status["highway"], status["u-turn"], status["two-way"]) == ("passed", "failed", "not validated")
    assert set(validation_status("1.1", path).values()) == {"not validated"}


def test_plan_and_resumption(tmp_path: Path) -> None:
    size = Size(lowest=4, others=2, highway=(3, 2, 1), changes=1)
    jobs = plan(["highway", "roundabout"], size, (MATCHED, PATH, CONNECTED))
    assert len({job.file for job in jobs}) == len(jobs)
    assert not [job for job in jobs if job.engine == "connected" and job.task == "highway"]
    job = Job("episodes", "sumo", "highway", 1, "regular", 3)
    values = {"length": 1, "near_misses": 0}
    (tmp_path / job.file).write_bytes(parquet(pd.DataFrame([row("sumo", k, **values) for k in range(2)])))
    assert not finished(job, tmp_path)
    assert finished(Job("episodes", "sumo", "highway", 1, "regular", 2), tmp_path)


def test_beginning_of_a_lane_change() -> None:
    lane = np.array([1, 1, 1, 1, 2, 2, 2])
    centred = np.array([True, True, False, False, False, False, True])
    assert beginnings(lane, centred) == {1: 2}


def test_crossing_is_interpolated() -> None:
    y = np.array([[0.0], [1.0], [3.0]])
    motion = Motion(np.array([0.0, 0.1, 0.2]), y, y, y, y)
    assert crossing(motion, 2.0) == pytest.approx(0.15)
    assert crossing(motion, 9.0) == float("inf")


def test_a_scene_is_driven_alike_by_both_simulators() -> None:
    place = Place(("0", "1", 0), 300.0, 10.0)
    config = {"lanes_count": 1, "action": {"type": "DiscreteMetaAction", "target_speeds": [0, 10, 20, 30]}}
    scene = Scene(
        "approach", "highway", place, (Place(("0", "1", 0), 250.0, 20.0),), seconds=3.0, config=config
    )
    sumo, other = drive("sumo", scene), drive("highway-env", scene)
    times = np.array([0.0, 1.0, 2.0, 3.0])
    for name in ("x", "speed"):
        assert sumo.at(times, name, 1) == pytest.approx(other.at(times, name, 1), abs=0.2)


@pytest.mark.parametrize("task", ["two-way", "u-turn"])
def test_stored_reference_is_what_highway_env_drives(task: str) -> None:
    stored = reference.read().episodes
    place = {
        "engine": PATH.name,
        "task": task,
        "level": 1,
        "traffic": "regular",
        "scenario": 0,
        "policy": "idle",
    }
    found = stored[(stored[list(place)] == pd.Series(place)).all(axis=1)].iloc[0]
    env = open_env("highway-env", task, {**TASKS[task].levels[level_names(task)[0]], "variant": "path"})
    driven = episode(env, task, 1, "regular", "idle", 0)
    env.close()
    assert driven["drawn"] == found["drawn"]
    for name in ("return", "length", "crashed", "ego_speed", "traffic_speed", "min_ttc"):
        assert driven[name] == pytest.approx(found[name], rel=1e-5), name


def test_stored_reference_is_small() -> None:
    size = sum(path.stat().st_size for path in reference.STORED.iterdir())
    assert size < 64 * len(reference.read().episodes)  # bytes
