"""Verdicts on claims from effects that are made up."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.analysis.claims import claims
from experiments.analysis.effects import slopes
from experiments.analysis.scores import Arms, Setting
from sumo_env.tasks import TASKS
from tests.experiments.analysis.made_up import agents, effects, find
from tests.tasks import PUBLISHED


def made_up(**columns: Any) -> pd.DataFrame:
    """Rows of effects with what claims are made of."""
    usual = {
        "backend": "sumo",
        "task": "highway",
        "level_name": "50",
        "status": "ok",
        "se": 0.01,
        "df": 8.0,
        "detectable": 0.3,
    }
    rows = pd.DataFrame(columns)
    return rows.assign(**{name: value for name, value in usual.items() if name not in columns})


class TestClaims:
    @staticmethod
    def decide(*values: tuple[float, float], status: str = "ok", expected: int = 18) -> dict[str, Any]:
        """The verdict on "the return rises" from estimates and p-values, in so many of 18 settings."""
        p = np.array([p for _, p in values])
        rows = made_up(outcome="return", term="sum", status=status, estimate=[e for e, _ in values], p=p)
        rows["p_adjusted"] = (p * len(p)).clip(max=1)
        return find(claims(rows, slopes({})), name="return rises")

    def test_holds_if_each_does_by_itself(self) -> None:
        """Everywhere at once is the harder claim: it needs no adjustment for the number of places."""
        assert self.decide(*[(1, 0.04)] * 18)["verdict"] == "holds"
        assert self.decide(*[(1, 0.01)] * 17, (2, 0.06))["verdict"] == "not decided"

    def test_contradicted_only_after_adjustment(self) -> None:
        assert self.decide(*[(1, 0.001)] * 17, (-2, 0.04))["verdict"] == "not decided"
        found = self.decide(*[(1, 0.001)] * 17, (-2, 0.001))
        assert (found["verdict"], found["right"], found["wrong"]) == ("contradicted", 17, 1)

    def test_places_that_were_not_run_keep_it_open(self) -> None:
        found = self.decide((1, 0.001), (2, 0.001))
        assert (found["verdict"], found["right"], found["not_run"]) == ("not decided", 2, 16)

    @pytest.mark.parametrize("status", ["degenerate", "one seed", "no information"])
    def test_what_is_no_evidence_counts_neither_way(self, status: str) -> None:
        found = self.decide((-2, 0.001), status=status)
        assert (found["verdict"], found["wrong"], found["silent"]) == ("not decided", 0, 1)

    @pytest.mark.parametrize(
        ("estimate", "verdict"), [(0.001, "holds"), (0.05, "not decided"), (0.2, "contradicted")]
    )
    def test_little_harm_is_an_equivalence(self, estimate: float, verdict: str) -> None:
        rows = made_up(outcome="crashed", term="regular", estimate=[estimate] * 18, p=0.01, p_adjusted=0.01)
        assert find(claims(rows, slopes({})), name="little harm")["verdict"] == verdict

    def test_signs_are_those_of_the_claims(self) -> None:
        """An effect that raises return and crash rate, both of which rise with traffic."""
        arms: dict[Setting, Arms] = {}
        for task in PUBLISHED:
            definition = TASKS[task]
            own = agents(
                len(definition.levels), 8, np.random.default_rng(6), effect=3.0, spread=0.1, task=task
            )
            for (_, _, level, _), pair in own.items():
                for arm in pair.values():
                    for name in ("return", "crashed"):
                        arm[name][...] += level
            arms |= own
        found = claims(effects(arms), slopes(arms)).set_index("name")["verdict"]
        assert found["return rises"] == "holds"
        assert found["return falls with traffic"] == "contradicted"
        assert found["fewer crashes"] == "contradicted"
        assert found["crashes rise with traffic"] == "holds"
        assert found["little harm"] == "contradicted"
