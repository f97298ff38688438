"""The instrument is tested: false positives, coverage, placebo, negative control, planted effects.

The short versions run with every test; the complete table (instrument.py, 2000 studies for each row) is long.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from experiments.analysis.analysis import negative_control, placebo
from experiments.analysis.scores import Arms, Place, arms_of, with_outcomes
from experiments.study.store import load
from tests.experiments import synthetic
from tests.experiments.analysis import instrument
from tests.experiments.analysis.instrument import WORLDS, World, one

# What no test on means repairs; the documentation names them.
DEGENERATE = ("degenerate", "unequal seeds (10, 2)", "treatment falls to 0")
HAS_EFFECT = ("planted", "treatment falls")


def bound(rate: float, repeats: int, sigmas: float = 4) -> float:
    return rate + sigmas * np.sqrt(rate * (1 - rate) / repeats)


@pytest.mark.parametrize("seeds", [3, 5, 10])
@pytest.mark.parametrize(
    "name",
    [
        "crash rates .25, .45",
        "arm x scenario .7",
        "near 0 (.01, .03)",
        "agents differ little",
        "planted, arm x scenario .7",
    ],
)
def test_the_truth_is_covered_in_95_percent_also_on_new_scenarios(name: str, seeds: int) -> None:
    """Where the truth is 0, the others are false positives."""
    repeats = 300
    rates = one(WORLDS[name], (seeds, seeds), "crashed", "risky", repeats)
    assert rates.without == 0
    assert 1 - rates.covered < bound(0.05, repeats)


def test_ten_seeds_find_a_planted_effect() -> None:
    assert one(WORLDS["planted -.15"], (10, 10), "crashed", "risky", 100).rejected > 0.8


def test_the_slope_of_the_outcome_keeps_its_level() -> None:
    repeats = 200
    for seeds in (3, 10):
        assert instrument.slope(World(), seeds, "mean", repeats).rejected < bound(0.05, repeats)


def test_a_second_batch_where_the_first_is_open_keeps_the_error_rate() -> None:
    repeats = 300
    assert instrument.two_batches(World(), repeats).rejected < bound(0.05, repeats)


@pytest.mark.parametrize("seeds", [3, 10])
def test_no_equivalence_at_the_margin(seeds: int) -> None:
    repeats = 300
    assert instrument.equivalent(seeds, repeats) < bound(0.05, repeats)


@pytest.mark.slow
def test_no_setting_is_claimed_in_95_of_100_studies_without_effect() -> None:
    repeats = 150
    assert instrument.any_setting(World(), 5, repeats) < bound(0.05, repeats)


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [3, 10])
def test_the_primary_answer_keeps_its_level_and_covers(seeds: int) -> None:
    repeats = 150
    rates = instrument.primary(World(effect=-0.05, own=0.7), seeds, repeats)
    assert 1 - rates.covered < bound(0.05, repeats)
    assert rates.rejected > 0.6


@pytest.mark.long
def test_the_whole_table() -> None:
    """False positives at most 7 %, coverage at least 93 %, for 3, 5 and 10 seeds; but for what is named."""
    wrong = []
    for name, seeds, rates in instrument.table(2000):
        if name.startswith(DEGENERATE):
            continue
        effect = any(words in name for words in HAS_EFFECT)
        slack = 3 * np.sqrt(0.05 * 0.95 / rates.repeats)
        if rates.covered < 0.93 - slack or (not effect and rates.rejected > 0.07 + slack):
            wrong.append((name, seeds, rates))
    assert wrong == []


@pytest.fixture(scope="module")
def episodes(tmp_path_factory):
    directory = tmp_path_factory.mktemp("results")
    synthetic.write(directory, {"highway": (1,), "u-turn": (1, 2)}, seeds=8, tests=40, effect=-0.3)
    results = load(directory)
    return with_outcomes(results)


def drawn(pairs: dict[Place, Arms]) -> pd.DataFrame:
    """Episodes of made-up settings."""
    tables = []
    for place, pair in pairs.items():
        where = dict(zip(("backend", "task", "level", "level_name"), place, strict=True))
        for name, arm in pair.items():
            number = arm["crashed"].shape[-1]
            sizes = [("regular", "risky"), range(arm["crashed"].shape[1]), range(number)]
            index = pd.MultiIndex.from_product(sizes, names=["traffic", "seed", "scenario"])
            values = {outcome: arm[outcome].ravel() for outcome in ("crashed", "return")}
            tables.append(pd.DataFrame(values, index).reset_index().assign(**where, kind="agent", arm=name))
    return pd.concat(tables, ignore_index=True)


class TestKnownTruths:
    def test_the_placebo_is_silent_where_the_treatment_is_not(self, episodes) -> None:
        agents = episodes[episodes["kind"] == "agent"]
        pairs = arms_of(agents)
        assert instrument.balanced(pairs)["p"].item() < 0.01
        [silent] = placebo(agents).query("outcome == 'crashed'").to_dict("records")
        assert silent["comparisons"] == 3
        assert silent["low"] < 0 < silent["high"]

    def test_the_placebo_rejects_in_about_five_percent(self) -> None:
        random = np.random.default_rng(4)
        pairs: dict[Place, Arms] = {
            ("sumo", "highway", k, str(k)): instrument.setting(World(effect=0.3), (8, 8), random)
            for k in range(100)
        }
        for record in placebo(drawn(pairs)).to_dict("records"):
            assert record["comparisons"] == 100
            assert record["rejected"] / 100 < bound(0.05, 100)
            assert record["p"] > 1e-4

    def test_the_placebo_needs_four_control_agents(self) -> None:
        pair = instrument.setting(World(), (3, 3), np.random.default_rng(4))
        assert placebo(drawn({("sumo", "highway", 1, "50"): pair})).empty

    def test_the_negative_control_is_exactly_zero(self, episodes) -> None:
        assert negative_control(episodes) == 0.0

    def test_the_negative_control_needs_the_rule(self, episodes) -> None:
        assert negative_control(episodes[episodes["policy"] != "careful"]) is None
