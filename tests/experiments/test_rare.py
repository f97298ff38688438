"""The command that asks how often a policy crashes where events are rare."""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pandas as pd
import pytest
from matplotlib.axes import Axes

from experiments import rare
from experiments.reporting.figures import COLOURS
from experiments.reporting.rare import ROADS, rare_figure
from experiments.study.compute.rare import Batch
from experiments.support.errors import UserError
from experiments.support.files import read_json
from sumo_env.tasks import TASKS

OPTIONS = rare.Options(("slower",), "u-turn", rates="0.3,1", dose=0.3, episodes=80)


@pytest.fixture(autouse=True)
def few(here: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rare, "BATCH", 40)
    monkeypatch.setattr(rare, "PILOT", 20)


def stored(directory: Path) -> dict[str, Any]:
    """What is written of each policy."""
    return read_json(directory / "curve.json")["policies"]


@pytest.mark.slow
def test_curves_are_written_and_the_command_goes_on_where_it_was_stopped(tmp_path: Path, capsys) -> None:
    options = replace(OPTIONS, out=tmp_path)
    assert rare.rare(options, ["slower"]) == 0
    said, files = capsys.readouterr().out, {path: path.stat() for path in (tmp_path / "episodes").iterdir()}
    found = stored(tmp_path)["slower"]
    assert found["episodes"] >= 80 and [row["rate"] for row in found["curve"]] == [0.3, 1.0]
    assert found["curve"][1]["events_per_hour"] == pytest.approx(1080.0)  # the u-turn's 0.3 events a second
    assert pd.read_csv(tmp_path / "curve.csv")["claim"].tolist() == [row["claim"] for row in found["curve"]]
    assert "<svg" in (tmp_path / "curve.svg").read_text() and "crashes without an event" in said
    driven = pd.concat(pd.read_parquet(path) for path in files)
    for events, rate in (("near", "level"), ("other", "base")):  # as many as are expected, but for chance
        expected = (driven[rate] * driven[f"{events}_expected"]).sum()
        assert abs(driven[events].sum() - expected) < 4 * expected**0.5 < expected
    next(iter(files)).write_bytes(b"damaged")
    assert rare.rare(options, ["slower"]) == 0
    assert stored(tmp_path)["slower"]["curve"] == found["curve"]
    again = {path: path.stat() for path in (tmp_path / "episodes").iterdir()}
    assert again.keys() == files.keys() and sum(again[path] != files[path] for path in files) == 1
    both = replace(options, policies=("slower", "idle"), plain=True, rates="1", episodes=40)
    assert rare.rare(both, ["slower", "idle"]) == 0
    counted = stored(tmp_path)
    assert pd.read_csv(tmp_path / "curve.csv")["policy"].tolist() == [*counted] == ["slower", "idle"]
    for one in counted.values():
        assert one["levels"] == [] and one["curve"][0]["effective_episodes"] == pytest.approx(40.0)
    slower, idle = (one["curve"][0]["crashes_per_episode"] for one in counted.values())
    assert slower < idle  # each has episodes of its own


def test_rates_are_two_in_each_decade_or_those_that_are_named() -> None:
    assert rare.rates_of("1e-2:1") == (0.01, 0.0316, 0.1, 0.316, 1.0)
    assert rare.rates_of("0.5,0.1") == (0.1, 0.5)


MAKE = """
from pathlib import Path

class Policy:
    def act(self, observation):
        return ACTION

ACTION = int((Path(__file__).parent / "weights.txt").read_text())

def make(env):
    return Policy()
"""


def test_a_batch_is_driven_by_what_it_was_named_by(tmp_path: Path) -> None:
    """Other weights behind the same code are another policy, and none that a process drives unnoticed."""
    (tmp_path / "mine.py").write_text(MAKE)
    names, seen = set(), []
    for action in ("1", "4"):
        (tmp_path / "weights.txt").write_text(action)
        asked = pickle.loads(pickle.dumps(rare.question(OPTIONS, f"{tmp_path}/mine.py:make")))
        batch = Batch(tmp_path, asked, "curve", ((1.0, 1.0),), 3, 0)
        names.add(batch.name)
        batch.compute(lambda _: None)
        seen.append(batch.read()["steps"].tolist())
    assert len(names) == 2 and seen[0] != seen[1]
    (tmp_path / "weights.txt").write_text("1")
    with pytest.raises(UserError, match="has changed since"):
        batch.compute(lambda _: None)
    published = [rare.question(OPTIONS, f"u-turn-3/{arm}").key["digest"] for arm in ("control", "treatment")]
    assert len({*published, rare.question(OPTIONS, "u-turn-3/control").key["digest"]}) == 2


def test_a_simulator_that_has_changed_is_named_before_anything_is_driven(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.undo()
    rates = TASKS["u-turn"].risk_rates
    monkeypatch.setattr(type(TASKS["u-turn"]), "risk_rates", type(rates)(brake=1.0))
    with pytest.raises(UserError, match="task u-turn on the backend sumo does not behave"):
        rare.rare(replace(OPTIONS, out=tmp_path / "new"), [])
    assert not (tmp_path / "new").exists()


def test_the_figure_has_a_curve_and_a_colour_for_each_policy_and_rates_of_roads() -> None:
    parts = ("crashes_per_episode", "by_events_per_episode", "without_per_episode")
    values = {f"{part}{end}": 0.1 for part in parts for end in ("", "_low", "_high")}
    curve = pd.DataFrame([{"events_per_hour": hours, "claim": "all", **values} for hours in (1.0, 10.0)])
    drawn = rare_figure({"mine": curve, "yours": curve.assign(claim="nothing")}, "u-turn 3")
    assert all(name in drawn for name in ("mine", "yours", "u-turn 3", *ROADS))
    policies = ["careful", "u-turn-3/treatment", "u-turn-12/treatment", "control"]
    with patch.object(Axes, "fill_between") as calls:
        rare_figure(dict.fromkeys(policies, curve), "u-turn 3")
    careful, *arms, control = (call.kwargs["color"] for call in calls.call_args_list[::2])
    assert (arms[0], control) == (COLOURS["treatment"], COLOURS["control"])
    assert len({careful, *arms, control}) == len(policies)
