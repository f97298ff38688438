"""The analysis plan as data: what is compared and what decides, fixed before the results are there.

Every module of the analysis reads its choices here, and the SHA-256 of `as_data` goes into analysis.json: two reports
with the same one were made by the same plan. Whatever is not named confirmatory is exploratory.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.study.design.sheet import GRID, SHEETS

ALPHA = 0.05
POWER = 0.8


@dataclass(frozen=True)
class Outcome:
    """A quantity of a test episode that is averaged and compared.

    label: for people. unit: of a mean. better: +1 if more is better, -1 if less is, 0 if neither. digits: decimals to
    show. percent: shown as a percentage. poolable: means the same on every task, so may be averaged over tasks. margin:
    the difference that matters: below it two arms count as equivalent, and seeds are planned to find it; None where
    none was fixed. of: for an outcome of one's own, a function from the table of test episodes (one row per episode,
    the columns of `experiments.study.compute.evaluate.COLUMNS`) to one number per episode.
    """

    label: str
    unit: str
    better: int
    digits: int
    percent: bool = False
    poolable: bool = False
    margin: float | None = None
    of: Callable[[Any], Any] | None = None


OUTCOMES: dict[str, Outcome] = {
    "return": Outcome("Return", "per episode", +1, 2),
    "crashed": Outcome("Crash rate", "of episodes", -1, 1, percent=True, poolable=True, margin=0.05),
    "crash_free_time": Outcome("Time to crash", "s, at most the episode's", +1, 1, margin=1.0),
    "crashes_per_100_km": Outcome("Crashes per 100 km", "", -1, 1),
    "mean_speed": Outcome("Mean speed", "m/s", 0, 1, poolable=True, margin=0.5),
    "near_misses": Outcome("Near-misses", "per episode", -1, 2, poolable=True),
    "reward_per_step": Outcome("Reward per step", "", +1, 3),
}
TERMS: dict[str, dict[str, float]] = {
    "risky": {"risky": 1.0},
    "regular": {"regular": 1.0},
    "sum": {"risky": 1.0, "regular": 1.0},  # the paper's ATE
    "interaction": {"risky": 1.0, "regular": -1.0},
}


@dataclass(frozen=True)
class Family:
    """Hypotheses that are tested together, with Holm's adjustment over all settings: an outcome in a term.

    arm: is compared with control.
    """

    name: str
    outcome: str
    term: str
    equivalence: bool = False
    arm: str = "treatment"


@dataclass(frozen=True)
class Bound:
    """A difference in the crash rate in one traffic, arm minus against, that has to be below a margin."""

    arm: str
    against: str
    term: str
    margin: float


@dataclass(frozen=True)
class Learner:
    """What is asked of the learner before anything is compared, see `gates.learner_checks`.

    change: of the return over the last quarter of the budget at most, in units of its range. passing: share of the
    agents that pass the gates at least. clocked: tasks whose last second is compared with the `before` seconds before
    it. ranges: of the return.
    """

    change: float = 0.02
    passing: float = 0.97
    clocked: tuple[str, ...] = ("roundabout", "u-turn")
    before: float = 4.0
    ranges: dict[str, float] = field(
        default_factory=lambda: {task: SHEETS[task].return_range for task in GRID}
    )


@dataclass(frozen=True)
class Plan:
    """All choices of an analysis.

    Version 2: one primary outcome on all tasks; harms in regular traffic are counted as benefits in risky traffic are;
    nothing is concluded from a setting where every agent always crashes. From 3 on: only settings of which every agent
    is there count.

    settings: the grid that the plan is about, (task, name of the level); effects of others are exploratory.
    primary_outcome, primary_term: of the one primary question, over all agents, with every task weighted alike.
    price: all that has to hold for a gain without price, in all settings but hopeless ones (level names by task).
    trained: arms that have to be there beside those of the families. design: what the cells are made of, as the preset
    asks for them.
    """

    version: int = 2
    settings: tuple[tuple[str, str], ...] = tuple(
        (task, name) for task, names in GRID.items() for name in names
    )
    primary_outcome: str = "crashed"
    primary_term: str = "risky"
    families: tuple[Family, ...] = (
        Family("safety", "primary", "risky"),
        Family("harm", "primary", "regular"),
        Family("paper", "return", "sum"),
        Family("no harm", "crashed", "regular", equivalence=True),
    )
    price: tuple[Bound, ...] = ()
    hopeless: dict[str, tuple[str, ...]] = field(default_factory=dict)
    learner: Learner | None = None
    trained: tuple[str, ...] = ()
    design: dict[str, Any] = field(default_factory=dict)

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks of its settings."""
        return tuple(dict.fromkeys(task for task, _ in self.settings))

    def covers(self, rows: pd.DataFrame) -> NDArray[np.bool_]:
        """Which rows, with the columns task and level_name, are of its settings."""
        places = zip(rows["task"], rows["level_name"], strict=True)
        return np.fromiter((place in self.settings for place in places), bool, len(rows))

    @property
    def arms(self) -> tuple[str, ...]:
        """The arms that the families compare, and others that have to be trained."""
        return ("control", *dict.fromkeys([*(family.arm for family in self.families), *self.trained]))

    def outcome(self, family: Family) -> str:
        """The outcome of a family."""
        return self.primary_outcome if family.outcome == "primary" else family.outcome

    def family(self, arm: str, outcome: str, term: str) -> str:
        """Name of the family that an effect of a setting is tested in; empty if it is exploratory."""
        tests = {(f.arm, self.outcome(f), f.term): f.name for f in self.families if not f.equivalence}
        return tests.get((arm, outcome, term), "")


DEFAULT = Plan()
PLANS: dict[str, Plan] = {}  # by the preset of a study that has a plan of its own


def plan_of(presets: Iterable[str]) -> Plan:
    """The plan for results that these presets asked for."""
    asked = set(presets)
    return next((plan for preset, plan in PLANS.items() if preset in asked), DEFAULT)


def as_data(plan: Plan, thresholds: dict[str, Any]) -> dict[str, Any]:
    """The plan as the plain values that its digest is taken of: all that decides, and no words.

    Args:
        thresholds: of the gates, `gates.THRESHOLDS`.
    """
    decided = {plan.outcome(family) for family in plan.families} | {plan.primary_outcome}
    data = {
        **asdict(plan),
        "alpha": ALPHA,
        "power": POWER,
        "margins": {name: OUTCOMES[name].margin for name in sorted(decided)},
        "terms": TERMS,
        "thresholds": thresholds,
    }
    plain: dict[str, Any] = json.loads(json.dumps(data))  # as it is read back from analysis.json
    return plain
