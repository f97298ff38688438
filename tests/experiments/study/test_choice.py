"""The choice of the learner: its cells are nobody else's, and its score is what the plan says."""

from __future__ import annotations

import pandas as pd
import pytest

from experiments.study import choice
from experiments.study.arms import scenario_seed


def test_variants_differ_as_planned_and_keep_the_target_s_speed() -> None:
    cells = [cell for _, cell in choice.cells()]
    assert len(cells) == len({cell.name for cell in cells}) == 54
    for cell in cells:
        profile = cell.profile
        steps = choice.STEPS[cell.task]
        assert profile["updates"] * profile["steps_per_update"] == steps
        assert profile["tau"] * profile["updates"] == pytest.approx(0.005 * steps / 4)
        assert cell.training_config.get("duration") == (13 if cell.task == "u-turn" else 15)
    order = [(cell.seed, choice.TASKS.index(cell.task)) for cell in cells]
    assert order == sorted(order)


def test_scenarios_are_not_those_of_tests_and_gates() -> None:
    def block(purpose: str) -> set[int]:
        return {scenario_seed(task, 1, k, purpose) for task in choice.TASKS for k in range(1000)}

    assert not block(choice.PURPOSE) & (block("test") | block("gate"))


def test_the_score_is_the_mean_of_the_arms_returns_in_units_of_the_range() -> None:
    rows = [
        {"task": "u-turn", "variant": variant, "arm": arm, "seed": seed, "share": share, "return": value}
        for variant, returns in {"a": (8.0, 6.0), "b": (9.0, 3.0)}.items()
        for arm, end in zip(("control", "treatment"), returns, strict=True)
        for seed in (900, 901)
        for share, value in ((choice.MARK, end - 0.5), (1.0, end))
    ]
    result = choice.judge(pd.DataFrame(rows))
    assert result["score"].to_dict() == {
        ("u-turn", "a"): pytest.approx(0.7),
        ("u-turn", "b"): pytest.approx(0.6),
    }
    assert result.loc[("u-turn", "a"), "return_treatment"] == pytest.approx(0.6)
    assert result["change_control"].tolist() == pytest.approx([0.05, 0.05])
    assert result["seeds"].tolist() == [2, 2]
    half = choice.judge(
        pd.DataFrame([row for row in rows if (row["variant"], row["arm"]) != ("a", "control")])
    )
    assert pd.isna(half.loc[("u-turn", "a"), "score"])  # not the mean of one arm
    assert half.loc[("u-turn", "a"), "seeds"] == 0
