"""The benchmark: its arithmetic, and every part on next to nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console

from experiments import benchmark
from experiments.benchmark import Driver, Options, Slice, median_rate, median_ratio, remote, run


class Counter:
    """Counts up; lives in a process of its own."""

    def __init__(self, first: int) -> None:
        self.value = first

    def add(self, more: int) -> int:
        self.value += more
        if more == 0:
            raise ValueError("nothing to add")
        return self.value


def test_an_object_in_another_process_keeps_its_state_and_reports_errors() -> None:
    with remote(Counter, 5) as counter:
        assert counter.add(2) == 7
        with pytest.raises(ValueError, match="nothing to add"):
            counter.add(0)
        assert counter.add(1) == 8


def test_ratios_are_taken_turn_by_turn() -> None:
    ours = [Slice(10, 1.0), Slice(10, 2.0), Slice(10, 1.0)]
    theirs = [Slice(1, 1.0), Slice(1, 2.0), Slice(1, 0.5)]
    assert median_ratio(ours, theirs) == 10.0  # of 10, 10 and 5: the second turn was slow for both
    assert median_rate(ours) == 10.0


def test_a_slice_ends_with_an_episode_and_holds_its_resets() -> None:
    driver = Driver("sumo", "u-turn", {"simulation_frequency": 15})
    assert 1 <= driver.drive(0.0).count <= 10
    assert driver._done
    assert driver.reset_ms() > 0.0
    assert 1 <= driver.bare_engine(0.0).count <= 10
    driver._env.close()


@pytest.mark.slow
def test_the_command_measures_every_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(benchmark, "QUICK_TURNS", 2)
    monkeypatch.setattr(benchmark, "QUICK_SECONDS", 0.02)
    results = run(Options(tmp_path, quick=True, tasks=("u-turn",), backends=("sumo",)), Console(width=200))
    assert json.loads((tmp_path / "benchmark.json").read_text()) == results
    assert [r["of"] for r in results["env"]] == [
        f"sumo {hertz} Hz, u-turn {level}" for level in ("3", "12") for hertz in (10, 15)
    ]
    assert all(r["ratio"] > 1.0 and r["of_bare_engine"] > 0.0 for r in results["env"])
    assert 0.0 < results["start"][0]["first_step_seconds"] < 60.0
    assert {r["of"] for r in results["learner"]} == {"attention", "dueling"}
    stock, *others = results["peers"]
    assert stock["of"] == "highway-env, u-turn" and stock["ratio"] == 1.0 and stock["distinct"] == 100
    replica = next(r for r in others if r["of"] == "replica, u-turn")
    assert replica["ratio"] > 1.0
    assert (replica["distinct"], replica["crash_rates"]) == (stock["distinct"], stock["crash_rates"])
    assert "stable_baselines3" in capsys.readouterr().out
