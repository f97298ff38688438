"""The command that asks how often a policy crashes where events are rare."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import agents
from agents import pretrained
from experiments import break_even, rare
from experiments.reporting.page import rates
from experiments.support.errors import UserError
from experiments.support.files import read_json

OPTIONS = rare.Options("slower", "u-turn", rates="0.3,1", dose=0.3, episodes=80)


@pytest.fixture(autouse=True)
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rare, "open_executor", lambda *_: (ThreadPoolExecutor(1), 1))
    monkeypatch.setattr(rare, "BATCH", 40)
    monkeypatch.setattr(rare, "PILOT", 20)


@pytest.mark.slow
def test_a_curve_is_written_and_the_command_goes_on_where_it_was_stopped(tmp_path: Path, capsys) -> None:
    options = replace(OPTIONS, out=tmp_path)
    assert rare.rare(options, ["slower"]) == 0
    said, files = capsys.readouterr().out, {path: path.stat() for path in (tmp_path / "episodes").iterdir()}
    found = read_json(tmp_path / "curve.json")
    assert found["episodes"] >= 80 and [row["rate"] for row in found["curve"]] == [0.3, 1.0]
    assert found["curve"][1]["events_per_hour"] == pytest.approx(1080.0)  # the u-turn's 0.3 events a second
    assert pd.read_csv(tmp_path / "curve.csv")["claim"].tolist() == [row["claim"] for row in found["curve"]]
    assert "<svg" in (tmp_path / "curve.svg").read_text() and "Crashes without an event" in said
    driven = pd.concat(pd.read_parquet(path) for path in files)
    for events, rate in (("near", "level"), ("other", "base")):  # as many as are expected, but for chance
        expected = (driven[rate] * driven[f"{events}_expected"]).sum()
        assert abs(driven[events].sum() - expected) < 4 * expected**0.5 < expected
    next(iter(files)).write_bytes(b"damaged")
    assert rare.rare(options, ["slower"]) == 0
    assert read_json(tmp_path / "curve.json")["curve"] == found["curve"]
    again = {path: path.stat() for path in (tmp_path / "episodes").iterdir()}
    assert again.keys() == files.keys() and sum(again[path] != files[path] for path in files) == 1
    assert rare.rare(replace(options, plain=True, rates="1", episodes=40), ["slower"]) == 0
    counted = read_json(tmp_path / "curve.json")
    assert counted["levels"] == [] and counted["curve"][0]["effective_episodes"] == pytest.approx(40.0)


def test_rates_are_two_in_each_decade_or_those_that_are_named() -> None:
    assert rare.rates_of("1e-2:1") == (0.01, 0.0316, 0.1, 0.316, 1.0)
    assert rare.rates_of("0.5,0.1") == (0.1, 0.5)


@pytest.mark.parametrize("wrong", [{"seed": -1}, {"workers": 0}, {"dose": 2.0}], ids=str)
def test_a_number_out_of_range_is_refused(wrong) -> None:
    with pytest.raises(UserError, match=f"--{min(wrong)} is "):
        rare.question(replace(OPTIONS, **wrong))


@pytest.mark.slow
def test_break_even_drives_all_published_agents_of_both_arms(tmp_path: Path, monkeypatch, capsys) -> None:
    about = agents.card("u-turn-3", "control")
    first = agents.load("u-turn-3", "control")
    stored = {
        f"u-turn-3/{arm}{seed}": (about, first) for arm in ("control", "treatment") for seed in ("", "-s1")
    }
    monkeypatch.setattr(pretrained, "FILE", tmp_path / "agents.npz")
    for function in (pretrained.cards, pretrained.load):
        monkeypatch.setattr(function, "__defaults__", (tmp_path / "agents.npz", *function.__defaults__[1:]))
    options = break_even.Options(
        tasks=("u-turn",), rates="0.3,1", dose=0.3, episodes=8, out=tmp_path / "break-even"
    )
    with pytest.raises(UserError, match="agents"):
        break_even.run(options, [])
    pretrained.save(stored, tmp_path / "agents.npz")
    assert break_even.run(options, ["--tasks", "u-turn"]) == 0
    found = read_json(options.out / "break-even.json")
    assert found["agents"]["u-turn"]["treatment"] == ["u-turn-3/treatment", "u-turn-3/treatment-s1"]
    assert capsys.readouterr().out.splitlines()[-2] == f"u-turn: {found['words']['u-turn']}"
    table = pd.read_csv(options.out / "break-even.csv")
    assert list(table["events_per_hour"]) == pytest.approx([324.0, 1080.0])
    ours = pd.read_csv(options.out / "agents.csv")
    # of each arm one agent twice, in scenarios of two numbers
    assert (ours.groupby("rate")["crashes_per_100_km_high"].nunique() == 2).all()
    means = ours[ours["agent"].str.contains("treatment")].groupby("rate").mean(numeric_only=True)
    for per in ("per_episode", "per_100_km"):
        np.testing.assert_allclose(table[f"treatment_{per}"], means[f"crashes_{per}"], rtol=1e-4)
    assert "near-crashes" in rates(options.out)["figure"]
