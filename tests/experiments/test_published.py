"""Agents in the file that is published: which, with what on their cards, and driving as they did."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import agents
from experiments import train
from experiments.backends import make_env
from experiments.study.compute import evaluate as compute
from experiments.study.design.presets import PRESETS
from experiments.study.replaying import publish
from experiments.study.results import store
from experiments.study.results.schema import EPISODES


def test_of_several_agents_that_of_the_lowest_seed_is_published(monkeypatch, tmp_path: Path) -> None:
    """And in the lightest setting all."""
    key, places = (
        {"backend": "sumo", "task": "u-turn", "arm": "control"},
        product(((1, "3"), (4, "12")), (9, 10)),
    )
    cells = {
        f"{name}-{k}": {"key": {**key, "level": level, "level_name": name, "seed": k}}
        for (level, name), k in places
    }
    here: Any = SimpleNamespace(
        agents=lambda: cells, weights=str, sweeps=lambda: [{"command": "", "cells": cells}]
    )
    file, kept = tmp_path / "agents.npz", dict[str, Any]()
    monkeypatch.setattr(publish, "Store", lambda _: here)
    monkeypatch.setattr(publish, "published", lambda _, name, __: ({"risky": {"crash_rate": name}}, name))
    monkeypatch.setattr(
        publish.pretrained, "save", lambda found, _: (kept.update(found), file.write_bytes(b""))
    )
    publish.main(tmp_path, file)
    assert {label: name for label, (_, name) in kept.items()} == {
        "u-turn-12/control": "12-9", "u-turn-3/control": "3-9", "u-turn-3/control-s10": "3-10"
    }  # fmt: skip


@pytest.mark.slow
def test_an_agent_can_be_published_and_loaded(tmp_path: Path, monkeypatch, here: None) -> None:
    """With its card, and driving as it did but for its weights' half precision, also where it observes the time."""
    monkeypatch.setitem(PRESETS, "quick", replace(PRESETS["smoke"], preset="quick"))  # train.py's
    file, settings = tmp_path / "agents.npz", {"intersection": "intersection-10", "u-turn": "u-turn-3"}
    for seeds, task in enumerate(settings, start=1):
        options = replace(
            train.default(out=tmp_path), tasks=(task,), arms=("control",), updates=60, seeds=seeds
        )
        train.train(options, ["--arms", "control"])
    publish.main(tmp_path, file)
    assert list(agents.cards(file)) == [
        *(f"{setting}/control" for setting in settings.values()),
        "u-turn-3/control-s1",
    ]
    for task, setting in settings.items():
        card = agents.card(setting, "control", file)
        assert card["time_observed"] == (13 if task == "u-turn" else 0)  # as long as its training
        tested = store.Store(tmp_path).tables(card["cell"])[EPISODES]
        regular = tested[tested["traffic"] == "regular"]
        value, low, high = card["regular"]["crash_rate"]
        assert value == pytest.approx(regular["crashed"].mean())
        assert 0 <= low <= value <= high <= 1
        _, original = publish.published(tmp_path, card["cell"], "")
        original.network.half().float()
        env, asked = make_env("sumo", task, card["config"]), (task, 1, range(2), ("regular",))
        first, again = (
            compute.evaluate(env, policy, *asked)
            for policy in (original, agents.load(setting, "control", file))
        )
        env.close()
        assert list(again["actions"]) == list(first["actions"])
        assert list(again["return"]) == list(first["return"])
