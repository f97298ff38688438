"""The estimators of the dose of risk are trained by one command."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
import torch

import agents
from agents.belief import Estimator
from agents.plugins import sha256
from experiments import estimators as command
from experiments.estimators import published
from experiments.study.design import estimators


def test_a_setting_gets_its_estimator_and_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """From few scenarios, so that it is no good; but another time the same."""
    monkeypatch.setattr(estimators, "FOLDER", tmp_path / "estimators")
    monkeypatch.setitem(command.SCENARIOS, "u-turn", 4)
    monkeypatch.setattr(command, "HELD_OUT", 3)
    found = []
    for _ in range(2):
        assert command.main(command.Options(("u-turn-3",))) == 0
        found.append(sha256(tmp_path / "estimators" / "u-turn-3.npz"))
    assert found[0] == found[1] and found[0] in capsys.readouterr().out
    table = pd.read_csv(tmp_path / "estimators" / "estimators.csv")
    assert table[["setting", "episodes", "held_out"]].to_numpy().tolist() == [["u-turn-3", 8, 6]]
    assert Estimator.load(tmp_path / "estimators" / "u-turn-3.npz").traces.shape[0] == 6


def test_published_agents_drive_or_those_of_the_lightest_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if there were none of the densest two-way road."""
    there = {name: card for name, card in agents.cards().items() if not name.startswith("two-way-15+6/")}
    monkeypatch.setattr(agents, "cards", lambda: there)
    weights = [published("two-way", level)[0].network.state_dict() for level in (1, 3)]
    assert all(torch.equal(own, weights[1][name]) for name, own in weights[0].items())
    assert len(published("u-turn", 4)) == len(command.DRIVERS)
