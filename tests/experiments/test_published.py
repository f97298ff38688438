"""Agents in the file that is published: which, with what on their cards, and driving as they did."""

from dataclasses import replace
from pathlib import Path
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


@pytest.mark.slow
def test_an_agent_can_be_published_and_loaded(tmp_path: Path, monkeypatch, here: None) -> None:
    """With its card, and driving as it did but for its weights' half precision, also where it observes the time.

    Of several agents that of the lowest seed, and in the lightest setting all.
    """
    monkeypatch.setitem(PRESETS, "quick", replace(PRESETS["smoke"], preset="quick"))  # train.py's
    file, settings = tmp_path / "agents.npz", {"intersection": "intersection-10", "u-turn": "u-turn-3"}
    several: dict[str, Any] = {"seeds": 2, "first_seed": 9, "levels": (1, 4)}
    for task, more in zip(settings, ({}, several), strict=True):
        one = replace(train.default(out=tmp_path), tasks=(task,), arms=("control",), updates=60)
        train.train(replace(one, **more), ["--arms", "control"])
    publish.main(tmp_path, file)
    of_u_turn = ["u-turn-12/control", "u-turn-3/control", "u-turn-3/control-s10"]
    assert list(agents.cards(file)) == ["intersection-10/control", *of_u_turn]
    assert ["-s9-" in agents.cards(file)[name]["cell"] for name in of_u_turn] == [True, True, False]
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
