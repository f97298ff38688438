"""The frozen test from the command line: who may take it, what a card says, and when cards may be compared."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import agents
from experiments import evaluate
from experiments.reporting.card import ALL, rows
from experiments.study.compute.entrants import entrant_of, entrants
from experiments.support.errors import UserError
from experiments.support.films import PANEL, panel
from sumo_env.benchmark import SETTINGS, TRAFFICS
from sumo_env.networks.lanes import WIDTH
from sumo_env.tasks import get_task

OWN = """
class Slow:
    def act(self, observation):
        if self.env.unwrapped.config["risk"] and self.env.unwrapped.scene.time > 2:
            FAULT
        return 4


def make(env):
    policy = Slow()
    policy.env = env
    return policy
"""


@pytest.fixture
def short(here: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Two scenarios of each group, driven in this process, and no entries; returns the file for these."""
    monkeypatch.setattr("sumo_env.benchmark.QUICK", 2)
    monkeypatch.setattr(evaluate, "ENTRIES", tmp_path / "entries.json")
    return tmp_path / "entries.json"


def taken(policy: str, tmp_path: Path, **options: Any) -> dict[str, Any]:
    asked = evaluate.Options(policy, tasks=("u-turn",), quick=True, out=tmp_path, **options)
    assert evaluate.evaluate(asked, [policy]) == 0
    return json.loads((tmp_path / evaluate.CARD).read_text())


def test_a_policy_of_one_s_own_gets_the_card_of_the_rule_that_it_is(short: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN.replace("FAULT", "pass"))
    own = taken(f"{tmp_path}/mine.py:make", tmp_path)
    assert own["rows"] == taken("slower", tmp_path)["rows"]
    places = [(row["traffic"], row["level"], row["episodes"]) for row in own["rows"]]
    sizes = {ALL: 4, "3": 2, "12": 2}
    assert places == [(traffic, level, n) for traffic in TRAFFICS for level, n in sizes.items()]
    for row in own["rows"]:
        assert row["entered"] is None  # there is no crossing
        for value, low, high in (row["crashed"], row["return"]):
            assert low <= value <= high


@pytest.mark.parametrize("task", ["highway", "two-way", "merge"])
def test_the_film_of_a_straight_road_is_low_and_has_all_lanes_in_sight_of_each(task: str) -> None:
    shown, road = panel(task, {}), get_task(task).road(dict(get_task(task).defaults))
    sides = [lane.position(10.0, 0.0)[1] for lane in road.lanes.values()]
    reach = shown["screen_height"] / 2 / shown["scaling"] - WIDTH / 2
    assert max(sides) - min(sides) < reach and shown["screen_height"] < PANEL["screen_height"] / 1.5


