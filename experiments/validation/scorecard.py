"""The checks of a task and level: measured difference against margin, with what highway-env differs from itself by."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from experiments.study.grid import TRAFFICS, level_names
from experiments.validation import compare
from experiments.validation.episodes import MEASURES, policies
from experiments.validation.jobs import CONNECTED, MATCHED, NATIVE, NOISE, PATH, V0
from experiments.validation.margins import EPISODES, REASON_WITHOUT, RETURN_RANGE, Margin

if TYPE_CHECKING:
    import pandas as pd

LEAST_SCENARIOS = 3  # with fewer, a level gets no verdict
UNITS = {
    "return": "", "crashed": "share", "length": "steps", "arrived": "share", "ego_speed": "m/s",
    "traffic_speed": "m/s", "headway": "s", "gap": "m", "ego_headway": "s", "lane_changes": "1/vehicle-minute",
    "density": "vehicles", "min_ttc": "s", "near_misses": "steps",
}  # fmt: skip
Check = dict[str, Any]


def check(
    name: str,
    metric: str,
    difference: compare.Difference,
    *,
    level: str,
    traffic: str = "regular",
    unit: str = "",
    margin: Margin | None = None,
    bound: float | None = None,
    noise: float | None = None,
    variants: Mapping[str, float | None] | None = None,
    one_sided: bool = False,
    least: int = 1,
) -> Check:
    """One line of the scorecard, plain JSON values.

    Args:
        bound: the margin in the difference's own unit (default: the margin's value).
        noise: what highway-env at 10 Hz differs by from itself at 15 Hz.
        variants: the value of highway-env's other variants.
        one_sided: only a negative difference can miss.
        least: with fewer units than this there is no verdict.
    """
    limit = None if margin is None else margin.value if bound is None else bound
    low, high = difference.low, difference.high
    passed = equivalent = None
    if limit is not None and math.isfinite(difference.difference) and difference.n >= least:
        worst = -difference.difference if one_sided else abs(difference.difference)
        passed = worst <= limit + 1e-9
        if low is not None and high is not None:
            equivalent = low >= -limit and (one_sided or high <= limit)
    return {
        "name": name,
        "metric": metric,
        "level": level,
        "traffic": traffic,
        "unit": unit,
        "sumo": finite(difference.first),
        "highway_env": finite(difference.second),
        "difference": finite(difference.difference),
        "low": finite(low),
        "high": finite(high),
        "margin": finite(limit),
        "noise_floor": finite(noise),
        "n": difference.n,
        "passed": passed,
        "equivalent": equivalent,
        **{name: finite((variants or {}).get(name)) for name in (CONNECTED.name, V0.name)},
        "reason": REASON_WITHOUT if margin is None else margin.reason,
    }


def finite(value: float | None) -> float | None:
    """The number to six digits; None for nan, inf and None, which JSON has no words for."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.6g}")


