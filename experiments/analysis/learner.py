"""Checks of the learner before anything is compared: has it finished, did it learn, does it know when a test ends?

What fails is reported beside the effects and excludes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from experiments.analysis.estimate import DEGENERATE, OK, Estimate, Mean, combine, interval, linear
from experiments.analysis.plan import ALPHA, Learner

COLUMNS = ["backend", "check", "task", "arm", "agents", "estimate", "low", "high", "least", "most", "passed"]


def learner_checks(
    cells: Mapping[str, Mapping[str, Any]],
    passed: pd.DataFrame,
    agents: pd.DataFrame,
    rules: Learner,
    arms: Sequence[str],
) -> pd.DataFrame:
    """What the plan asks of the learner, of all agents of some arms.

    Args:
        cells: cell.json by name. passed: from `gates.gates`. agents: the test episodes of trained agents, from
            `scores.with_outcomes`.

    Returns:
        A row a check: backend, check, task and arm (empty: all), agents, estimate, low and high (95 % interval, where
        there is one), least and most (what it has to lie between), and passed (None where the interval leaves it open):
        "change": of the training return over the last quarter of the budget, in units of its range, tasks alike;
        "diverged": agents whose values do; "gates": share of the agents that pass all;
        "last second": its rate of crashes over that of the seconds before.
    """
    rows: list[list[Any]] = []
    passed = passed[passed["arm"].isin(arms)]
    for backend, own in passed.groupby("backend", sort=False):
        for arm in arms:
            trained = [cells[name] for name in own.loc[own["arm"] == arm, "cell"]]
            if trained:
                found, most = change(trained, rules), rules.change
                inside = -most <= found.low and found.high <= most
                outside = found.low > most or found.high < -most
                verdict = True if inside else False if outside else None
                rows.append([backend, "change", "", arm, len(trained), *_limits(found), -most, most, verdict])
        bad = int((own["q_bounded"].astype(object) == False).sum())  # noqa: E712
        rows.append([backend, "diverged", "", "", len(own), bad, np.nan, np.nan, 0, 0, bad == 0])
        share = float((own["passed"].astype(object) == True).mean())  # noqa: E712
        sound = share >= rules.passing
        rows.append([backend, "gates", "", "", len(own), share, np.nan, np.nan, rules.passing, 1, sound])
        tests = agents[(agents["backend"] == backend) & agents["arm"].isin(arms)]
        for (task, arm), drives in tests.groupby(["task", "arm"], sort=False):
            if task in rules.clocked:
                found = last_second(drives, rules.before)
                number = drives["cell"].nunique()
                alike = bool(found.low <= 1 <= found.high) if found.status == OK else None
                rows.append([backend, "last second", task, arm, number, *_limits(found), 1, 1, alike])
    return pd.DataFrame(rows, columns=COLUMNS)


def _limits(found: Estimate) -> list[float]:
    return [found.estimate, found.low, found.high]


def change(trained: Sequence[Mapping[str, Any]], rules: Learner) -> Estimate:
    """Change of the training return over the last quarter of the budget, in units of its range, tasks alike.

    Of each agent the mean over the last tenth of its learning curve, minus that over the tenth before three quarters.

    Args:
        trained: cell.json of the agents of an arm.
    """
    settings: dict[str, dict[int, list[list[float]]]] = {}
    for cell in trained:
        key, curve = cell["key"], cell["learner"]["curve"]["return"]
        tenth, quarter = len(curve) // 10, 3 * len(curve) // 4
        late, early = (
            np.array(part, dtype=float) for part in (curve[-tenth:], curve[quarter - tenth : quarter])
        )
        difference = float(
            np.nanmean(late) - np.nanmean(early)
        )  # a part in which no episode ended has no return
        by_level = settings.setdefault(key["task"], {})
        by_level.setdefault(key["level"], []).append([difference / rules.ranges[key["task"]]])
    tasks = [
        _alike([linear([(np.array(scores), 1.0)]) for scores in by_level.values()])
        for by_level in settings.values()
    ]
    return interval(_alike(tasks))


def _alike(means: Sequence[Mean]) -> Mean:
    return combine(means, [1 / len(means)] * len(means))


def last_second(drives: pd.DataFrame, before: float) -> Estimate:
    """Rate of crashes per second driven in the last second of a test, over that in so many seconds before it.

    The interval of the ratio's logarithm has the variance between agents, and at least that of so few crashes that
    happen independently; half a crash is added to both counts. Degenerate where nobody drives so long.

    Args:
        drives: test episodes of one arm. before: [s].
    """
    end, time = drives["seconds"], drives["crash_free_time"]
    counts = {}
    for name, begin, until in (("last", end - 1, end), ("before", end - 1 - before, end - 1)):
        counts[name] = (drives["crashed"] > 0) & (time > begin) & (time <= until)
        counts[f"{name} driven"] = (time.clip(upper=until) - begin).clip(lower=0)
    agents = pd.DataFrame(counts).groupby(drives["cell"]).sum().astype(float)
    total = agents.sum()
    if not (total["last driven"] and total["before driven"]):
        return Estimate(np.nan, DEGENERATE)
    sides = [(agents[name], agents[f"{name} driven"], total[name] + 0.5) for name in ("last", "before")]
    rates = [crashes / driven.sum() for _, driven, crashes in sides]
    parts = [(own - rate * driven) / n for (own, driven, n), rate in zip(sides, rates, strict=True)]
    number = len(agents)
    between = float(((parts[0] - parts[1]) ** 2).sum()) * number / max(number - 1, 1)
    least = sum(1 / n for *_, n in sides)
    half = float(stats.t.ppf(1 - ALPHA / 2, max(number - 1, 1)) * np.sqrt(max(between, least)))
    ratio = rates[0] / rates[1]
    return Estimate(ratio, OK, low=float(ratio * np.exp(-half)), high=float(ratio * np.exp(half)))
