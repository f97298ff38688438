"""The benchmark: measuring processes, arithmetic of medians and extrapolation, targets, page, and a small run."""

from __future__ import annotations

import dataclasses
import json
import os
import re

import numpy as np
import pytest
import torch

from experiments import benchmark
from experiments.benchmarks import environments, learner, page, scaling, targets, throughput
from experiments.benchmarks.remote import (
    MeasurementFailed,
    Remote,
    Slice,
    Stopwatch,
    median_rate,
    median_ratio,
    resident_mib,
    total,
)
from experiments.study.presets import PRESETS
from experiments.support.errors import UserError
from tests.experiments.counter import Counter


def env_record(**changes) -> dict:
    return {
        "task": "highway", "level": "50", "traffic_model": "matched", "simulation_frequency": 10,
        "equal_work": False, "sumo_steps_per_s": 700.0, "highway_env_steps_per_s": 5.0, "ratio": 140.0,
        "sumo_wall_steps_per_s": 650.0, "highway_env_wall_steps_per_s": 4.8, "engine_steps_per_s": 1800.0,
        "of_engine_alone": 0.4,
        "engine_share": 0.6, "reset_ms": 1.7, "highway_env_reset_ms": 20.0, "episode_steps": 12,
        "highway_env_steps": 30, "rss_mib": 200.0, **changes,
    }  # fmt: skip


def learner_record(network: str, ratio: float) -> dict:
    return {
        "network": network, "observation": [5, 5], "updates_per_s": 250.0 * ratio, "sb3_updates_per_s": 250.0,
        "ratio": ratio,
    }  # fmt: skip


@pytest.fixture
def results() -> dict:
    """The content of a benchmark.json."""
    content = {
        "schema": 1,
        "quick": True,
        "started": "2024-01-01T00:00:00Z",
        "seconds": 100.0,
        "load_average": [0.5, 0.5, 0.5],
        "provenance": {"cpu": "a <fast> one", "cores": 2, "packages": {
            "libsumo": "1.28.0", "highway-env": "1.12.1", "torch": "2.13.0"}},
        "env": [
            env_record(),
            env_record(traffic_model="sumo", engine_share=0.9),
            env_record(equal_work=True, simulation_frequency=15, ratio=160.0),
            env_record(task="u-turn", level="3", ratio=70.0),
            env_record(task="u-turn", level="12", ratio=20.0),
        ],
        "learner": [
            learner_record("attention", 1.3), learner_record("dueling", 1.4), learner_record("dueling", 0.9),
        ],
        "sweep": [
            {"workers": n, "agents_per_hour": 30.0 * n, "agents_per_hour_on_free_cores": 40.0 * n,
             "measured_updates": 60, "extrapolated": True, "costs": [
                {"task": "highway", "level": "50", "ms_per_update_and_step": 4.0, "ms_per_test_episode": 9.0,
                 "agent_minutes": 3.0}]}
            for n in (1, 2)
        ],
        "vector": [{"task": "highway", "workers": n, "steps_per_s": 500.0 * n} for n in (1, 2, 4)],
        "growth": {
            "vehicles": [25, 50, 100], "highway_env_vehicles": [25, 50],
            "ms_per_step": {"highway_env": [50, 200], "matched": [0.8, 1.5, 3.0], "sumo": [0.7, 1.3, 2.5]},
            "exponent": {"highway_env": 2.0, "matched": 0.95, "sumo": 0.92},
        },
        "memory": {"task": "intersection", "episodes": [10, 20, 30], "rss_mib": [150.0, 151.0, 151.0],
                   "mib_per_1000_episodes": 0.01},
    }  # fmt: skip
    content["targets"] = [goal.as_dict() for goal in targets.compare(content)]
    return content


# -- measuring processes -------------------------------------------------------------------------------------


def test_remote_object_lives_in_another_process_and_keeps_its_state():
    with Remote(Counter, 5) as counter:
        assert counter.call("add", 2) == 7
        assert counter.call("add", 2) == 9
        assert counter.call("process") != os.getpid()