def episode_checks(table: pd.DataFrame, task: str, level: int, traffic: str, model: str) -> list[Check]:
    """Everything measured in the episodes of a level: targets first, then what is shown without one.

    Args:
        table: episodes of all engines.
        model: "matched" (with targets in regular traffic) or "sumo".
    """
    own = (MATCHED if model == "matched" else NATIVE).name
    rows = table[(table["task"] == task) & (table["level"] == level) & (table["traffic"] == traffic)]
    both = compare.pairs(rows, own, PATH.name)
    if not len(both):
        return []
    noise = compare.pairs(rows, NOISE.name, PATH.name)
    others = {engine.name: rows[rows["engine"] == engine.name] for engine in (CONNECTED, V0)}
    targets = EPISODES if model == "matched" and traffic == "regular" else {}
    name_of_level = level_names(task)[level - 1]
    common: Any = {"level": name_of_level, "traffic": traffic}

    def line(
        name: str, measure: str, part: pd.DataFrame, floor: pd.DataFrame, margin: Margin | None
    ) -> Check:
        found = compare.mean_difference(part, measure)
        bound = None
        if margin is not None and measure == "return":
            bound = margin.value * RETURN_RANGE[task]
        elif margin is not None and margin.relative:
            bound = margin.value * abs(found.second)
        floors = compare.mean_difference(floor, measure).difference if len(floor) else None
        # the variants were driven in fewer scenarios: what they differ by there, added to the reference's mean
        values = {name: _variant(part, other, measure, found.second) for name, other in others.items()}
        return check(
            name, measure, found, unit=UNITS[measure], margin=margin, bound=bound, noise=floors, variants=values,
            least=LEAST_SCENARIOS, **common,
        )  # fmt: skip

    checks = [
        line(name, name, both, noise, targets.get(name)) for name in ("return", "crashed", "traffic_speed")
    ]
    distance = compare.headway_distance(both)
    margin = targets.get("headway")
    checks.append(
        check(
            "headway distribution",
            "wasserstein",
            distance,
            unit="s",
            margin=margin,
            bound=None if margin is None else margin.value * distance.second,
            noise=compare.headway_distance(noise).difference if len(noise) else None,
            least=LEAST_SCENARIOS,
            **common,
        )
    )
    checks += _outcome_checks(both, noise, targets, common)
    checks += [
        line(m, m, both, noise, None) for m in MEASURES if m not in ("return", "crashed", "traffic_speed")
    ]
    for policy in policies(task):
        part, floor = both[both["policy"] == policy], noise[noise["policy"] == policy]
        checks += [
            line(f"{measure}, {policy}", measure, part, floor, None) for measure in ("return", "crashed")
        ]
    return [item for item in checks if item["difference"] is not None]


def _variant(part: pd.DataFrame, other: pd.DataFrame, measure: str, reference: float) -> float | None:
    if not len(other):
        return None
    columns = other[[*compare.PAIR, measure]].astype({measure: float})
    joined = part[[*compare.PAIR, f"{measure}_b"]].merge(columns, on=compare.PAIR)
    return float(reference + (joined[measure] - joined[f"{measure}_b"].astype(float)).mean())


def _outcome_checks(
    both: pd.DataFrame, noise: pd.DataFrame, targets: Mapping[str, Margin], common: Any
) -> list[Check]:
    """Same crash outcome, episode by episode; and the order of the egos."""
    share, (low, high) = compare.agreement(both)
    floor = compare.agreement(noise)[0] if len(noise) else None
    shift = floor if floor is not None else 1.0
    found = compare.Difference(
        share, shift, share - shift,
        None if low is None else low - shift, None if high is None else high - shift, both["scenario"].nunique(),
    )  # fmt: skip
    target = targets.get("agreement") if floor is not None else None
    checks = [
        check("same crash outcome", "agreement", found, unit="share", margin=target, noise=floor, one_sided=True,
              least=LEAST_SCENARIOS, **common)
    ]  # fmt: skip
    for measure in ("return", "crashed"):
        share, decided = compare.order(both, measure)
        found = compare.Difference(share, 1.0, share - 1.0, None, None, decided)
        checks.append(
            check(f"order of the egos by {measure}", "order", found, unit="share", margin=targets.get("order"),
                  **common)
        )  # fmt: skip
    return checks


def passed(checks: Sequence[Check]) -> bool | None:
    """Whether no check missed its margin; None where none has one."""
    verdicts = [item["passed"] for item in checks if item["passed"] is not None]
    return all(verdicts) if verdicts else None


def task_record(
    table: pd.DataFrame, task: str, dynamics: Sequence[Check], changes: Mapping[str, Sequence[Check]]
) -> dict[str, Any]:
    """All checks of a task, and whether it passed.

    Args:
        dynamics: checks of scenes of few vehicles.
        changes: checks of lane-change decisions by level name.
    """
    levels: dict[str, Any] = {}
    for number, name in enumerate(level_names(task), start=1):
        checks = episode_checks(table, task, number, "regular", "matched") + list(changes.get(name, ()))
        if not checks:
            continue
        levels[name] = {
            "passed": passed(checks),
            "checks": checks,
            "risky": episode_checks(table, task, number, "risky", "matched"),
            "sumo_model": {
                traffic: episode_checks(table, task, number, traffic, "sumo") for traffic in TRAFFICS
            },
        }
    every = [item for level in levels.values() for item in level["checks"]] + list(dynamics)
    return {
        "passed": passed(every),
        "dynamics": {"passed": passed(dynamics), "checks": list(dynamics)},
        "levels": levels,
    }
