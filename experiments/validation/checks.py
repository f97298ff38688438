"""The checks of a task, level and traffic: what was measured, beside its margin.

A margin says how far SUMO's traffic may be from highway-env's before a researcher would conclude something else. The
margins were fixed before SUMO's drivers were validated with them, and are never fitted to results. A check is judged by
its point estimate; *equivalent* is said only where the whole 90 % interval lies inside the margin (two one-sided tests
at 5 %).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from experiments.study.verdict import summary
from experiments.validation import compare
from experiments.validation.compare import Difference
from experiments.validation.egos import CORE, egos

if TYPE_CHECKING:
    import pandas as pd

Check = dict[str, Any]
LEAST_SCENARIOS = 3  # with fewer there is no verdict
REFERENCE, NOISE, VARIANTS, TRUTH = "reference", "reference at 10 Hz", ("connected", "v0"), "highway-env"
# Measures over the egos of CORE: metric -> (name, unit). Those without a margin are reported.
MEASURES = {
    "traffic_speed": ("traffic speed", "m/s"),
    "return": ("return", ""),
    "crashed": ("crash rate", ""),
    "lane_changes": ("lane changes of the traffic", "1/vehicle-minute"),
    "length": ("episode length", "steps"),
    "crash_time": ("time to crash, where both crash", "s"),
    "ego_speed": ("speed of the ego", "m/s"),
    "density": ("vehicles within 200 m", ""),
}
# Range of the return of an episode.
RETURN_RANGE: dict[str, float] = {
    "highway": 20.0,  # at most 1 a step for 20 s
    "two-way": 15.0,
    "roundabout": 11.0,
    "intersection": 14.0,  # -5 to 9
    "u-turn": 10.0,
}


@dataclass(frozen=True, slots=True)
class Margin:
    """The largest acceptable |SUMO - highway-env|.

    Attributes:
        value: of the margin.
        relative_to: what `value` is a share of: nothing ("unit"), highway-env's own value ("reference"), or the range
            of the task's return ("range").
        reason: why so large.
    """

    value: float
    relative_to: Literal["unit", "reference", "range"]
    reason: str

    def bound(self, task: str, reference: float) -> float:
        """The margin in the unit of the measure, where highway-env's value is `reference`."""
        scale = {"unit": 1.0, "reference": abs(reference), "range": RETURN_RANGE[task]}
        return self.value * scale[self.relative_to]


MARGINS: dict[str, Margin] = {
    "traffic_speed": Margin(0.05, "reference", "the spread of desired speeds between drivers is 7 %"),
    "headway": Margin(
        0.15, "reference", "Wasserstein distance; traffic that brakes half or twice as hard is further away"
    ),
    "return": Margin(0.05, "range", "effects of training worth reporting are larger"),
    "crashed": Margin(0.10, "unit", "a dose of 1 is calibrated to raise the rate by 0.10 to 0.30"),
    "crashed_ego": Margin(0.15, "unit", "one ego meets one kind of conflict, all of them the mixture"),
    "lane_changes": Margin(
        0.25, "reference", "highway-env at 10 and at 15 Hz differs from itself by as much"
    ),
    "order": Margin(0.0, "unit", "which of two egos is better must not depend on the simulator"),
}
# The replica is highway-env compiled; an episode may differ only where rounding decides who crosses first.
REPLICA = Margin(0.01, "unit", "share of the recomputed episodes that end differently")


def margin_of(metric: str, task: str, traffic: str) -> Margin | None:
    """The margin of a measure, None where it is reported without a verdict."""
    if metric == "lane_changes" and (task != "highway" or traffic != "regular"):
        return None
    return MARGINS.get(metric)


def check(
    name: str, metric: str, found: Difference, task: str, margin: Margin | None = None, *, unit: str = "",
    ego: str = "", noise: float | None = None, variants: Mapping[str, float] | None = None, note: str = "",
) -> Check:  # fmt: skip
    """One line of the scorecard as plain JSON values; its verdict is None where there is no margin."""
    bound = None if margin is None else margin.bound(task, found.second)
    return {
        "name": name,
        "metric": metric,
        "ego": ego,
        "unit": unit,
        "sumo": finite(found.first),
        "reference": finite(found.second),
        "difference": finite(found.difference),
        "low": finite(found.low),
        "high": finite(found.high),
        "margin": finite(bound),
        "verdict": verdict(found, bound),
        "noise": finite(noise),
        "n": found.n,
        "variants": {key: finite(value) for key, value in (variants or {}).items()},
        "reason": "" if margin is None else margin.reason,
        "note": note,
    }


def verdict(found: Difference, bound: float | None) -> str | None:
    """equivalent (the whole interval is within the margin), within, missed, or None if nothing can be said."""
    if bound is None or not math.isfinite(found.difference) or found.n < LEAST_SCENARIOS:
        return None
    if abs(found.difference) > bound + 1e-9:
        return "missed"
    if found.low is None or found.high is None:
        return "within"
    return "equivalent" if -bound <= found.low and found.high <= bound else "within"