def test_remote_objects_work_at_the_same_time():
    with Remote(Counter, 0) as first, Remote(Counter, 10) as second:
        first.start("add", 1)
        second.start("add", 1)
        assert (first.result(), second.result()) == (1, 11)


def test_error_in_another_process_is_raised_here_and_ends_nothing():
    with Remote(Counter, 0) as counter:
        with pytest.raises(MeasurementFailed, match="no such thing"):
            counter.call("fail")
        assert counter.call("add", 1) == 1


def test_death_of_a_measuring_process_is_reported():
    with Remote(Counter, 0) as counter, pytest.raises(MeasurementFailed, match="exit status 3"):
        counter.call("die")


def test_object_that_cannot_be_made_is_reported():
    with Remote(Counter) as counter, pytest.raises(MeasurementFailed, match="start"):
        counter.call("add", 1)


def test_rates_and_ratios_are_medians_over_the_turns():
    ours = [Slice(100, 2.0, 1.0), Slice(100, 2.0, 0.5), Slice(100, 2.0, 100.0)]  # once the machine was busy
    theirs = [Slice(10, 2.0, 1.0), Slice(10, 2.0, 0.5), Slice(10, 2.0, 100.0)]
    assert median_rate(ours) == 100.0
    assert median_ratio(ours, theirs) == pytest.approx(10.0)


def test_slices_add_up():
    assert total([Slice(2, 3.0, 0.5), Slice(3, 1.0, 1.5)]) == Slice(5, 4.0, 2.0)


def test_stopwatch_counts_only_work_as_processor_time():
    watch = Stopwatch()
    sum(range(100_000))
    part = watch.slice(3)
    assert part.count == 3
    assert part.cpu > 0.0
    assert part.wall > 0.0


def test_resident_memory_is_that_of_a_python_process():
    assert 10 < resident_mib() < 10_000


# -- arithmetic ----------------------------------------------------------------------------------------------


def test_exponent_of_a_power_law():
    sizes = np.array([25.0, 50.0, 100.0])
    assert scaling.slope(np.log(sizes), np.log(3.0 * sizes**1.5)) == pytest.approx(1.5)


def test_agent_costs_its_budget_of_updates_and_its_tests():
    standard = PRESETS["standard"]
    cost = (0.004, 0.010)
    expected = standard.updates["u-turn"] * 0.004 + (2 * standard.episodes + standard.gate_episodes) * 0.010
    assert throughput.agent_seconds({("u-turn", 1): cost}) == pytest.approx(expected)


def test_levels_between_measured_ones_are_interpolated():
    low, high = (0.002, 0.0), (0.006, 0.0)
    mean = throughput.agent_seconds({("highway", 1): low, ("highway", 3): high})
    assert mean == pytest.approx(PRESETS["standard"].updates["highway"] * 0.004)


@pytest.mark.parametrize("network", ["attention", "dueling"])
def test_stable_baselines_gets_the_same_network(network):
    learners = learner.Learners(network, (5, 5))
    ours, theirs = learners._learners["own"]._agent.online, learners._learners["sb3"]._model.q_net.q_net
    assert str(ours) == str(theirs)
    x = torch.rand(3, 5, 5)
    assert learners._learners["sb3"]._model.q_net(x).shape == (3, 5)


# -- targets and page ----------------------------------------------------------------------------------------


def test_targets_stand_beside_what_was_measured(results):
    goals = {goal.name: goal for goal in targets.compare(results)}
    assert goals["times highway-env, highway 50, matched, default"].met is False
    assert goals["times highway-env, highway 50, matched, equal work"].met is True
    assert goals["times highway-env, u-turn, matched, default"].measured == 70.0  # the lowest level
    assert goals["times highway-env, highway 100, matched, default"].met is None
    assert goals["times Stable-Baselines3, an update of attention"].met is True
    assert goals["times Stable-Baselines3, an update of dueling"].measured == 0.9  # the slowest
    assert goals["agents an hour, standard, free cores"].measured == 80.0


