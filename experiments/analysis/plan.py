"""The analysis plan as data: what is compared and what decides, fixed before the results are there.

Every module of the analysis reads its choices here, and the SHA-256 of `as_data` goes into analysis.json: two reports
with the same one were made by the same plan. Whatever is not named confirmatory is exploratory.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.study.design.arms import ARMS
from experiments.study.design.sheet import GRID, SHEETS

ALPHA = 0.05
POWER = 0.8


@dataclass(frozen=True)
class Outcome:
    """A quantity of a test episode that is averaged and compared.

    label, unit: what a column of it is called. better: +1 if more is better, -1 if less is, 0 if neither. digits:
    decimals to show. percent: shown as a percentage. poolable: means the same on every task, so may be averaged over
    tasks. margin: the difference that matters: below it two arms count as equivalent, and seeds are planned to find it;
    None where none was fixed. of: for an outcome of one's own, a function from the table of test episodes (one row per
    episode, the columns of `experiments.study.results.schema.COLUMNS`) to one number per episode.
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
    "return": Outcome("return", "", +1, 2),
    "score": Outcome("score", "", +1, 2, poolable=True),  # see `design.attainable`
    "crashed": Outcome("crashes", "[%]", -1, 1, percent=True, poolable=True, margin=0.05),
    "crash_free_time": Outcome("time to crash, at most the episode's", "[s]", +1, 1, margin=1.0),
    "crashes_per_100_km": Outcome("crashes per 100 km", "", -1, 0),
    "mean_speed": Outcome("speed", "[m/s]", 0, 1, poolable=True, margin=0.5),
    "near_misses": Outcome("near misses", "", -1, 2, poolable=True),
    "reward_per_step": Outcome("reward per step", "", +1, 3),
}
TERMS: dict[str, dict[str, float]] = {
    "risky": {"risky": 1.0},
    "regular": {"regular": 1.0},
    "sum": {"risky": 1.0, "regular": 1.0},  # the paper's ATE
    "interaction": {"risky": 1.0, "regular": -1.0},
}


@dataclass(frozen=True)
class Family:
    """Hypotheses that are tested together, with Holm's adjustment over all settings: an outcome in a term."""

    name: str
    outcome: str
    term: str


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


Places = tuple[tuple[str, str], ...]  # settings: task, and name of the level
EVERYWHERE: Places = tuple((task, name) for task, names in GRID.items() for name in names)
LIGHTEST: Places = tuple((task, names[0]) for task, names in GRID.items())
# No sequence of actions avoids a crash in most of its scenarios (`design.attainable`).
UNDRIVABLE = ("two-way", "15+6")
DRIVABLE: Places = tuple(place for place in EVERYWHERE if place != UNDRIVABLE)
DENSEST: Places = tuple((task, names[-1]) for task, names in GRID.items() if task != UNDRIVABLE[0])
# The two-way road with actions that can slow down behind the others: an answer of its own, in no mean over tasks.
BRAKES = ("two-way-brakes", "5+2")


@dataclass(frozen=True)
class Plan:
    """All choices of an analysis.

    The primary question is an outcome by task, the levels of a task alike, treatment minus control in either traffic,
    with Holm's adjustment over the tasks and traffics. By every plan all agents count, and harms in regular traffic are
    counted as benefits in risky traffic are; from version 3 on only settings of which every agent is there.

    settings: the grid that the plan is about; effects of others are exploratory. primary_term: of the mean over tasks.
    stages: their settings, in order, also such that the plan is not about; a stage is complete where every setting has
    this many `seeds` in each arm, and the last complete one is reported.
    """

    version: int = 2
    settings: Places = EVERYWHERE
    primary_outcome: str = "crashed"
    primary_term: str = "risky"
    families: tuple[Family, ...] = (
        Family("safety", "crashed", "risky"),
        Family("harm", "crashed", "regular"),
        Family("paper", "return", "sum"),
    )
    learner: Learner | None = None
    stages: dict[str, Places] = field(default_factory=dict)
    seeds: int = 0

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks of its settings."""
        return tuple(dict.fromkeys(task for task, _ in self.settings))

    def covers(self, rows: pd.DataFrame) -> NDArray[np.bool_]:
        """Which rows, with the columns task and level_name, are of its settings."""
        places = zip(rows["task"], rows["level_name"], strict=True)
        return np.fromiter((place in self.settings for place in places), bool, len(rows))

    def family(self, outcome: str, term: str) -> str:
        """Name of the family that an effect of treatment is tested in; empty if it is exploratory."""
        return {(one.outcome, one.term): one.name for one in self.families}.get((outcome, term), "")


DEFAULT = Plan()
# Plan 6 (docs/developers/plan_v6.md).
STUDY = Plan(
    version=6,
    settings=DRIVABLE,
    learner=Learner(),
    stages={
        "a": (*LIGHTEST, BRAKES),
        "b": (*LIGHTEST, BRAKES, *DENSEST),
        "c": (*DRIVABLE, BRAKES),
    },
    seeds=5,
)
PLANS = {"study": STUDY}  # by the preset of a study that has a plan of its own


def plan_of(presets: Iterable[str]) -> Plan:
    """The plan for results that these presets asked for."""
    asked = set(presets)
    return next((plan for preset, plan in PLANS.items() if preset in asked), DEFAULT)


def reached(plan: Plan, agents: pd.DataFrame) -> tuple[str, Plan]:
    """The last stage that is complete, and the plan for its settings alone; "" and the plan where none is.

    Args:
        agents: with the columns task, level_name, arm and seed.
    """
    seeds = agents.groupby(["arm", "task", "level_name"])["seed"].nunique()
    name = ""
    for stage, places in plan.stages.items():
        if any(seeds.get((arm, *place), 0) < plan.seeds for arm in ARMS for place in places):
            break
        name, settings = stage, tuple(place for place in plan.settings if place in places)
    return (name, replace(plan, settings=settings)) if name else ("", plan)


def as_data(plan: Plan, thresholds: dict[str, Any]) -> dict[str, Any]:
    """The plan as the plain values that its digest is taken of: all that decides, and no words.

    Args:
        thresholds: of the gates, `gates.THRESHOLDS`.
    """
    decided = {family.outcome for family in plan.families} | {plan.primary_outcome}
    data = {
        **asdict(plan),
        "alpha": ALPHA,
        "power": POWER,
        "margins": {name: OUTCOMES[name].margin for name in sorted(decided)},
        "terms": TERMS,
        "thresholds": thresholds,
    }
    return json.loads(json.dumps(data))  # as it is read back from analysis.json