def finite(value: float | None) -> float | None:
    """The number to six digits; None for nan, inf and None, which JSON has no words for."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.6g}")


def level_checks(rows: pd.DataFrame, engine: str, task: str, traffic: str) -> list[Check]:
    """All checks of one task, level and traffic: those with a margin first.

    Args:
        rows: the episodes of all engines.
        engine: which of them is compared with the reference.
    """
    every = compare.pairs(rows, engine, REFERENCE)
    if every.empty:
        return []
    both = every[every["ego"].isin(CORE)]
    core = rows[rows["ego"].isin(CORE)]
    noise = compare.pairs(core, NOISE, REFERENCE)
    others = {name: compare.pairs(core, name, REFERENCE) for name in VARIANTS}

    found = []
    for metric, (name, unit) in MEASURES.items():
        difference = compare.mean_difference(both, metric)
        # of other variants of highway-env: the reference's mean plus the difference in common episodes
        variants = {
            variant: difference.second + compare.mean_difference(pairs, metric).difference
            for variant, pairs in others.items()
            if len(pairs)
        }
        own = compare.mean_difference(noise, metric).difference if len(noise) else None
        margin = margin_of(metric, task, traffic)
        found.append(check(name, metric, difference, task, margin, unit=unit, noise=own, variants=variants))
    for metric, name, unit, measure in (
        ("headway", "headways (Wasserstein distance)", "s", compare.headway_distance),
        ("wrecks", "wrecks of the other traffic", "1/vehicle-hour", compare.wrecks_difference),
        ("same_outcome", "same crash outcome", "share", compare.same_outcome),
    ):
        own = measure(noise).difference if len(noise) else None
        margin = margin_of(metric, task, traffic)
        found.append(check(name, metric, measure(both), task, margin, unit=unit, noise=own))
    found += ego_checks(every, task)
    return sorted((item for item in found if item["n"]), key=lambda item: item["verdict"] is None)


def ego_checks(every: pd.DataFrame, task: str) -> list[Check]:
    """Each ego's crash rate and return, and the order of all egos."""
    found = []
    for ego in egos(task):
        part = every[every["ego"] == ego]
        crashes, returns = (compare.mean_difference(part, metric) for metric in ("crashed", "return"))
        found.append(check("crash rate", "crashed_ego", crashes, task, MARGINS["crashed_ego"], ego=ego))
        found.append(check("return", "return_ego", returns, task, ego=ego))
    scenarios = every["scenario"].nunique()
    for measure, name in (("return", "return"), ("crashed", "crash rate")):
        turned, decided = compare.reversed_pairs(every, measure)
        same = decided - len(turned)
        difference = Difference(float(same), float(decided), -float(len(turned)), None, None, scenarios)
        note = f"reversed: {', '.join(turned)}" if turned else ""
        name = f"pairs of egos in the same order, by {name}"
        unit = f"of {decided} decided"
        found.append(check(name, "order", difference, task, MARGINS["order"], unit=unit, note=note))
    return found


def replica_checks(table: pd.DataFrame) -> dict[str, Any] | None:
    """The reference against the random episodes that highway-env itself has driven again, by task; None without any."""
    both = compare.pairs(table, REFERENCE, TRUTH)
    if both.empty:
        return None
    sides = [f"{name}_{side}" for name in ("outcome", "length", "return") for side in "ab"]
    tasks = {}
    for task, part in both.groupby("task", sort=False):
        others = compare.differing(part)
        crashes, returns = (compare.mean_difference(part, metric) for metric in ("crashed", "return"))
        tasks[str(task)] = {
            "episodes": len(part),
            "differing": len(others),
            "verdict": "within" if len(others) / len(part) <= REPLICA.value else "missed",
            "crash_rate": finite(crashes.second),
            "crash_rate_difference": finite(crashes.difference),
            "return": finite(returns.second),
            "return_difference": finite(returns.difference),
            "exceptions": others[["level", "traffic", "ego", "scenario", *sides]]
            .astype(object)
            .to_dict("records"),
        }
    return {"margin": REPLICA.value, "reason": REPLICA.reason, "tasks": tasks}


def scorecard(table: pd.DataFrame, engine: str, level_names: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """All checks by task, traffic and level; whether each task passed, and how many checks came out how.

    Args:
        table: the episodes of all engines.
        level_names: of each task.
    """
    tasks: dict[str, Any] = {}
    for task, names in level_names.items():
        traffics: dict[str, Any] = {}
        rows = table[table["task"] == task]
        for traffic in dict.fromkeys(rows["traffic"]):
            for number, name in enumerate(names, start=1):
                part = rows[(rows["traffic"] == traffic) & (rows["level"] == number)]
                if found := level_checks(part, engine, task, traffic):
                    traffics.setdefault(traffic, {})[name] = found
        tasks[task] = {"traffics": traffics}
    return {
        task: {"passed": found["passed"], **tasks[task], "counts": found["counts"]}
        for task, found in summary(tasks).items()
    }
