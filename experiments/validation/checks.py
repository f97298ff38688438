"""The checks of a task, level and traffic: what was measured, and its margin.

A margin says how far SUMO's traffic may be from highway-env's before a researcher would conclude something else. The
margins were fixed before SUMO's drivers were validated with them, and are never fitted to results. *Equivalent* is said
only where the whole 90 % interval lies inside the margin (two one-sided tests at 5 %, Schuirmann 1987), *missed* only
where the whole interval lies outside of it. Where the estimate alone is outside, the check is *not decided*. An order
of two egos has no interval: it is missed where SUMO itself decides it the other way round.

Two simulators are compared on the same scenarios. The scenario is the unit: the egos that were driven through one are
averaged first, so that intervals (by Student's t) do not pretend that they are independent. At the intersection, where
each simulator drives the three seconds before an episode itself, two episodes share the seed and not the first scene;
the arithmetic is the same.
"""

import json
import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from experiments.study.compute.evaluate import limits
from experiments.study.design.levels import level_names
from experiments.study.design.sheet import sheet
from experiments.validation.episodes import AGENTS, BIN, BINS, CORE, HEADWAYS, PAIR, egos

Check = dict[str, Any]
# SUMO minus the reference: the means of both ("sumo", "reference"), their "difference", its 90 % interval ("low",
# "high", NaN without one), and the number of scenarios ("n").
Difference = dict[str, float]
LEAST_SCENARIOS = 3  # with fewer there is no verdict
# The interval is within the margin; the estimate is; the estimate is outside; the interval is.
VERDICTS = ("equivalent", "within", "not decided", "missed")
OUTSIDE = VERDICTS[2:]  # of the estimate
# Engines in a table of episodes: the compared simulator, highway-env by its replica, and highway-env itself.
SUMO, REFERENCE, TRUTH = "sumo", "reference", "highway-env"
# The replica in other variants, by what differs.
VARIANTS: dict[str, dict[str, Any]] = {
    "connected": {"variant": "connected"},
    "v0": {"variant": "v0"},
    "10 Hz": {"variant": "path", "simulation_frequency": 10},
}
# Measures over the egos of CORE: metric -> (name, unit). Those without a margin are reported.
MEASURES = {
    "traffic_speed": ("traffic speed", "m/s"),
    "headway": ("headways (Wasserstein distance)", "s"),
    "return": ("return", ""),
    "crashed": ("crash rate", ""),
    "lane_changes": ("lane changes of the traffic", "1/vehicle-minute"),
    "same_outcome": ("same crash outcome", "share"),
    "length": ("episode length", "steps"),
    "crash_time": ("time to crash, where both crash", "s"),
    "ego_speed": ("speed of the ego", "m/s"),
    "density": ("vehicles within 200 m", ""),
}
# The largest acceptable |SUMO - highway-env|, and what it is a share of: nothing ("unit"), highway-env's own value
# ("reference"), or the range of the task's return ("range").
MARGINS: dict[str, tuple[float, Literal["unit", "reference", "range"]]] = {
    "traffic_speed": (0.05, "reference"),  # desired speeds of drivers spread by 7 %
    "headway": (0.15, "reference"),  # traffic that brakes half or twice as hard is further away
    "return": (0.05, "range"),  # effects of training worth reporting are larger
    "crashed": (0.10, "unit"),  # a dose of 1 is calibrated to raise the rate by 0.10 to 0.30
    "crashed_ego": (0.15, "unit"),  # one ego meets one kind of conflict, all of them the mixture
    "lane_changes": (0.25, "reference"),  # highway-env at 10 and at 15 Hz differs by as much
    "order": (0.0, "unit"),  # which of two egos is better must not depend on the simulator
}
# Share of the recomputed episodes that may end differently: where rounding decides who crosses first.
REPLICA = 0.01
RESAMPLES = 200
CENTRES = (np.arange(BINS) + 0.5) * BIN  # [s] of the headway histogram
Floats = NDArray[np.float64]


def pairs(table: pd.DataFrame, first: str, second: str) -> pd.DataFrame:
    """Episodes that both engines have driven, side by side with suffixes ``_a`` and ``_b``."""
    a, b = (table[table["engine"] == name].drop(columns="engine") for name in (first, second))
    return a.merge(b, on=PAIR, suffixes=("_a", "_b"))


