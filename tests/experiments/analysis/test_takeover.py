"""Caution and skill: against numbers by hand, and against a known truth."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments.analysis import takeover as analysis
from experiments.study.compute.takeover import COLUMNS, PAIR

NAMES = ("control", "treated")
Rates = Callable[[np.random.Generator], dict[str, float]]  # of an agent: danger, and crashes from the moments


def row(
    pair: int, leader: str, scenario: int, a: float = np.nan, b: float = np.nan, **more: Any
) -> dict[str, Any]:
    """Of the record; a, b: times of the crashes from the moment, NaN without one."""
    moment = 2.0 if a == a else np.nan
    known = {
        "pair": pair,
        "leader": leader,
        "scenario": scenario,
        "crash_a": a,
        "crash_b": b,
        "moment": moment,
    }
    return {
        **dict.fromkeys(COLUMNS, np.nan),
        "sudden": False,
        "km": 0.1,
        "speed": 10.0 + scenario,
        **known,
        **more,
    }


INF = np.inf
BY_HAND = pd.DataFrame([
    row(0, "a", 0, 2.0, INF), row(0, "a", 1, 5.0, 6.0), row(0, "a", 2, sudden=True), row(0, "a", 3),
    row(1, "a", 0, INF, 3.0), row(1, "a", 1, 1.0, 1.0), row(1, "a", 2), row(1, "a", 3, 8.0, INF),
    row(0, "b", 0, 2.0, INF), row(0, "b", 1), row(0, "b", 2), row(0, "b", 3),
    row(1, "b", 0), row(1, "b", 1, 4.0, 4.0), row(1, "b", 2, 4.0, INF, km=0.5), row(1, "b", 3, sudden=True),
])  # fmt: skip


def test_answers_are_those_by_hand() -> None:
    found = analysis.answers(BY_HAND).set_index("question")
    table = found[["a", "b", "estimate", "count"]]
    assert table.loc["caution"].tolist() == pytest.approx([6 / 8, 4 / 8, -2 / 8, 8])
    assert table.loc["critical moments"].tolist() == pytest.approx([5 / 8, 3 / 8, -2 / 8, 8])
    assert table.loc["sudden crashes"].tolist() == pytest.approx([1 / 8, 1 / 8, 0.0, 8])
    assert table.loc["dangers per km"].tolist() == pytest.approx([6 / 0.8, 4 / 1.2, 4 / 1.2 - 6 / 0.8, 8])
    assert table.loc["skill, a leads"].tolist() == pytest.approx([3 / 5, 2 / 5, -1 / 5, 5])
    assert table.loc["skill, b leads"].tolist() == pytest.approx([3 / 3, 1 / 3, -2 / 3, 3])
    assert table.loc["skill"].tolist() == pytest.approx([0.8, 11 / 30, -13 / 30, 8])
    thirds = table[[" m/s" in question for question in table.index]]
    assert thirds["count"].sum() == 8 and thirds["count"].min() >= 2
    rates = analysis.rates(BY_HAND).set_index(["leader", "driver"])
    assert rates.loc[("a", "a"), ["moments", "crashed", "to_the_end"]].tolist() == [5, 3 / 5, 4 / 5]
    assert rates.loc[("a", "b"), ["moments", "crashed", "to_the_end"]].tolist() == [5, 2 / 5, 3 / 5]
    whole = analysis.overall(BY_HAND).set_index("driver")
    assert whole["danger"].tolist() == [6 / 8, 4 / 8] and whole["crashed"].tolist() == [6 / 8, 3 / 8]
    assert whole.loc["a", ["crashed_low", "crashed_high"]].tolist() == pytest.approx(
        [0.4093, 0.9285], abs=1e-4
    )
    own = analysis.own_crashes(BY_HAND).set_index("leader")
    assert own.loc["a"].tolist() == pytest.approx([5, 3 / 5, 1 / 5, 1 / 5])
    assert own.loc["b"].tolist() == pytest.approx([2, 1 / 2, 0, 1 / 2])


def drawn(
    rng: np.random.Generator, agents: Sequence[Rates], pairs: int = 5, scenarios: int = 60
) -> pd.DataFrame:
    """A record: a scenario is harder or easier for everybody; agents of an arm differ as `agents` draws them."""
    rows = []
    hard = rng.normal(size=(2, scenarios))
    for pair in range(pairs):
        both = dict(zip(PAIR, (draw(rng) for draw in agents), strict=True))
        for leader in PAIR:
            latent = 0.5 * hard[0] + 0.75**0.5 * rng.normal(size=scenarios)
            critical = latent < stats.norm.ppf(both[leader]["danger"])
            times = {}
            for name in PAIR:
                latent = 0.5 * hard[1] + 0.75**0.5 * rng.normal(size=scenarios)
                crashed = latent < stats.norm.ppf(both[name]["crash"])
                times[f"crash_{name}"] = np.where(critical, np.where(crashed, 2.0, INF), np.nan)
            moment = np.where(critical, 1.0, np.nan)
            fixed = {"pair": pair, "leader": leader, "sudden": False, "km": 0.1, "speed": 10.0}
            rows.append(pd.DataFrame({"scenario": range(scenarios), "moment": moment, **times, **fixed}))
    return pd.concat(rows, ignore_index=True)


def alike(rng: np.random.Generator) -> dict[str, float]:
    return {"danger": rng.uniform(0.5, 0.7), "crash": rng.uniform(0.45, 0.55)}


def two_optima(rng: np.random.Generator) -> dict[str, float]:
    """Half of the agents of the arm wait, half drive on."""
    return {"danger": 0.2, "crash": 0.3} if rng.random() < 0.5 else {"danger": 0.7, "crash": 0.5}


def test_the_standard_error_of_one_pair_is_that_of_a_ratio_of_means() -> None:
    rows = drawn(np.random.default_rng(1), (alike, alike), pairs=1, scenarios=150)
    found = analysis.answers(rows).set_index("question").loc["skill, a leads"]
    own = rows[rows["leader"] == "a"]
    m = own["moment"].notna().to_numpy(dtype=float)
    d = m * ((own["crash_b"] <= 5).to_numpy(dtype=float) - (own["crash_a"] <= 5))
    covariance, ratio = np.cov(d, m), d.mean() / m.mean()
    variance = covariance[0, 0] - 2 * ratio * covariance[0, 1] + ratio**2 * covariance[1, 1]
    assert found["se"] ** 2 == pytest.approx(variance / m.mean() ** 2 / 150)  # delta method
    assert (found["status"], found["df"]) == ("ok", 149)


def test_where_nobody_crashes_the_standard_error_is_that_of_one_crash_more_and_one_less() -> None:
    """Of each driver in the moments of each leader, of which the mean is taken."""
    rows = drawn(np.random.default_rng(1), (alike, alike))
    rows = rows.assign(**{name: rows[name].where(rows[name].isna(), INF) for name in ("crash_a", "crash_b")})
    moments = rows[rows["moment"].notna()].groupby("leader").size()
    share = 1 / (moments + 2)
    expected = (2 * share * (1 - share) / moments).sum() / 4
    assert analysis.answers(rows).set_index("question").loc["skill", "se"] ** 2 == pytest.approx(expected)


@pytest.mark.parametrize(
    ("treated", "caution", "by_leader"),
    [
        (alike, 0.0, (0.0, 0.0)),
        (two_optima, 0.45 - 0.6, (0.4 - 0.5, (0.1 * 0.3 + 0.35 * 0.5) / 0.45 - 0.5)),
    ],
)
@pytest.mark.slow
def test_intervals_cover_the_truth(treated: Rates, caution: float, by_leader: tuple[float, float]) -> None:
    rng = np.random.default_rng(7)
    truth = {"caution": caution, "skill": float(np.mean(by_leader))}
    covered, tries = dict.fromkeys(truth, 0), 100
    for _ in range(tries):
        found = analysis.answers(drawn(rng, (alike, treated))).set_index("question")
        for question, value in truth.items():
            covered[question] += found.loc[question, "low"] <= value <= found.loc[question, "high"]
    assert min(covered.values()) >= 88  # of 95 expected; below, the chance is 0.5 %


def test_too_few_moments_or_pairs_and_dangers_everywhere_claim_nothing() -> None:
    def status(rows: pd.DataFrame, question: str) -> tuple[str, float]:
        found = analysis.answers(rows).set_index("question").loc[question]
        return found["status"], found["p"]

    rows = drawn(np.random.default_rng(2), (alike, two_optima), scenarios=100)
    assert status(rows, "skill")[0] == "ok" and status(rows[rows["pair"] < 3], "skill") == ("too few", 1.0)
    moments_of_b = rows[(rows["leader"] == "b") & rows["moment"].notna()].index
    for left, expected in ((49, "too few"), (50, "ok")):
        spread = moments_of_b[np.linspace(0, len(moments_of_b) - 1, left).astype(int)]
        gone = moments_of_b.difference(spread)
        assert status(rows.assign(moment=rows["moment"].drop(gone)), "skill")[0] == expected
    from_three = rows.assign(moment=rows["moment"].where((rows["leader"] == "a") | (rows["pair"] < 3)))
    assert status(from_three, "skill") == ("too few", 1.0)
    nobody = rows.assign(moment=np.nan)
    assert status(nobody, "skill") == ("too few", 1.0) and status(nobody, "caution")[0] == "ok"
    always = rows.assign(moment=1.0)
    assert status(always, "caution") == ("no information", 1.0)
    always.loc[rows["leader"] == "a", "moment"] = np.where(np.arange(500) % 10 == 0, np.nan, 1.0)
    assert status(always, "caution")[0] == "ok"  # 90 % of one driver's
    only_a = rows[rows["leader"] == "a"]  # b only takes over
    assert "caution" not in set(analysis.answers(only_a)["question"]) and status(only_a, "skill")[0] == "ok"


@pytest.mark.parametrize(
    ("caution", "skill", "by_leader", "said"),
    [
        ((-0.2, 0.01), (-0.1, 0.01), (-0.1, -0.1), ("treated is more careful", "treated is more skilled")),
        ((0.2, 0.01), (0.1, 0.01), (0.1, 0.1), ("control is more careful", "control is more skilled")),
        ((-0.2, 0.06), (-0.1, 0.01), (-0.3, 0.1), ("not decided", "depends on whose moments")),
        ((-0.2, 0.06), (-0.1, 0.06), (-0.1, -0.1), ("not decided", "not decided")),
        ((0.0, 1.0), (0.0, 1.0), (0.0, 0.0), ("no difference", "no difference")),
    ],
)
def test_more_skilled_is_who_crashes_less_from_the_moments_of_both(caution, skill, by_leader, said) -> None:
    values = [caution, skill, *((estimate, 0.5) for estimate in by_leader)]
    found = pd.DataFrame(values, columns=["estimate", "p"]).assign(status="ok")
    found["question"] = ["caution", "skill", "skill, a leads", "skill, b leads"]
    words = analysis.claims(found, NAMES)
    assert [words[question].partition(" than")[0] for question in ("caution", "skill")] == [*said]
    assert set(analysis.claims(found.assign(holm=1.0), NAMES, "holm").values()) <= {"not decided", said[1]}


def test_holm_is_over_the_whole_family_of_tasks_and_traffics() -> None:
    """What is not there, and what claims nothing, counts as undecided."""
    rng = np.random.default_rng(3)
    careful: Rates = lambda rng: {"danger": 0.2, "crash": 0.5}  # noqa: E731
    made = {
        ("u-turn", "risky"): drawn(rng, (alike, careful)),
        ("u-turn", "regular"): drawn(rng, (alike, alike)),
        ("highway", "risky"): drawn(rng, (alike, alike)).assign(moment=1.0),
    }
    rows = pd.concat([one.assign(task=task, traffic=traffic) for (task, traffic), one in made.items()])
    found = analysis.of_tasks(rows).set_index(["task", "traffic", "question"])
    holm = found["p_holm"].dropna()
    assert len(holm) == 6 and set(holm.index.get_level_values("question")) == {"caution", "skill"}
    smallest = found.loc[holm.index, "p"].min()
    assert holm.min() == pytest.approx(20 * smallest) == holm["u-turn", "risky", "caution"]
    assert holm["highway", "risky", "caution"] == 1.0
    assert found.loc[("u-turn", "risky", "caution"), "estimate"] == pytest.approx(-0.4, abs=0.1)
    words = analysis.claims(found.loc["u-turn", "risky"].reset_index(), NAMES, "p_holm")
    assert words["caution"] == "treated is more careful than control"


@pytest.mark.slow
def test_without_effects_one_study_in_twenty_claims_anything() -> None:
    """Also where half of the agents of each arm are of another kind."""
    wrong, tries = 0, 40
    for number in range(tries):
        rng = np.random.default_rng(number)
        rows = [
            drawn(rng, (two_optima, two_optima), scenarios=50).assign(task=task, traffic=traffic)
            for task in "abcde"
            for traffic in ("risky", "regular")
        ]
        found = analysis.of_tasks(pd.concat(rows))
        said = [analysis.claims(own, NAMES, "p_holm") for _, own in found.groupby(["task", "traffic"])]
        wrong += any("more" in word for words in said for word in words.values())
    assert wrong <= stats.binom.ppf(1 - 1e-3, tries, 0.05)
