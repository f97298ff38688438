"""Power of the two tests of the fourth plan, from the variances of the second study: ``python docs/power_v4.py``.

Pairs of agents are drawn as scores (pairs, scenarios) = mean + pair + scenario + rest, all normal, and go through the
analysis of the study (`experiments.analysis.estimate`). The belief pairs have the variances of `mixed`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments.analysis import estimate
from experiments.analysis.analysis import own_agents
from experiments.analysis.scores import arms_of, with_outcomes
from experiments.study.design.arms import TRAFFICS
from experiments.study.results.store import load

STUDY = Path(__file__).resolve().parents[1] / "results" / "second"
RUNS = 2000
# Traffic: the control of belief pairs, the margin, and true differences [points]
TESTS = {
    "risky": ("treatment", 5.0, (0.0, 2.5, 3.5, 5.0, 5.5)),
    "regular": ("control", 2.5, (-0.4, 0.0, 1.25, 2.5)),
}


class Case(NamedTuple):
    """What is assumed of the pairs, and how many there are.

    share: variance between pairs in that between agents. correlation: of a belief pair with its control pair, which
    share an agent. by_pair: whether the analysis compares a belief pair with its control pair. fewer: the number of
    pairs of a task where it is another.
    """

    share: float = 1.0
    correlation: float = 0.0
    pairs: int = 5
    scenarios: int = 400
    by_pair: bool = False
    fewer: Mapping[str, int] = {}


CASES = (
    Case(),
    Case(share=0.5),
    Case(share=0.5, correlation=0.5, by_pair=True),
    Case(share=4.0),
    Case(scenarios=800),
    Case(scenarios=800, by_pair=True),
    Case(scenarios=800, by_pair=True, fewer={"two-way": 4}),
    Case(share=0.5, correlation=0.5, scenarios=800, by_pair=True),
    Case(pairs=10),
)


class Parts(NamedTuple):
    """Variances [points^2] of two arms in a setting: between agents, between scenarios (2 x 2), and the rest."""

    agents: np.ndarray
    scenarios: np.ndarray
    rest: np.ndarray


def parts(arms: tuple[np.ndarray, np.ndarray]) -> Parts:
    """Two-way random effects, as in `estimate.linear`; negative values become 0."""
    columns = np.cov([scores.mean(axis=0) for scores in arms])
    rest = [
        ((s - s.mean(1, keepdims=True) - s.mean(0) + s.mean()) ** 2).sum() / ((len(s) - 1) * (s.shape[1] - 1))
        for s in arms
    ]
    agents = [max(s.mean(1).var(ddof=1) - r / s.shape[1], 0.0) for s, r in zip(arms, rest, strict=True)]
    noise = np.diag([r / len(s) for s, r in zip(arms, rest, strict=True)])
    values, vectors = np.linalg.eigh(columns - noise)
    return Parts(np.array(agents), vectors * values.clip(min=0) @ vectors.T, np.array(rest))


def drawn(p: Parts, case: Case, rng: np.random.Generator) -> np.ndarray:
    """Scores (arm, pair, scenario) of two arms without a difference."""
    alike = np.array([[1.0, case.correlation], [case.correlation, 1.0]])
    between = case.share * np.sqrt(np.outer(p.agents, p.agents)) * alike
    pair = rng.multivariate_normal(np.zeros(2), between, case.pairs, method="eigh").T[:, :, None]
    scenario = rng.multivariate_normal(np.zeros(2), p.scenarios, case.scenarios, method="eigh").T[:, None]
    return pair + scenario + rng.normal(size=(2, case.pairs, case.scenarios)) * np.sqrt(p.rest)[:, None, None]


def simulated(settings: dict[str, Parts], case: Case) -> pd.DataFrame:
    """The estimates of RUNS studies whose true difference is 0, one a row."""
    rng, rows = np.random.default_rng(0), []
    for run in range(RUNS):
        for task, p in settings.items():
            first, second = drawn(p, case._replace(pairs=case.fewer.get(task, case.pairs)), rng)
            weighted = [(first - second, 1.0)] if case.by_pair else [(first, 1.0), (second, -1.0)]
            rows.append({"run": run, "task": task, **estimate.linear(weighted)._asdict()})
    frame = pd.DataFrame(rows)
    return estimate.combine(frame, ["run"], estimate.equal_task_weights(frame, ["run"]))


def main() -> None:
    """Print the variances and the power."""
    arms = arms_of(own_agents(with_outcomes(load(STUDY))))
    lightest = {place[1]: by_name for place, by_name in arms.items() if place[2] == 1}
    for traffic, (against, margin, truths) in TESTS.items():
        at = list(TRAFFICS).index(traffic)
        tables = {
            task: tuple(100 * by_name[arm]["crashed"][at] for arm in ("mixed", against))
            for task, by_name in lightest.items()
        }
        settings = {task: parts(pair) for task, pair in tables.items()}
        print(f"\n{traffic}: belief (as mixed) minus {against}, margin {margin} points")
        print("mean of each; SD between agents, between scenarios, their correlation, SD of the rest")
        for task, p in settings.items():
            deviations = np.sqrt(np.diag(p.scenarios))
            r = p.scenarios[0, 1] / deviations.prod()
            means = [round(float(t.mean()), 1) for t in tables[task]]
            agents, rest = np.sqrt(p.agents).round(1), np.sqrt(p.rest).round(1)
            print(f"  {task:13}", means, agents, deviations.round(1), f"{r:.2f}", rest)
        for case in CASES:
            found = simulated(settings, case)
            limit = found["estimate"] + stats.t.ppf(0.95, found["df"]) * found["se"]
            power = {truth: round(float((limit + truth < margin).mean()), 2) for truth in truths}
            most = margin - limit.quantile(0.8)  # true difference with a power of .8
            print(f"  {case}:\n    SD {found['estimate'].std():.2f}, se {found['se'].mean():.2f},", end=" ")
            print(f"df {found['df'].median():.0f}, power {power}, .8 up to {most:.1f}")


if __name__ == "__main__":
    main()