def mean_difference(both: pd.DataFrame, measure: str) -> Difference:
    """Difference of the means of a measure; pairs in which either has none do not count."""
    columns = both[["scenario", f"{measure}_a", f"{measure}_b"]].astype(float)
    columns = columns[np.isfinite(columns).all(axis=1)]
    first, second = columns[f"{measure}_a"], columns[f"{measure}_b"]
    by_scenario = (first - second).groupby(columns["scenario"]).mean()
    _, low, high = limits(by_scenario, is_share=False, confidence=0.90)
    found = {"sumo": first.mean(), "reference": second.mean(), "difference": (first - second).mean()}
    return {**found, "low": low, "high": high, "n": len(by_scenario)}


def wasserstein(first: Floats, second: Floats) -> float:
    """Wasserstein distance [s] of two headway histograms of shape (BINS,); nan if either is empty."""
    if not first.sum() or not second.sum():
        return math.nan
    return float(stats.wasserstein_distance(CENTRES, CENTRES, first, second))


def headway_distance(both: pd.DataFrame) -> Difference:
    """Wasserstein distance of the headways, its interval by resampling scenarios; means of both."""
    sides = [both.groupby("scenario")[[f"{name}_{side}" for name in HEADWAYS]].sum() for side in "ab"]
    a, b = (side.to_numpy(float) for side in sides)
    rng = np.random.default_rng(0)
    resampled = []
    for _ in range(RESAMPLES if len(a) > 1 else 0):
        rows = rng.integers(len(a), size=len(a))
        resampled.append(wasserstein(a[rows].sum(axis=0), b[rows].sum(axis=0)))
    low, high = pd.Series(resampled, dtype=float).quantile([0.05, 0.95])
    totals = [side.sum(axis=0) for side in (a, b)]
    first, second = (float(total @ CENTRES / total.sum()) if total.sum() else np.nan for total in totals)
    found = {"sumo": first, "reference": second, "difference": wasserstein(*totals)}
    return {**found, "low": low, "high": high, "n": len(a)}


def reversed_pairs(both: pd.DataFrame, measure: str) -> tuple[dict[str, bool], int]:
    """Pairs of egos that the first simulator puts in the opposite order, among those that the second decides.

    A simulator decides a pair if the 95 % interval of its difference over scenarios excludes 0. Returns the reversed
    pairs as "one / other", each with whether the first simulator decides it too, and the number of decided ones.
    """
    tables = [
        both.pivot(index="scenario", columns="ego", values=f"{measure}_{side}").astype(float) for side in "ab"
    ]
    turned: dict[str, bool] = {}
    count = 0
    for one, other in combinations(tables[1].columns, 2):
        own, reference = ((table[one] - table[other]).dropna() for table in tables)
        if not decided(reference):
            continue
        count += 1
        if float(own.mean()) * float(reference.mean()) < 0:
            turned[f"{one} / {other}"] = decided(own)
    return turned, count


def decided(differences: pd.Series) -> bool:
    """Whether the 95 % interval of the mean excludes 0."""
    _, low, high = limits(differences, is_share=False)
    return len(differences) >= LEAST_SCENARIOS and not low <= 0 <= high


def differing(both: pd.DataFrame) -> pd.DataFrame:
    """Pairs that are not one and the same episode: another ending, length, or return (by more than 1e-3)."""
    same = (both["outcome_a"] == both["outcome_b"]) & (both["length_a"] == both["length_b"])
    close = (both["return_a"] - both["return_b"]).abs() <= 1e-3
    return both[~(same & close)]


def margin(metric: str, task: str, traffic: str, reference: float) -> float:
    """The margin in the unit of the measure; nan where it is reported without a verdict.

    Args:
        reference: highway-env's value.
    """
    judged = metric in MARGINS and (metric != "lane_changes" or (task, traffic) == ("highway", "regular"))
    value, kind = MARGINS[metric] if judged else (math.nan, "unit")
    return value * {"unit": 1.0, "reference": abs(reference), "range": sheet(task).return_range}[kind]


def difference(metric: str, both: pd.DataFrame) -> Difference:
    """How far the two simulators of `pairs` are apart in one of MEASURES."""
    if metric == "headway":
        return headway_distance(both)
    if metric == "same_outcome":  # a share of the pairs
        both = both.assign(same_outcome_a=both["crashed_a"] == both["crashed_b"], same_outcome_b=True)
    return mean_difference(both, metric)


def verdict(found: Difference, bound: float) -> str | None:
    """One of VERDICTS, or None if nothing can be said."""
    if not math.isfinite(bound) or not math.isfinite(found["difference"]) or found["n"] < LEAST_SCENARIOS:
        return None
    if abs(found["difference"]) > bound + 1e-9:
        return "missed" if found["low"] > bound or found["high"] < -bound else "not decided"
    return "equivalent" if -bound <= found["low"] and found["high"] <= bound else "within"


