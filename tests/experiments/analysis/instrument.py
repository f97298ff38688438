"""Error rates of the analysis on made-up studies whose truth is known: false positives, coverage, power.

    python -m tests.experiments.analysis.instrument [REPEATS]

prints the table that docs and tests quote. Crashes come from a probit model: an arm's mean, an agent's own deviation
(its training seed's), a scenario's difficulty that all agents share, one that only the agents of an arm share, and
noise. What the planned tests claim holds over new agents *and* new scenarios.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from scipy.stats import norm

from experiments.analysis import estimate
from experiments.analysis.effects import ALL_TASKS, contrasts, means, slopes
from experiments.analysis.estimate import OK
from experiments.analysis.plan import ALPHA, OUTCOMES
from experiments.analysis.scores import Arm, Arms, Setting
from experiments.study.design.sheet import GRID
from tests.experiments.analysis.made_up import PAIR

SCENARIOS = 100
SETTING = ("sumo", "highway", 1, "50")


@dataclass(frozen=True)
class World:
    """What a study is drawn from.

    rates: crash rate of control agents in regular and risky traffic. effect: what the treatment adds to both. spread:
    standard deviation of agents. difficulty: of scenarios. own: of scenarios for one arm alone (all three on the probit
    scale). bad: share of agents (treatment, control) that crash by `bad_shift` more.
    """

    rates: tuple[float, float] = (0.25, 0.45)
    effect: float = 0.0
    spread: float = 0.3
    difficulty: float = 1.0
    own: float = 0.0
    bad: tuple[float, float] = (0.0, 0.0)
    bad_shift: float = 0.45

    @property
    def truth(self) -> float:
        """The true effect on the crash rate in either traffic."""
        return self.effect + self.bad_shift * (self.bad[0] - self.bad[1])


def setting(world: World, n: int, random: np.random.Generator) -> dict[str, Arm]:
    """A setting of a study, with n agents in each arm."""
    total = np.sqrt(1 + world.spread**2 + world.difficulty**2 + world.own**2)
    shared = random.normal(0, world.difficulty, (2, 1, SCENARIOS))
    pair: dict[str, Arm] = {}
    for number, name in enumerate(("treatment", "control")):
        chances = np.array(world.rates)[:, None, None] + (world.effect if name == "treatment" else 0.0)
        is_bad = random.uniform(size=(1, n, 1)) < world.bad[number]
        chances = np.clip(chances + world.bad_shift * is_bad, 1e-12, 1 - 1e-12)
        common = random.normal(0, world.spread, (1, n, 1))
        agents = 0.8 * common + 0.6 * random.normal(0, world.spread, (2, n, 1))
        own = random.normal(0, world.own, (2, 1, SCENARIOS)) if world.own else 0.0
        latent = shared + own + agents + random.normal(size=(2, n, SCENARIOS))
        crashed = (latent < norm.ppf(chances) * total).astype(float)
        reward = 20 - 8 * crashed + shared + 2 * agents + random.normal(0, 2, crashed.shape)
        pair[name] = {"crashed": crashed, "return": reward}
    return pair


def study(world: World, seeds: int, random: np.random.Generator) -> dict[Setting, Arms]:
    """All 18 settings."""
    levels = [(task, k, name) for task, names in GRID.items() for k, name in enumerate(names, start=1)]
    return {("sumo", *level): setting(world, seeds, random) for level in levels}


def studies(
    draw: Callable[[np.random.Generator], Mapping[Setting, Arms]], repeats: int
) -> dict[Setting, Arms]:
    """The settings of many studies, each under a name of its own in the place of the simulator's."""
    random = np.random.default_rng(7)
    return {(str(k), *place[1:]): pair for k in range(repeats) for place, pair in draw(random).items()}


def settings(world: World, seeds: int, repeats: int) -> dict[Setting, Arms]:
    """Studies of one setting."""
    return studies(lambda random: {SETTING: setting(world, seeds, random)}, repeats)


@dataclass(frozen=True)
class Rates:
    """What came of many studies, in shares of those with an interval: 0 excluded, truth covered; and without one."""

    rejected: float
    covered: float
    without: float
    repeats: int


def rates(found: pd.DataFrame, truth: float) -> Rates:
    """The rates of estimates, a row a study."""
    known = found[found["status"] == OK]
    covered = (known["low"] <= truth) & (truth <= known["high"])
    return Rates((known["p"] < ALPHA).mean(), covered.mean(), 1 - len(known) / len(found), len(found))


def effects(arms: Mapping[Setting, Arms], outcome: str, term: str) -> pd.DataFrame:
    """Treatment minus control in each setting."""
    return contrasts(arms, {PAIR: [(outcome, term)]})


def balanced(arms: Mapping[Setting, Arms]) -> pd.DataFrame:
    """The mean effect on the crash rate in risky traffic over the settings of each study, tasks alike."""
    found = means(effects(arms, "crashed", "risky"))
    return found[found["scope"] == ALL_TASKS]


