"""Plan 6 on made-up agents whose truth is known: the ten effects, its stages, and what it asks of the learner."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments.analysis.analysis import Analysis, analyse
from experiments.analysis.claims import primary
from experiments.analysis.effects import contrasts, means
from experiments.analysis.gates import change, last_second
from experiments.analysis.plan import (
    BRAKES,
    DEFAULT,
    DENSEST,
    LIGHTEST,
    STUDY,
    UNDRIVABLE,
    Learner,
    plan_of,
    reached,
)
from experiments.analysis.scores import Arms, Setting
from experiments.reporting import by_task
from experiments.study.design import attainable
from experiments.study.design.presets import SETTINGS
from experiments.study.design.sheet import GRID, task_of
from experiments.study.results.loaded import load
from tests.experiments import synthetic
from tests.experiments.analysis.made_up import PAIR, crashes

ENDS = (*LIGHTEST, *DENSEST)
CRASHES = [("crashed", "risky"), ("crashed", "regular")]
# Of training on the crash rate in risky and regular traffic, by task.
Effects = dict[str, tuple[float, float]]


class TestPlan:
    def test_follows_the_preset(self) -> None:
        assert [plan_of([name]) for name in ("study", "quick")] == [STUDY, DEFAULT]

    def test_a_stage_is_reached_when_every_agent_of_it_is_there(self) -> None:
        """Whatever is there of the next one."""

        def agents(places: Any, seeds: int = 5) -> pd.DataFrame:
            rows = [(*place, arm, 800 + k) for place in places for arm in PAIR for k in range(seeds)]
            return pd.DataFrame(rows, columns=["task", "level_name", "arm", "seed"])

        light = (*LIGHTEST, BRAKES)
        assert reached(STUDY, agents(LIGHTEST)) == ("", STUDY)
        assert reached(STUDY, agents(light)[:-1]) == ("", STUDY)
        assert reached(STUDY, agents(light, seeds=4)) == ("", STUDY)
        everywhere = agents((*STUDY.settings, BRAKES))
        for there, stage, places in (
            (agents(light), "a", LIGHTEST),
            (agents((*light, *DENSEST)), "b", ENDS),
            (everywhere[everywhere["seed"] + (everywhere["level_name"] == "20") < 805], "b", ENDS),
            (everywhere, "c", STUDY.settings),
        ):
            name, counted = reached(STUDY, there)
            assert (name, {*counted.settings}) == (stage, {*places})

    def test_asks_about_what_can_be_driven_and_is_computed_by_its_preset(self) -> None:
        assert [f"{task} {name}" for task, name in (UNDRIVABLE,)] == attainable.undrivable(
            attainable.stored()
        )
        asked = {
            (task, GRID[task_of(task)][level - 1]) for task, levels in SETTINGS.items() for level in levels
        }
        assert asked == {*STUDY.settings, BRAKES} == {*STUDY.stages["c"]} and len(asked) == 18


def study(effects: Effects, random: np.random.Generator, repeat: str = "sumo") -> dict[Setting, Arms]:
    """The settings of stage b: five agents an arm."""
    places: dict[Setting, Arms] = {}
    for task, name in ENDS:
        risky, regular = effects.get(task, (0.0, 0.0))
        rates = {"treatment": (0.3 + regular, 0.5 + risky), "control": (0.3, 0.5)}
        places[repeat, task, GRID[task].index(name) + 1, name] = crashes(rates, random, 0.03)
    return places


def ten(places: dict[Setting, Arms]) -> pd.DataFrame:
    return primary(means(contrasts(places, {PAIR: CRASHES})), STUDY)


class TestPrimary:
    def test_what_was_planted_is_found_task_by_task(self) -> None:
        planted = {"u-turn": (-0.3, 0.0), "two-way": (-0.2, 0.3), "highway": (0.0, 0.0)}
        found = ten(study(planted, np.random.default_rng(1))).set_index(["scope", "term"])
        assert len(found) == 10 and set(found["settings"]) == {1, 2}
        assert found["verdict"].to_dict() == dict.fromkeys(found.index, "open") | {
            ("u-turn", "risky"): "less",
            ("two-way", "risky"): "less",
            ("two-way", "regular"): "more",
        }
        assert found.loc[("u-turn", "risky"), "estimate"] == pytest.approx(-0.3, abs=0.05)

    def test_holm_is_over_all_ten(self) -> None:
        found = ten(study({"u-turn": (-0.1, 0.0)}, np.random.default_rng(2))).sort_values("p")
        expected = (found["p"] * np.arange(10, 0, -1)).cummax().clip(upper=1.0)
        assert found["p_adjusted"].tolist() == pytest.approx(expected.tolist())
        # of two below .05 one stays
        assert (found["p"] < 0.05).sum() == 2 and found["verdict"].tolist() == ["less"] + ["open"] * 9


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

    def test_crashes_of_the_last_second_are_held_against_those_before(self) -> None:
        random, hazard, rise, seconds = np.random.default_rng(2), 0.02, 4.0, 10.0
        agents, drives = 15, 400
        first = random.exponential(1 / hazard, (agents, drives))
        last = seconds - 1 + random.exponential(1 / (rise * hazard), (agents, drives))
        time = np.where(first < seconds - 1, first, last).ravel()
        table = pd.DataFrame({"crash_free_time": time.clip(max=seconds), "crashed": (time < seconds) * 1.0})
        found = last_second(table.assign(seconds=seconds, cell=np.repeat(range(agents), drives)), 4.0)
        assert 1 < found.low < rise < found.high

    def test_a_crash_in_the_last_step_is_one_of_the_last_second(self) -> None:
        """3.5 crashes in 2.5 s driven against 1.5 in 15 s, with half a crash added to both."""
        times = pd.DataFrame({"cell": [0, 0, 1, 1], "crash_free_time": [9.5, 10.0, 10.0, 8.0]})
        assert last_second(times.assign(seconds=10.0, crashed=1.0), 4.0).estimate == pytest.approx(14.0)

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


STAGED = {"u-turn": (1, 2), "highway": (1,)}


@pytest.mark.parametrize(
    ("there", "settings"),
    [
        (lambda cell: cell.arm in (None, "control"), set()),  # its first arm is computed
        (lambda cell: cell.level == 1 or cell.arm in (None, "control"), {"3"}),
        (lambda cell: cell.kind == "baseline", set()),
    ],
)
def test_a_study_is_reported_while_it_runs(there: Any, settings: set[str], tmp_path: Any) -> None:
    asked: dict[str, Any] = {"seeds": 2, "tests": 6, "preset": "small", "baselines": ("careful",)}
    for cell in synthetic.write(tmp_path, {"u-turn": (1, 2)}, **asked):
        if not there(cell):
            (tmp_path / "cells" / f"{cell.name}.parquet").unlink()
    found = analyse(load(tmp_path))
    assert set(found.effects["level_name"]) == settings and found.notes["stage"] == ""
    assert set(found.notes["unfinished"]) == {f"sumo-u-turn-{name}" for name in {"3", "6"} - settings}
    assert set(found.policies.loc[found.policies["arm"] == "", "level_name"]) == {"3", "6"}


class TestStages:
    """A folder whose first stage is complete; of the second an agent is lost."""

    @pytest.fixture(scope="class")
    @classmethod
    def home(cls, tmp_path_factory: pytest.TempPathFactory) -> Path:
        home = tmp_path_factory.mktemp("stages")
        cells = synthetic.write(home, STAGED, seeds=2, tests=100, effect=-0.4, spread=0.0, preset="small")
        [lost] = [cell.name for cell in cells if cell.slug == "sumo-u-turn-6-treatment-s1"]
        (home / "cells" / f"{lost}.parquet").write_bytes(b"")
        return home

    @pytest.fixture(scope="class")
    @classmethod
    def analysis(cls, home: Path) -> Analysis:
        return analyse(load(home))

    def test_what_is_not_complete_is_named_and_not_counted(self, analysis: Analysis) -> None:
        assert analysis.notes["unfinished"] == {"sumo-u-turn-6": "1 of 4 agents are missing"}
        assert analysis.notes["stage"] == "a"
        assert set(analysis.effects["level_name"]) == {"50", "3"} and len(analysis.gates) == 2 * 2 * 2
        assert set(analysis.primary["settings"]) == {1}

    def test_the_primary_answer_is_what_was_planted_and_stands_first(self, analysis: Analysis) -> None:
        found = analysis.primary.set_index(["scope", "term"])["verdict"]
        assert {*found[:, "risky"]} == {"less"} and {*found[:, "regular"]} == {"open"}
        sides = by_task.sides(analysis, "sumo", "crashed", ("sumo", "risky"))
        assert sides == {"less": ["highway", "u-turn"], "more": [], "open": []}

    def test_the_learner_is_checked(self, analysis: Analysis) -> None:
        found = analysis.learner.groupby("check")["agents"].agg(list).to_dict()
        assert found == {"change": [4, 4], "diverged": [8], "gates": [8], "last second": [2, 2]}
        assert analysis.learner.set_index("check").loc["diverged", "passed"] is True
