"""Which settings have control agents that can drive, on made-up results with made-up marks."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from experiments.analysis.competence import competence, competent
from experiments.study.design import attainable
from experiments.study.results.loaded import Results, load
from tests.experiments import synthetic

LEVELS = {"highway": (1,), "two-way": (1,)}
MADE_UP = {"levels": LEVELS, "seeds": 2, "baselines": (), "features": ("tcpa",)}


def driver(kind: str, value: float, crashed: float = 0.1) -> dict[str, Any]:
    return {"kind": kind, "return": value, "crashed": crashed}


@pytest.mark.parametrize(
    ("marks", "failed"),
    [
        ({}, ""),
        ({"careful": ("policy", 0.1)}, "return"),
        ({"planner": ("policy", 0.1)}, ""),  # is no rule
        ({"sumo": ("more actions", 0.1)}, ""),  # brakes as no agent can
        ({"sumo": ("policy", 0.1)}, "return"),
        ({"IDLE": ("constant", 0.1), "planner": ("policy", 0.2)}, "return score"),
        ({"planner": ("policy", 5.0)}, "score"),
        ({"idm": ("policy", -1.0, 0.0)}, "crashed"),
        ({"idm": ("more actions", -1.0, 0.0)}, ""),
    ],
)
def test_what_a_setting_lacks(results: Results, marks: Mapping[str, Any], failed: str, monkeypatch) -> None:
    """Marks are given by how much more they return than the control agents do, who crash in about a quarter."""
    own = results.gate_episodes
    control = own[(own["arm"] == "control") & (own["task"] == "highway") & (own["traffic"] == "regular")]
    got = control["return"].mean()
    known = {"SLOWER": driver("constant", got - 5), "best-s300": driver("policy", got)}
    known |= {name: driver(kind, got + more, *rest) for name, (kind, more, *rest) in marks.items()}
    monkeypatch.setattr(attainable, "stored", lambda: {"highway 50 regular": {"drivers": known}})
    found = competence(results.cells, own)
    [row] = found.to_dict("records")  # the two-way road has no marks
    assert row["failed"] == failed and competent(found) == ((("highway", "50"),) if not failed else ())
    assert (row["agents"], row["return"]) == (2, pytest.approx(got))
    low, high = (
        max(one["return"] for one in known.values() if one["kind"] == kind) for kind in ("constant", "policy")
    )
    assert row["score"] == pytest.approx((got - low) / (high - low))
    assert row["unfair"] == any(one["kind"] == "more actions" for one in known.values())


def test_what_is_configured_otherwise_is_not_judged(tmp_path: Path, monkeypatch) -> None:
    synthetic.write(tmp_path, {"highway": (1,)}, seeds=2, baselines=(), config=("collision_reward=-2",))
    results = load(tmp_path)
    known = {"SLOWER": driver("constant", 0.0), "idm": driver("policy", 1.0)}
    monkeypatch.setattr(attainable, "stored", lambda: {"highway 50 regular": {"drivers": known}})
    assert competence(results.cells, results.gate_episodes).empty
