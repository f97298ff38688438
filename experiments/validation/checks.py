"""The checks of a task, level and traffic: what was measured, beside its margin."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from experiments.validation import compare
from experiments.validation.compare import Difference
from experiments.validation.egos import CORE, egos
from experiments.validation.margins import REPLICA, Margin, margin_of

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


def check(
    name: str, metric: str, found: Difference, task: str, margin: Margin | None = None, *, unit: str = "",
    ego: str = "", noise: float | None = None, variants: Mapping[str, float] | None = None, note: str = "",
) -> Check:  # fmt: skip
    """One line of the scorecard as plain JSON values; its verdict is None where there is no margin."""
    bound = None if margin is None else margin.bound(task, found.second)
    return {
        "name": name, "metric": metric, "ego": ego, "unit": unit,
        "sumo": finite(found.first), "reference": finite(found.second), "difference": finite(found.difference),
        "low": finite(found.low), "high": finite(found.high), "margin": finite(bound),
        "verdict": verdict(found, bound), "noise": finite(noise), "n": found.n,
        "variants": {key: finite(value) for key, value in (variants or {}).items()},
        "reason": "" if margin is None else margin.reason, "note": note,
    }  # fmt: skip


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
    noise = compare.pairs(rows[rows["ego"].isin(CORE)], NOISE, REFERENCE)
    found = [
        check(
            name, metric, difference := compare.mean_difference(both, metric), task, margin_of(metric, task, traffic),
            unit=unit, noise=_difference(noise, metric), variants=_variants(rows, both, metric, difference.second),
        )
        for metric, (name, unit) in MEASURES.items()
    ]  # fmt: skip
    found.append(
        check(
            "headways (Wasserstein distance)", "headway", compare.headway_distance(both), task,
            margin_of("headway", task, traffic), unit="s",
            noise=compare.headway_distance(noise).difference if len(noise) else None,
        )
    )  # fmt: skip
    found.append(
        check(
            "wrecks of the other traffic", "wrecks", compare.rate_difference(both, "wrecks", "vehicle_hours"), task,
            unit="1/vehicle-hour",
            noise=compare.rate_difference(noise, "wrecks", "vehicle_hours").difference if len(noise) else None,
        )
    )  # fmt: skip
    found.append(
        check(
            "same crash outcome", "same_outcome", compare.same_outcome(both), task, unit="share",
            noise=compare.same_outcome(noise).difference if len(noise) else None,
        )
    )  # fmt: skip
    found += ego_checks(every, task)
    return sorted((item for item in found if item["n"]), key=lambda item: item["verdict"] is None)


def ego_checks(every: pd.DataFrame, task: str) -> list[Check]:
    """Each ego's crash rate and return, and the order of all egos."""
    found = []
    for ego in egos(task):
        part = every[every["ego"] == ego]
        crashes, returns = (compare.mean_difference(part, metric) for metric in ("crashed", "return"))
        margin = margin_of("crashed_ego", task, "")
        found.append(check("crash rate", "crashed_ego", crashes, task, margin, ego=ego))
        found.append(check("return", "return_ego", returns, task, ego=ego))
    scenarios = every["scenario"].nunique()
    for measure, name in (("return", "return"), ("crashed", "crash rate")):
        turned, decided = compare.reversed_pairs(every, measure)
        difference = Difference(
            float(decided - len(turned)), float(decided), -float(len(turned)), None, None, scenarios
        )
        note = f"reversed: {', '.join(turned)}" if turned else ""
        margin = margin_of("order", task, "")
        name = f"pairs of egos in the same order, by {name}"
        found.append(check(name, "order", difference, task, margin, unit=f"of {decided} decided", note=note))
    return found


def _difference(noise: pd.DataFrame, metric: str) -> float | None:
    return compare.mean_difference(noise, metric).difference if len(noise) else None


def _variants(rows: pd.DataFrame, both: pd.DataFrame, metric: str, reference: float) -> dict[str, float]:
    """The measure in highway-env's other variants: the reference's mean plus the difference in common episodes."""
    values = {}
    for name in VARIANTS:
        other = compare.pairs(rows[rows["ego"].isin(CORE)], name, REFERENCE)
        if len(other):
            values[name] = reference + compare.mean_difference(other, metric).difference
    return values


def replica_checks(table: pd.DataFrame) -> dict[str, Any] | None:
    """The reference against the random episodes that highway-env itself has driven again, by task; None without any."""
    both = compare.pairs(table, REFERENCE, TRUTH)
    if both.empty:
        return None
    tasks = {}
    for task, part in both.groupby("task", sort=False):
        others = compare.differing(part)
        share = len(others) / len(part)
        crashes = compare.mean_difference(part, "crashed")
        returns = compare.mean_difference(part, "return")
        columns = ["level", "traffic", "ego", "scenario", "outcome_a", "outcome_b", "length_a", "length_b", "return_a",
                   "return_b"]  # fmt: skip
        tasks[str(task)] = {
            "episodes": len(part),
            "differing": len(others),
            "verdict": "within" if share <= REPLICA.value else "missed",
            "crash_rate": finite(crashes.second),
            "crash_rate_difference": finite(crashes.difference),
            "return": finite(returns.second),
            "return_difference": finite(returns.difference),
            "exceptions": others[columns].astype(object).to_dict("records"),
        }
    return {"margin": REPLICA.value, "reason": REPLICA.reason, "tasks": tasks}


def passed(checks: Sequence[Check]) -> bool | None:
    """Whether no check missed its margin; None where none has a verdict."""
    verdicts = [item["verdict"] for item in checks if item["verdict"]]
    return "missed" not in verdicts if verdicts else None


def scorecard(table: pd.DataFrame, engine: str, level_names: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """All checks by task, traffic and level, and whether each task passed.

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
        every = [item for levels in traffics.values() for checks in levels.values() for item in checks]
        tasks[task] = {"passed": passed(every), "traffics": traffics}
    return tasks
