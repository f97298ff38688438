"""A plan that asks for the gain without the price, on made-up agents whose truth is known."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments.analysis.analysis import Analysis, analyse
from experiments.analysis.claims import all_hold, price
from experiments.analysis.effects import contrasts
from experiments.analysis.gates import change, last_second
from experiments.analysis.plan import DEFAULT, Learner, plan_of
from experiments.analysis.scores import Arms, Setting
from experiments.study.design.sheet import SHEETS
from experiments.study.results.store import load
from experiments.support.errors import UserError
from sumo_env.tasks import TASKS
from tests.experiments import synthetic
from tests.experiments.analysis.plans import MIXED

PAIRS = [("treatment", "control"), ("mixed", "control"), ("mixed", "treatment")]
CRASHES = [("crashed", "risky"), ("crashed", "regular")]
CONTROL, TREATMENT = (0.25, 0.50), (0.30, 0.30)  # crash rates in regular and in risky traffic
MARGINS = {"risky": 0.05, "regular": 0.025}


def study(
    mixed: tuple[float, float],
    random: np.random.Generator,
    tasks: tuple[str, ...] = tuple(TASKS),
    scenarios: int = 400,
    hopeless: float = 0.0,
) -> dict[Setting, Arms]:
    """All settings of some tasks: five agents an arm, of mixed training with these crash rates (regular, risky).

    hopeless: added to the rate of mixed training where nobody survives.
    """
    places: dict[Setting, Arms] = {}
    for task in tasks:
        for level, name in enumerate(TASKS[task].levels, start=1):
            luck = random.uniform(size=(2, 1, scenarios))
            arms = {}
            for arm, rates in {"control": CONTROL, "treatment": TREATMENT, "mixed": mixed}.items():
                more = hopeless if arm == "mixed" and (task, name) in HOPELESS else 0.0
                rate = np.array(rates)[:, None, None] + more + random.normal(0, 0.01, (2, 5, 1))
                own = random.uniform(size=(2, 5, scenarios))  # half of the luck is the scenario's
                crashed = np.where(random.uniform(size=own.shape) < 0.5, luck, own) < rate
                arms[arm] = {"crashed": crashed.astype(float)}
            places["sumo", task, level, name] = arms
    return places


HOPELESS = [("two-way", "10+4"), ("two-way", "15+6")]


def judged(places: dict[Setting, Arms]) -> pd.DataFrame:
    return price(contrasts(places, dict.fromkeys(PAIRS, CRASHES)), MIXED)


class TestPlan:
    def test_follows_the_preset(self) -> None:
        assert [plan_of([name]) for name in ("of mixed training", "quick")] == [MIXED, DEFAULT]

    def test_its_ranges_are_the_sheets(self) -> None:
        assert Learner().ranges == {task: own.return_range for task, own in SHEETS.items()}


class TestGainWithoutPrice:
    @pytest.mark.parametrize(
        ("mixed", "verdict"),
        [
            ((0.25, 0.30), "holds"),  # all of the gain and no price
            ((0.20, 0.25), "holds"),
            ((0.35, 0.30), "contradicted"),  # all of the gain, at a price
            ((0.25, 0.45), "contradicted"),  # no price, little of the gain
            ((0.275, 0.30), "not decided"),  # the price is the margin
        ],
    )
    def test_is_what_was_planted(self, mixed: tuple[float, float], verdict: str) -> None:
        found = judged(study(mixed, np.random.default_rng(3)))
        over_all = found[found["scope"] == "all tasks"]
        assert all_hold(list(over_all["verdict"])) == verdict
        assert list(over_all["settings"]) == [16, 16]
        assert len(found) == 2 * (1 + len(TASKS))
        truth = {"risky": mixed[1] - TREATMENT[1], "regular": mixed[0] - CONTROL[0]}
        assert over_all.set_index("term")["margin"].to_dict() == MARGINS
        assert over_all.set_index("term")["estimate"].to_dict() == pytest.approx(truth, abs=0.015)

    def test_is_asked_where_one_can_survive(self) -> None:
        """Whatever happens in the two densest settings of the two-way road."""
        found = [judged(study((0.25, 0.30), np.random.default_rng(3), hopeless=more)) for more in (0.0, 0.4)]
        pd.testing.assert_frame_equal(*found)

    def test_is_claimed_in_one_of_twenty_studies_at_the_margin(self) -> None:
        """And the margin, which is the truth, lies between the limits in nine of ten."""
        random, repeats = np.random.default_rng(5), 200
        rates = (CONTROL[0] + MARGINS["regular"], TREATMENT[1] + MARGINS["risky"])
        places = {
            (str(k), *place[1:]): arms
            for k in range(repeats)
            for place, arms in study(rates, random, ("u-turn",), scenarios=100).items()
        }
        found = judged(places).query("scope == 'all tasks'")
        held = found["verdict"].eq("holds").groupby(found["term"]).sum()
        assert 0 < held.max() < repeats * 0.05 + 4 * np.sqrt(repeats * 0.05 * 0.95)
        covered = found.eval("low < margin < high").sum()
        assert covered >= stats.binom.ppf(1e-4, 2 * repeats, 0.9)

    def test_both_are_needed(self) -> None:
        assert all_hold(["holds", "not decided"]) == all_hold([]) == "not decided"
        assert all_hold(["not decided", "contradicted"]) == "contradicted"


def trained(task: str, level: int, returns: Any) -> dict[str, Any]:
    return {"key": {"task": task, "level": level}, "learner": {"curve": {"return": list(returns)}}}


class TestLearner:
    def test_the_last_tenth_is_held_against_the_one_before_three_quarters(self) -> None:
        """Agents that gain a tenth or three of the range between the two, whatever the other parts are."""
        random, agents = np.random.default_rng(1), []
        for task, change_ in (("highway", 0.1), ("u-turn", 0.3)):
            size = Learner().ranges[task]
            for level in (1, 2):
                for _ in range(5):
                    curve = random.normal(0, 5, 20)
                    curve[13:15] = random.normal(0, 0.001 * size, 2)
                    curve[18:] = change_ * size + random.normal(0, 0.001 * size, 2)
                    agents.append(trained(task, level, curve))
        agents.append(trained("u-turn", 2, [*[None] * 13, 1.0, None, *[None] * 3, 4.0, None]))
        found = change(agents, Learner())
        assert found.estimate == pytest.approx(0.2, abs=0.002)
        assert found.low < 0.2 < found.high < 0.21

    @pytest.mark.parametrize("rise", [1.0, 4.0])
    def test_crashes_of_the_last_second_are_held_against_those_before(self, rise: float) -> None:
        random, hazard, seconds = np.random.default_rng(2), 0.02, 10.0
        agents, drives = 15, 400
        first = random.exponential(1 / hazard, (agents, drives))
        last = seconds - 1 + random.exponential(1 / (rise * hazard), (agents, drives))
        time = np.where(first < seconds - 1, first, last).ravel()
        table = pd.DataFrame({"crash_free_time": time.clip(max=seconds), "crashed": (time < seconds) * 1.0})
        found = last_second(table.assign(seconds=seconds, cell=np.repeat(range(agents), drives)), 4.0)
        assert found.low < rise < found.high
        assert (found.low <= 1) == (rise == 1)

    def test_a_constant_rate_of_crashes_is_found_to_be_one(self) -> None:
        """Also where crashes are few."""
        random, inside, repeats = np.random.default_rng(3), 0, 300
        for hazard in (0.001, 0.02):
            for _ in range(repeats // 2):
                time = random.exponential(1 / hazard, 1500)
                table = pd.DataFrame({"crash_free_time": time.clip(max=10.0), "crashed": (time < 10.0) * 1.0})
                found = last_second(table.assign(seconds=10.0, cell=np.repeat(range(15), 100)), 4.0)
                inside += found.low <= 1 <= found.high
        assert inside >= stats.binom.ppf(1e-4, repeats, 0.95)


@pytest.mark.parametrize(
    ("there", "settings"),
    [
        (lambda cell: cell.arm in (None, "control"), set()),  # its first arm is computed
        (lambda cell: cell.level == 1 or cell.arm in (None, "control"), {"3"}),
        (lambda cell: cell.kind == "baseline", set()),
    ],
)
def test_a_study_is_reported_while_it_runs(there: Any, settings: set[str], tmp_path: Any) -> None:
    written = synthetic.write(
        tmp_path, {"u-turn": (1, 2)}, seeds=2, tests=6, further=("mixed",), preset="of mixed training"
    )
    for cell in written:
        if not there(cell):
            (tmp_path / "cells" / f"{cell.name}.parquet").unlink()
    found = analyse(load(tmp_path))
    assert set(found.effects["level_name"]) == settings
    assert set(found.notes["unfinished"]) == {f"sumo-u-turn-{name}" for name in {"3", "6"} - settings}
    assert set(found.policies.loc[found.policies["arm"] == "", "level_name"]) == {"3", "6"}


def test_before_any_setting_is_complete_the_command_says_so(tmp_path: Any) -> None:
    written = synthetic.write(
        tmp_path, {"u-turn": (1,)}, seeds=2, tests=6, baselines=(), preset="of mixed training"
    )
    (tmp_path / "cells" / f"{written[0].name}.parquet").unlink()
    with pytest.raises(UserError, match="no setting is complete yet"):
        analyse(load(tmp_path))


def test_without_mixed_training_its_price_is_open(tmp_path: Any) -> None:
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=6, preset="of mixed training")
    found = analyse(load(tmp_path))
    assert found.price.empty
    assert set(found.effects["family"].dropna()) == {"benefits", "harms", "paper", ""}


class TestStudy:
    """A folder of the preset, in which one setting is not complete and others have not begun."""

    @pytest.fixture(scope="class")
    def home(self, tmp_path_factory: pytest.TempPathFactory) -> Any:
        home = tmp_path_factory.mktemp("mixed")
        cells = synthetic.write(
            home,
            {"highway": (1,), "u-turn": (1, 2)},
            tests=10,
            further=("mixed",),
            preset="of mixed training",
        )
        [lost] = [cell.name for cell in cells if cell.slug == "sumo-u-turn-6-mixed-s2"]
        (home / "cells" / f"{lost}.parquet").write_bytes(b"")
        return home

    @pytest.fixture(scope="class")
    def analysis(self, home: Any) -> Analysis:
        return analyse(load(home))

    def test_what_is_not_complete_is_named_and_not_counted(self, analysis: Analysis) -> None:
        assert analysis.notes["unfinished"] == {"sumo-u-turn-6": "1 of 9 agents are missing"}
        assert set(analysis.effects["level_name"]) == {"50", "3"}
        assert len(analysis.gates) == 2 * 3 * 3

    def test_mixed_training_is_planned_and_stands_there_once(self, analysis: Analysis) -> None:
        assert analysis.plan["version"] == 3
        key = ["arm", "against", "task", "level", "outcome", "term", "tested_on", "scenarios"]
        assert not analysis.effects.duplicated(key).any()
        rows = analysis.effects.dropna(subset="family").query("family not in ('', 'paper')")
        assert {(r.family, r.arm, r.outcome, r.term) for r in rows.itertuples()} == {
            ("benefits", "treatment", "crashed", "risky"),
            ("harms", "treatment", "crashed", "regular"),
            ("benefits of mixed training", "mixed", "crashed", "risky"),
            ("harms of mixed training", "mixed", "crashed", "regular"),
        }
        assert set(analysis.claims["expected"]) == {5, 18}

    def test_the_learner_is_checked(self, analysis: Analysis) -> None:
        found = analysis.learner.groupby("check")["agents"].agg(list).to_dict()
        assert found == {"change": [6, 6, 6], "diverged": [18], "gates": [18], "last second": [3, 3, 3]}
        assert analysis.learner.set_index("check").loc["diverged", "passed"] is True

    def test_its_report_answers(self, home: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        from experiments import report

        monkeypatch.setattr("experiments.reporting.page.drawn", lambda *_: defaultdict(lambda: None))
        page = report.write_report(home).read_text()
        question = "keep the gain without the price?"
        assert question in page and question in report.answer(home)
        assert "sumo-u-turn-6 is not complete" in page and "6, 9 and 12" in report.answer(home)
