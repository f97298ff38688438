"""The benchmark: its arithmetic on rates that are given, and a slice of each kind of driver."""

import json
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest

from experiments import benchmark
from experiments.benchmark import REFERENCE_CONFIG, Driver, Options, ratios, run


def test_ratios_are_taken_turn_by_turn() -> None:
    rates = pd.DataFrame({"theirs": [1, 0.5, 2], "ours": [10, 5, 10]})  # the second turn was slow for both
    assert ratios(rates) == [
        {"of": "theirs", "steps_per_second": 1.0, "ratio": 1.0},
        {"of": "ours", "steps_per_second": 10.0, "ratio": 10.0},
    ]


@pytest.mark.parametrize(
    "arguments",
    [("sumo", {"simulation_frequency": 15}), ("highway-env",), ("replica",), ("replica", {}, 4, 2)],
    ids=str,
)
def test_a_slice_ends_with_an_episode_and_holds_its_resets(arguments: tuple[Any, ...]) -> None:
    backend, *more = arguments
    driver = Driver(backend, "u-turn", *more)
    assert min(driver.rate(0.0)) > 0.0 and driver._done >= driver._whole
    if driver._whole:
        assert min(driver.rate(0.0)) > 0.0 and driver.reset_ms() > 0.0
    with patch.object(driver._env, "step", wraps=driver._env.step) as step:
        begun, (_, rate) = time.perf_counter(), driver.rate(0.0)
    assert rate * (time.perf_counter() - begun) >= sum(np.size(call.args[0]) for call in step.call_args_list)
    assert driver.distinct(3) == 3
    driver._env.close()


class Given(nullcontext):
    """In place of a process: drivers of these rates, in processor time and in wall time."""

    RATES = {"highway-env": 10.0, "replica": 1000.0, "sumo": 200.0}  # noqa: RUF012

    def __init__(self, ctx: object) -> None:
        super().__init__(self)

    def Driver(
        self, backend: str, task: str, config: Any = None, batch: int = 1, threads: int = 1
    ) -> "Given":
        assert backend != "highway-env" or config is None or REFERENCE_CONFIG.items() <= config.items()
        self.rates = self.RATES[backend] * batch, self.RATES[backend] * batch * threads
        return self

    def rate(self, seconds: float) -> tuple[float, float]:
        return self.rates

    def reset_ms(self) -> float:
        return 2.0

    def distinct(self, seeds: int) -> int:
        return seeds


def test_the_command_measures_every_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(benchmark, "has_envpool", lambda: False)
    monkeypatch.setattr(benchmark, "Process", Given)
    results = run(Options(tmp_path, quick=True, tasks=("u-turn",), parts=("peers", "env", "batches")))
    assert json.loads((tmp_path / "benchmark.json").read_text()) == results
    found = {
        part: {line["of"]: line["ratio"] for line in results[part]} for part in ("peers", "env", "batches")
    }
    assert found["peers"] == {"highway-env, u-turn": 1.0, "replica, u-turn": 100.0, "sumo, u-turn": 20.0}
    assert {line["distinct"] for line in results["peers"]} == {100}
    sides = {"highway-env": 1.0, "sumo 10 Hz": 20.0, "sumo 15 Hz": 20.0, "replica 15 Hz": 100.0}
    levels = ("default", "3", "12")
    assert found["env"] == {f"{side}, u-turn {k}": sides[side] for k in levels[1:] for side in sides}
    sides = {"replica": 1.0, "replica on two threads (wall time)": 2.0}
    assert found["batches"] == {f"{side}, u-turn {k}": sides[side] for k in levels for side in sides}
    assert results["batches"][0]["steps_per_second"] == 64_000.0
    printed = capsys.readouterr()
    assert "EnvPool is left out" in printed.err and "steps_per_second" in printed.out
