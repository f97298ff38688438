"""The choice of the learner: agents that no report uses, the table, and the rule."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pandas as pd
import pytest

from experiments.choose import CANDIDATES, PLACES, Options, cells, choose, rank, together
from experiments.study.compute.cells import compute
from experiments.study.design.arms import PAIRS
from experiments.study.design.presets import PRESETS
from experiments.study.results.store import load
from experiments.support.errors import UserError
from tests.experiments import synthetic
from tests.experiments.fake_env import make_env


def test_no_report_uses_its_training_seeds_or_scenarios() -> None:
    own = PRESETS["choice"]
    seeds = set(range(own.first_seed, own.first_seed + own.seeds))
    for name, preset in PRESETS.items():
        if name != "choice":
            assert not seeds & set(range(preset.first_seed, preset.first_seed + 2 * preset.seeds))
            assert first_free(preset) <= own.first_scenario
    assert len(cells("tuned")) == 2 * (2 * 3 + 6)


def first_free(preset) -> int:
    return preset.first_scenario + max(preset.episodes, preset.gate_episodes)


def test_candidates_differ_by_their_settings_alone() -> None:
    plain = [cell for cell in cells("tuned") if cell.kind == "agent"]
    for name, settings in CANDIDATES.items():
        other = [cell for cell in cells(name) if cell.kind == "agent"]
        differing = {
            key
            for a, b in zip(plain, other, strict=True)
            for key in a.profile
            if a.profile[key] != b.profile[key]
        }
        assert differing == {setting.partition("=")[0] for setting in settings}
        baselines = [
            [cell.name for cell in cells(each) if cell.kind == "baseline"] for each in ("tuned", name)
        ]
        assert baselines[0] == baselines[1]
    with pytest.raises(UserError, match="candidate"):
        cells("nobody")


def found(**gates_and_shares: tuple[int, float]) -> pd.DataFrame:
    rows = [
        {
            "candidate": name,
            "task": task,
            "arm": arm,
            "seed": 7000,
            "gates": gates,
            "share": share,
            "cpu": 1.0,
        }
        for name, (gates, share) in gates_and_shares.items()
        for task in PLACES
        for arm in ("control", "treatment")
    ]
    return pd.DataFrame(rows)


def test_gates_come_before_the_return() -> None:
    assert rank(found(a=(5, 0.9), b=(6, 0.1), c=(6, 0.2)))["candidate"].tolist() == ["c", "b", "a"]
    with pytest.raises(UserError, match="same agents"):
        rank(found(a=(5, 0.9), b=(6, 0.1)).iloc[:-1])


def test_agents_of_a_seed_are_tested_together_by_every_rule(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("experiments.study.design.experiment.digest", lambda cell: "0" * 64)
    own = cells("tuned", pairs=True)
    assert {cell.arm for cell in own if cell.pair} == {*PAIRS}
    written = synthetic.write(tmp_path, {"two-way": (1,)}, tests=8, pairs=True, preset="choice")
    results = load(tmp_path)
    found = together(results, results.cells).set_index(["traffic", "arm"])
    assert [*found.loc["risky"].index] == ["control", "treatment", *PAIRS]
    rates = results.episodes.groupby(["traffic", "arm"])["crashed"].mean() * 100
    for (traffic, arm), row in found.iterrows():
        assert row["crashed"] == pytest.approx(rates[traffic, arm])
        assert row["minus control"] == pytest.approx(rates[traffic, arm] - rates[traffic, "control"])
        assert row["minus treatment"] == pytest.approx(rates[traffic, arm] - rates[traffic, "treatment"])
    assert len(written) == 2 * 3 + 3 * len(PAIRS) + 6


def test_two_candidates_are_computed_and_ranked(tmp_path, capsys, monkeypatch, here) -> None:
    monkeypatch.setitem(PRESETS, "choice", replace(PRESETS["choice"], seeds=1, gate_episodes=2))
    monkeypatch.setattr("experiments.choose.compute", partial(compute, make_env=make_env))
    monkeypatch.setattr("experiments.choose.check_dynamics", set)
    options = Options(tmp_path, candidates=("tuned", "short-sighted"), updates=20, episodes=2, workers=2)
    assert choose(options, []) == 0
    printed = capsys.readouterr().out
    assert "chosen: " in printed and "short-sighted" in printed