def level_checks(rows: pd.DataFrame, task: str, traffic: str) -> list[Check]:
    """All checks of one task, level and traffic: those with a margin first.

    Each has a metric, name, unit, ego and note, a `Difference`, its margin and verdict, and the differences of VARIANTS
    from the reference by their names.

    Args:
        rows: the episodes of all engines.
    """
    found = []

    def add(metric: str, own: Difference, **labels: Any) -> None:
        bound = margin(metric, task, traffic, own["reference"])
        labels = {"metric": metric, "name": "", "unit": "", "ego": "", "note": "", **labels}
        found.append({**labels, **own, "margin": bound, "verdict": verdict(own, bound)})

    driven = pairs(rows, SUMO, REFERENCE)
    trained = driven["ego"].isin(AGENTS)
    every = driven[~trained]
    core = every[every["ego"].isin(CORE)]
    variants = {name: pairs(rows[rows["ego"].isin(CORE)], name, REFERENCE) for name in VARIANTS}
    for metric, (name, unit) in MEASURES.items():
        beside = {of: difference(metric, own)["difference"] for of, own in variants.items() if len(own)}
        add(metric, difference(metric, core), name=name, unit=unit, **beside)
    for ego in egos(task):
        own = every[every["ego"] == ego]
        add("crashed_ego", mean_difference(own, "crashed"), name="crash rate", ego=ego)
        add("return_ego", mean_difference(own, "return"), name="return", ego=ego)
    for agent, own in driven[trained].groupby("ego"):
        add("crashed_agent", mean_difference(own, "crashed"), name="crash rate", ego=agent)
    for measure, name in (("return", "return"), ("crashed", "crash rate")):
        turned, count = reversed_pairs(every, measure)
        order: Difference = {"sumo": count - len(turned), "reference": count, "difference": -len(turned)}
        clearly = -sum(turned.values())  # by chance alone one or another pair of like egos is reversed
        order |= {"low": math.nan, "high": clearly, "n": every["scenario"].nunique()}
        labels = {"name": f"pairs of egos in the same order, by {name}", "unit": f"of {count} decided"}
        add("order", order, **labels, note=f"reversed: {', '.join(turned)}" if turned else "")
    return sorted((item for item in found if item["n"]), key=lambda item: item["verdict"] is None)


def replica_checks(table: pd.DataFrame) -> dict[str, Any]:
    """The reference against the random episodes that highway-env itself has driven again, by task."""
    sides = [f"{name}_{side}" for name in ("outcome", "length", "return") for side in "ab"]
    tasks = {}
    for task, part in pairs(table, REFERENCE, TRUTH).groupby("task", sort=False):
        others = differing(part)
        tasks[str(task)] = {
            "episodes": len(part),
            "differing": len(others),
            "verdict": "within" if len(others) / len(part) <= REPLICA else "missed",
            "exceptions": others[[*PAIR[1:], *sides]].astype(object).to_dict("records"),
        }
    return tasks


def scorecard(table: pd.DataFrame) -> list[Check]:
    """All checks, one after the other, with their task, traffic and the name of their level, as plain JSON values.

    Args:
        table: the episodes of all engines.
    """
    found = pd.DataFrame(
        {"task": task, "traffic": traffic, "level": level_names(task)[level - 1], **item}
        for (task, traffic, level), rows in table.groupby(["task", "traffic", "level"])
        for item in level_checks(rows, task, traffic)
    )
    return json.loads(found.to_json(orient="records"))  # no number is null


def summary(checks: Sequence[Check], tasks: Iterable[str]) -> dict[str, Any]:
    """What the verdict on each task says.

    Returns:
        By task: whether it passed (no check is missed); the counts of checks by verdict; how many of them are orders of
        egos, which have no interval, and in how many both simulators say 0; by name those whose estimate is outside
        of its margin; and the crash rates of trained agents, which have no margin.
    """
    keys = ("traffic", "level", "name", "ego", "sumo", "reference", "difference", "low", "high")
    result = {}
    for task in tasks:
        own = [item for item in checks if item["task"] == task]
        judged = [item for item in own if item["verdict"]]
        verdicts = [item["verdict"] for item in judged]
        outside = [item for item in judged if item["verdict"] in OUTSIDE]
        result[task] = {
            "passed": "missed" not in verdicts if judged else None,
            "counts": {word: verdicts.count(word) for word in VERDICTS},
            "orders": sum(item["metric"] == "order" for item in judged),
            "zeros": sum(item["sumo"] == item["reference"] == 0.0 for item in judged),
            "outside": [{key: item[key] for key in (*keys, "margin", "verdict", "note")} for item in outside],
            "agents": [{key: item[key] for key in keys} for item in own if item["metric"] == "crashed_agent"],
        }
    return result
