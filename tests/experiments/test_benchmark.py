"""The benchmark: its arithmetic, and every part on next to nothing."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path

import pandas as pd
import pytest

from experiments import benchmark
from experiments.benchmark import Driver, Options, ratios, run


def test_ratios_are_taken_turn_by_turn() -> None:
    rates = pd.DataFrame({"theirs": [1, 0.5, 2], "ours": [10, 5, 10]})  # the second turn was slow for both
    assert ratios(rates) == [
        {"of": "theirs", "steps_per_second": 1.0, "ratio": 1.0},
        {"of": "ours", "steps_per_second": 10.0, "ratio": 10.0},
    ]


def test_a_slice_ends_with_an_episode_and_holds_its_resets() -> None:
    driver = Driver("sumo", "u-turn", {"simulation_frequency": 15})
    assert min(driver.rate(0.0)) > 0.0 and driver._done
    assert min(driver.rate(0.0)) > 0.0 and driver.reset_ms() > 0.0
    driver._env.close()


class Here(nullcontext):
    """In place of a process."""

    Driver = Driver

    def __init__(self, ctx: object) -> None:
        super().__init__(self)


@pytest.mark.slow
def test_the_command_measures_every_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    for name, value in {"has_envpool": lambda: False, "QUICK_TURNS": 2, "QUICK_SECONDS": 0.02}.items():
        monkeypatch.setattr(benchmark, name, value)
    peers = run(Options(tmp_path, quick=True, tasks=("u-turn",), parts=("peers",)))
    monkeypatch.setattr(benchmark, "Process", Here)  # what follows would start many
    results = run(Options(tmp_path, quick=True, tasks=("u-turn",), parts=("env", "batches")))
    assert json.loads((tmp_path / "benchmark.json").read_text()) == results
    assert [r["of"] for r in results["env"]] == [
        f"{side}, u-turn {level}"
        for level in ("3", "12")
        for side in ("highway-env", "sumo 10 Hz", "sumo 15 Hz", "replica 15 Hz")
    ]
    ours = [r for r in results["env"] if not r["of"].startswith("highway-env")]
    assert all(r["ratio"] > 1.0 and r["reset_ms"] > 0.0 for r in ours)
    stock, replica, sumo = peers["peers"]
    names = [r["of"].partition(", ") for r in (stock, replica, sumo)]
    assert names == [(name, ", ", "u-turn") for name in ("highway-env", "replica", "sumo")]
    assert stock["ratio"] == 1.0 and stock["distinct"] == 100 and replica["ratio"] > 1.0
    assert replica["distinct"] == stock["distinct"]
    assert [r["of"] for r in results["batches"]] == [
        f"{side}, u-turn {level}"
        for level in ("default", "3", "12")
        for side in ("replica", "replica on two threads (wall time)")
    ]
    assert results["batches"][0]["steps_per_second"] > replica["steps_per_second"]
    assert all(r["ratio"] > 0.0 for r in results["batches"])
    printed = capsys.readouterr()
    assert "EnvPool is left out" in printed.err and "steps_per_second" in printed.out
