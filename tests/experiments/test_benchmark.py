"""The benchmark: its arithmetic, and every part on next to nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console

from experiments import benchmark
from experiments.benchmark import REFERENCE, Options, beside, in_turns, run
from experiments.timed import Driver


def test_ratios_are_taken_turn_by_turn() -> None:
    rates = {"ours": iter([10, 5, 10]), REFERENCE: iter([1, 0.5, 2])}  # the second turn was slow for both
    found = in_turns({side: rate.__next__ for side, rate in rates.items()}, 3)
    assert beside(found, "ours") == {"steps_per_second": 10.0, "highway_env": 1.0, "ratio": 10.0}


def test_a_slice_ends_with_an_episode_and_holds_its_resets() -> None:
    driver = Driver("sumo", "u-turn", {"simulation_frequency": 15})
    assert driver.rate(0.0) > 0.0 and driver._done
    assert driver.rate(0.0) > 0.0 and driver.reset_ms() > 0.0
    driver._env.close()


@pytest.mark.slow
def test_the_command_measures_every_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    for name, value in {"has_envpool": lambda: False, "QUICK_TURNS": 2, "QUICK_SECONDS": 0.02}.items():
        monkeypatch.setattr(benchmark, name, value)
    results = run(Options(tmp_path, quick=True, tasks=("u-turn",)), Console(width=200))
    assert json.loads((tmp_path / "benchmark.json").read_text()) == results
    assert [r["of"] for r in results["env"]] == [
        f"{side}, u-turn {level}"
        for level in ("3", "12")
        for side in ("sumo 10 Hz", "sumo 15 Hz", "replica 15 Hz")
    ]
    assert all(r["ratio"] > 1.0 and r["reset_ms"] > 0.0 for r in results["env"])
    assert 0.0 < results["start"][0]["first_step_seconds"] < 60.0
    assert all(r["update_ms"] > 0.0 for r in results["learner"])
    stock, replica, sumo = results["peers"]
    names = [r["of"].partition(", ") for r in (stock, replica, sumo)]
    assert names == [(name, ", ", "u-turn") for name in ("highway-env", "replica", "sumo")]
    assert stock["ratio"] == 1.0 and stock["distinct"] == 100 and replica["ratio"] > 1.0
    assert (replica["distinct"], replica["idle_crash_rate"]) == (stock["distinct"], stock["idle_crash_rate"])
    assert [r["of"] for r in results["batches"]] == ["u-turn default", "u-turn 3", "u-turn 12"]
    assert results["batches"][0]["steps_per_second"] > replica["steps_per_second"]
    assert all(r["envpool"] is None and r["two_threads"] > 0.0 for r in results["batches"])
    printed = capsys.readouterr()
    assert "EnvPool is left out" in printed.err and "update_ms" in printed.out