def one(world: World, outcome: str, term: str, seeds: int, repeats: int) -> Rates:
    """The effect of a setting."""
    found = effects(settings(world, seeds, repeats), outcome, term)
    return rates(found, world.truth * (2 if term == "sum" else 1))


def primary(world: World, seeds: int, repeats: int) -> Rates:
    """The primary question: all 18 settings, tasks alike."""
    return rates(balanced(studies(lambda random: study(world, seeds, random), repeats // 4)), world.effect)


def slope(outcome: str, quantity: str, seeds: int, repeats: int) -> Rates:
    """A slope over three levels that do not differ."""

    def draw(random: np.random.Generator) -> dict[Setting, Arms]:
        levels = enumerate(GRID["highway"], start=1)
        return {("sumo", "highway", k, name): setting(World(), seeds, random) for k, name in levels}

    found = slopes(studies(draw, repeats))
    return rates(found[(found["outcome"] == outcome) & (found["quantity"] == quantity)], 0.0)


def any_setting(seeds: int, repeats: int) -> Rates:
    """Studies without an effect that claim one in some setting, by Holm."""
    drawn = studies(lambda random: study(World(), seeds, random), repeats // 4)
    found = effects(drawn, "crashed", "risky")
    claimed = found.groupby("backend")["p"].transform(estimate.adjusted) < ALPHA
    return shares(claimed.groupby(found["backend"]).any())


def equivalent(seeds: int, repeats: int) -> Rates:
    """Settings that are called equivalent although they differ by the margin."""
    margin = OUTCOMES["crashed"].margin or 0.0
    world = World(rates=(0.1, 0.1), effect=margin, spread=0.05)
    found = effects(settings(world, seeds, repeats), "crashed", "risky")
    return shares(estimate.equivalence(found, margin) < ALPHA)


def shares(wrong: pd.Series) -> Rates:
    return Rates(wrong.mean(), 1 - wrong.mean(), 0.0, len(wrong))


WORLDS = {
    "crash rates .25, .45": World(),
    "agents differ little": World(spread=0.05),
    "agents differ much": World(spread=0.8),
    "scenarios decide": World(difficulty=3.0),
    "arm x scenario .7": World(own=0.7),
    "near 0 (.01, .03)": World(rates=(0.01, 0.03)),
    "at 0 (.0002, .001)": World(rates=(0.0002, 0.001)),
    "near 1 (.90, .97)": World(rates=(0.90, 0.97)),
    "planted -.15": World(effect=-0.15, rates=(0.30, 0.50)),
    "planted, arm x scenario .7": World(effect=-0.15, rates=(0.30, 0.50), own=0.7),
    "treatment falls to 0": World(effect=-0.0499, rates=(0.05, 0.05)),
    "one agent in ten bad, both arms": World(rates=(0.05, 0.05), bad=(0.1, 0.1)),
    "degenerate: one in ten bad, treatment only": World(rates=(0.10, 0.10), bad=(0.1, 0.0), effect=-0.045),
}


PLANTED = "primary, planted -.05, arm x scenario .7"
# What is measured, of so many seeds in so many studies; of a quarter of them where a study has all 18 settings.
ROWS: dict[str, Callable[[int, int], Rates]] = {
    **{
        f"{name}: {outcome} {term}": partial(one, world, outcome, term)
        for name, world in WORLDS.items()
        for outcome, term in (("crashed", "risky"), ("crashed", "sum"), ("return", "sum"))
        if outcome == "crashed" or (world.effect == 0 and not any(world.bad))
    },
    "primary, no effect": partial(primary, World()),
    PLANTED: partial(primary, World(effect=-0.05, own=0.7)),
    "primary, near 0, no effect": partial(primary, World(rates=(0.01, 0.02))),
    "slope of the outcome": partial(slope, "return", "mean"),
    "slope of the effect": partial(slope, "return", "effect"),
    "slope of the crash rate": partial(slope, "crashed", "mean"),
    "any of 18 settings by Holm, no effect": any_setting,
    "called equivalent at the margin": equivalent,
}


def table(repeats: int) -> Iterator[tuple[str, int, Rates]]:
    """Rows of the table: what was measured, seeds, rates."""
    for name, row in ROWS.items():
        for seeds in (3, 5, 10):
            yield name, seeds, row(seeds, repeats)


def mistaken(name: str, rates: Rates) -> float:
    """The share of studies that miss the truth, or find an effect where there is none."""
    has_effect = "planted" in name or "treatment falls" in name
    return max(1 - rates.covered, 0.0 if has_effect else rates.rejected)


if __name__ == "__main__":
    print(f"{'':<62}{'seeds':>6}{'0 excluded':>12}{'covered':>9}{'no interval':>13}   [%]")
    for name, seeds, found in table(int(sys.argv[1]) if len(sys.argv) > 1 else 1000):
        shown = (100 * found.rejected, 100 * found.covered, 100 * found.without)
        print(f"{name:<62}{seeds:>6}{shown[0]:>12.1f}{shown[1]:>9.1f}{shown[2]:>13.1f}", flush=True)