def test_page_is_one_file_with_its_pictures_inside(results):
    html = page.render(results)
    assert html.count("<svg") == 6
    assert not re.search(r"(?:src|href)=\"https?://", html)
    assert "a &lt;fast&gt; one" in html
    identifiers = re.findall(r' id="([^"]+)"', html)
    assert len(identifiers) == len(set(identifiers))


def test_page_of_one_part_shows_that_part(results):
    for part in ("env", "sweep", "vector", "growth", "memory"):
        del results[part]
    assert page.render(results).count("<svg") == 1


# -- measuring -----------------------------------------------------------------------------------------------


def test_unknown_part_and_task_are_refused(tmp_path):
    with pytest.raises(UserError, match="learner"):
        benchmark.run(benchmark.Options(tmp_path, parts=("lerner",)))
    with pytest.raises(UserError, match="highway"):
        benchmark.run(benchmark.Options(tmp_path, tasks=("higway",)))


def test_quick_run_measures_the_lowest_and_the_highest_level():
    assert benchmark.levels_of("intersection", every=True) == [1, 5]
    assert benchmark.levels_of("highway", every=False) == [1, 3]
    assert benchmark.levels_of("highway", every=True) == [1, 2, 3]


def test_summary_leaves_out_targets_that_were_not_measured(results, capsys):
    del results["learner"]
    benchmark.summary(targets.compare(results))
    text = capsys.readouterr().out
    assert "highway 50, sumo, default" not in text and "Stable-Baselines3" not in text
    assert re.search(r"u-turn, matched, default +60 +70 +met", text)
    unmeasured = sum(goal.measured is None for goal in targets.compare(results))
    assert f"{unmeasured} targets belong to what was not measured" in text


@pytest.mark.slow
def test_environments_are_compared_at_equal_work_and_by_default():
    effort = environments.Effort(turns=2, seconds=0.05, reference_seconds=0.05, reference_steps=1)
    records = list(environments.measure_task("u-turn", [1], effort, lambda _: None))
    assert [(r["traffic_model"], r["equal_work"]) for r in records] == [
        ("matched", True), ("sumo", True), ("matched", False), ("sumo", False)
    ]  # fmt: skip
    for record in records:
        assert record["simulation_frequency"] == (
            15 if record["equal_work"] else environments.default_frequency()
        )
        assert record["ratio"] > 1.0
        assert 0.0 < record["engine_share"] < 1.0
        assert record["engine_steps_per_s"] > record["sumo_steps_per_s"]
        assert record["reset_ms"] > 0.0


@pytest.mark.slow
def test_training_and_test_cost_time():
    wall, cpu = throughput.Trainee().measure("u-turn", 1, 60, 1)
    assert min(*wall, *cpu) > 0.0


@pytest.mark.slow
def test_vector_counts_the_steps_of_all_its_environments():
    vectors = scaling.Vectors("u-turn")
    vectors.open(2)
    try:
        assert vectors.drive(0.0, 3).count == 6
    finally:
        vectors.close()


@pytest.mark.slow
def test_command_writes_both_files(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(scaling, "SAMPLES", 3)
    small = dataclasses.replace(benchmark.QUICK, learner_turns=1, memory=6)
    monkeypatch.setattr(benchmark, "QUICK", small)
    options = benchmark.Options(tmp_path / "new", quick=True, parts=("learner", "memory"))
    assert benchmark.run(options) == 0
    results = json.loads((tmp_path / "new" / "benchmark.json").read_text())
    assert {record["network"] for record in results["learner"]} == {"attention", "dueling"}
    assert all(record["ratio"] > 0.0 for record in results["learner"])
    assert results["memory"]["episodes"] == [2, 4, 6]
    assert (tmp_path / "new" / "benchmark.html").read_text().count("<svg") == 2
    assert "an update of attention" in capsys.readouterr().out