def test_the_worst_crash_of_a_task_is_filmed_beside_a_driver_without_one(
    short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Driven again, it is the crash that the test had met; another film where nobody of the others survives."""
    shown: list[list[str]] = []

    def side_by_side(films: Any, caption: list[str]) -> Any:
        shown.append([*(title for title, _ in films), *caption])
        return films[0][1]

    monkeypatch.setattr("experiments.study.replaying.crash.side_by_side", side_by_side)
    asked = evaluate.Options("faster", tasks=("u-turn",), quick=True, film=True, out=tmp_path)
    card, rules, [crash] = evaluate.evaluated(asked, [])
    named = {**card, "name": "ppo.zip"}, rules, [crash]
    monkeypatch.setattr(evaluate, "evaluated", lambda *_: named)
    assert evaluate.evaluate(asked, []) == 0
    monkeypatch.setattr("experiments.study.replaying.crash.OTHERS", ("faster", "idle"))
    evaluate.beside_another(crash, "mine")
    (own, other, where, _), (alone, there, words) = shown
    assert (
        "crash after" in own
        and own.endswith(f"closing at {crash.speed:.0f} m/s")
        and "crash after" not in other
    )
    assert alone == own.replace("ppo.zip", "mine") and there == where and "Nobody of faster, idle" in words
    assert (
        f"u-turn {crash.scenario.level}, {crash.scenario.traffic}, scenario {crash.scenario.number}" in where
    )
    assert (tmp_path / "ppo-u-turn.gif").read_bytes().startswith(b"GIF")
    assert "ppo-u-turn.gif" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("fault", "words"),
    [("raise KeyError('oh')", "KeyError: 'oh' (mine.py, line 5)"), ("return 1, None", "predict")],
)
def test_what_a_policy_drove_before_it_failed_is_kept(
    fault: str, words: str, short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(OWN.replace("FAULT", fault))
    asked = evaluate.Options(f"{tmp_path}/mine.py:make", tasks=("u-turn",), quick=True, out=tmp_path)
    assert evaluate.evaluate(asked, []) == 1
    card = json.loads((tmp_path / evaluate.CARD).read_text())
    assert {row["traffic"] for row in card["rows"]} == {"regular", "measured"}
    assert {*card["failed"]} == {
        f"u-turn-{level}-{kind}" for level in (3, 12) for kind in ("risky", "no-events")
    }
    said = capsys.readouterr().err
    assert words in said and "scenario 0 of u-turn-3-risky" in said
    assert "Not all was driven" in (tmp_path / evaluate.PAGE).read_text()


def test_a_task_that_is_not_frozen_is_tested_beside_rules(short: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(evaluate, "POLICIES", ("idle", "careful"))
    asked = evaluate.Options("slower", tasks=("merge",), quick=True, out=tmp_path)
    assert evaluate.evaluate(asked, []) == 0
    page = (tmp_path / evaluate.PAGE).read_text()
    assert "Not frozen" in page and all(
        f'<th scope="row">{rule}</th>' in page for rule in ("idle", "careful")
    )
    with pytest.raises(UserError, match="frozen scenarios"):
        evaluate.evaluate(replace(asked, entry="slow"), [])


def test_another_set_says_so_and_enters_no_table(short: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    """Two scenarios have another digest than forty; with their own digest they are the set that is asked for."""
    card = taken("slower", tmp_path)
    assert len(card["changed"]) == 2 * len(TRAFFICS) and "not the frozen" in capsys.readouterr().out
    assert "Another set" in (tmp_path / evaluate.PAGE).read_text()
    with pytest.raises(UserError, match="frozen scenarios alone"):
        taken("slower", tmp_path, entry="slow")
    assert not short.exists()
    monkeypatch.setattr("experiments.study.compute.frozen_test.digest", lambda _: "same")
    monkeypatch.setattr(evaluate, "stored", lambda group, quick=False: "same")
    first = taken("slower", tmp_path, entry="slow")
    second = taken("idle", tmp_path, entry="idle")
    assert second["changed"] == [] and evaluate.entries() == {"slow": first, "idle": second}
    row = '<th scope="row">slow</th>'
    beside = evaluate.page(second, {"slow": first})
    assert beside.count(row) == len(TRAFFICS) and ">slow</text>" in beside
    apart = evaluate.page(second, {"slow": {**first, "set": {"u-turn": "another"}}})
    assert row not in apart and ">slow</text>" not in apart


def test_who_drives_where() -> None:
    places = {(task, level) for task, levels in SETTINGS.items() for level in levels}
    control = entrants("control", places)  # published agents, each in the setting of its training
    assert control.keys() == places and control["u-turn", "3"].name == "u-turn-3/control"
    there = agents.cards()
    for (task, level), one in control.items():  # or else in one of the same task
        name = f"{task}-{level}/control"
        assert one.name == name or (name not in there and one.name.startswith(f"{task}-"))
    assert {task: one.name for (task, _), one in entrants("u-turn-3/treatment", places).items()} == {
        "u-turn": "u-turn-3/treatment"
    }
    assert entrant_of("{task}-{level}.zip", "highway", "50").name == "highway-50.zip"


def test_the_numbers_of_a_card_are_those_of_its_episodes() -> None:
    n = 50
    crashed = np.arange(2 * n) % n < 5  # of either level
    way = np.r_[np.full(n, 100.0), np.full(n, 300.0)]
    episodes = pd.DataFrame({
        **{"task": "intersection", "level": ["10"] * n + ["30"] * n, "traffic": "risky", "crashed": crashed},
        **{"crash_closing_speed": np.where(crashed, 12.0, np.nan), "distance": way, "return": 1.0},
        "mean_speed": [1.0, 3.0] * n,
    })  # fmt: skip
    both, light, dense = rows(episodes)
    assert (both["level"], light["level"], dense["level"]) == (ALL, "10", "30")
    assert light["crashed"] == light["hard_crash"] == pytest.approx([0.1, 0.0435, 0.2136], abs=1e-4)  # Wilson
    assert light["mean_speed"] == pytest.approx([2.0, 1.713, 2.287], abs=1e-3)  # Student: 2.0096 x .1429
    ratios = [light["crashes_per_100_km"][0], dense["crashes_per_100_km"][0]]
    assert ratios == pytest.approx([100.0, 100 / 3], rel=1e-4) and both["entered"][0] == 1.0
    assert both["crashes_per_100_km"][0] == pytest.approx(np.mean(ratios), rel=1e-4)  # levels alike
    *_, none = rows(episodes.assign(crashed=False))
    assert none["crashes_per_100_km"][:2] == [0.0, 0.0]
    assert none["crashes_per_100_km"][2] == pytest.approx(1e5 / 300 * none["crashed"][2], rel=1e-4)
