"""One agent from the command line: trained, shown and tested."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from PIL import Image

import agents
from experiments import evaluate, report, train, watch
from experiments.backends import make_env
from experiments.study.compute import evaluate as compute
from experiments.study.design.presets import PRESETS
from experiments.study.replaying import publish
from experiments.study.results import store
from experiments.study.results.schema import EPISODES
from experiments.support import films
from experiments.support.errors import UserError

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", autouse=True)
def quick_as_smoke(all_here: None) -> Iterator[None]:
    """One agent is trained by the preset "quick", here by as little as "smoke" asks for, and in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "quick", replace(PRESETS["smoke"], preset="quick"))
        yield


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with an agent that was hardly trained."""
    directory = tmp_path_factory.mktemp("mine")
    assert (
        train.train(replace(train.default(out=directory), arms=("mixed",), updates=60), ["--arms", "mixed"])
        == 0
    )
    return directory


def test_the_agent_is_an_ordinary_cell(trained: Path) -> None:
    [name] = store.Store(trained).agents()
    key = store.Store(trained).record(name)["key"]
    assert (key["kind"], key["arm"], key["seed"], key["profile"]["updates"]) == ("agent", "mixed", 0, 60)
    picture = Image.open(trained / f"{name}.png")
    assert min(picture.size) > 200
    assert report.write_report(trained).is_file()


def test_it_takes_the_frozen_test(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sumo_env.benchmark.QUICK", 2)
    assert evaluate.evaluate(evaluate.Options(str(trained), quick=True, out=tmp_path), ["results/mine"]) == 0
    card = json.loads((tmp_path / evaluate.CARD).read_text())
    [name] = store.Store(trained).agents()
    # also at the level that it was not trained in
    assert card["drivers"] == {"u-turn 3": name, "u-turn 12": name}
    assert {row["task"] for row in card["rows"]} == {"u-turn"}


def test_it_is_filmed_at_both_risks(trained: Path, capsys) -> None:
    assert watch.watch(watch.Options(trained, scenario=1)) == 0
    said = capsys.readouterr().out
    assert "risk 0: " in said
    assert "risk 1: " in said
    film: Any = Image.open(trained / "sumo-u-turn-3-mixed-s0-1.gif")
    width: Any = films.PANEL["screen_width"]
    assert film.size[0] > 2 * width
    assert film.n_frames > 5
    assert "Crashes in test scenarios by traffic: risk 0 " in said and "chosen by hand" in said


def test_the_scenario_is_chosen_by_a_rule_that_is_said() -> None:
    columns = ("traffic", "scenario", "near_misses", "crashed")
    rows = [("regular", 0, 3, False), ("risky", 0, 0, False), ("risky", 1, 2, True), ("risky", 2, 1, False)]
    table = pd.DataFrame(rows, columns=columns)
    here = Path()
    assert watch.scenario_of(table, watch.Options(here)) == (2, watch.NEARLY)
    assert watch.scenario_of(table, watch.Options(here, crash=True)) == (1, watch.CRASHES)
    assert watch.scenario_of(table[:3], watch.Options(here))[0] == 0
    assert watch.scenario_of(table[2:3], watch.Options(here)) == (1, watch.CRASHES)
    assert watch.scenario_of(table, watch.Options(here, scenario=7)) == (7, "chosen by hand")


def test_what_does_not_exist_is_said(trained: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="there are: sumo-u-turn-3-mixed-s0"):
        watch.watch(watch.Options(trained, agent="treatment"))
    with pytest.raises(UserError, match="no trained agent"):
        watch.watch(watch.Options(tmp_path))


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


def test_an_agent_can_be_published_and_loaded(tmp_path: Path) -> None:
    """With its card, and driving as it did but for its weights' half precision, also where it observes the time."""
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
        env, asked = make_env("sumo", task, card["config"]), compute.drives(task, 1, range(2), ("regular",))
        first, again = (
            compute.evaluate(env, policy, asked)
            for policy in (original, agents.load(setting, "control", file))
        )
        env.close()
        assert list(again["actions"]) == list(first["actions"])
        assert list(again["return"]) == list(first["return"])
