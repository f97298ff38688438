"""Power of plan 6, before its first cell.

    python -m tests.experiments.analysis.power [REPEATS]

The ten effects on the crash rate have the standard errors of plan 5's agents at each task's lightest setting (five an
arm, 400 scenarios, `results/plan_v5.csv`). Caution and skill are drawn as in `test_takeover.drawn`: five pairs, 200
scenarios, agents of an arm that differ by a standard deviation, or are of two kinds. Those of the new agents are not
known.
"""

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import optimize, stats

from experiments.analysis import estimate, takeover
from experiments.analysis.plan import ALPHA, LIGHTEST
from tests.experiments.analysis.test_takeover import drawn

STORED = Path(__file__).resolve().parents[3] / "results" / "plan_v5.csv"
TEN = len(LIGHTEST) * 2
DANGER, CRASH = 0.5, 0.45  # of control agents: episodes in danger, and crashes from the moments
OTHER_KIND = 0.3  # by which half of an arm's agents are in danger less often, in the worlds with two kinds


def of_crashes() -> pd.DataFrame:
    """By task and traffic the effect [points] that 8 of 10 studies find, at Holm's first step and at its last."""
    rows = pd.read_csv(STORED)
    rows = rows[(rows["outcome"] == "crashed") & rows["scope"].isin([f"{t}-{name}" for t, name in LIGHTEST])]
    lines = []
    for row in rows.itertuples():
        half = (row.high - row.low) / 2

        def wrong(df: float, row=row, half=half) -> float:
            return 2 * stats.t.sf(abs(row.difference) / half * stats.t.ppf(1 - ALPHA / 2, df), df) - row.p

        ends = [wrong(df) for df in (2.0, 1000.0)]
        df = optimize.brentq(wrong, 2.0, 1000.0) if ends[0] * ends[1] < 0 else 8.0
        se = half / stats.t.ppf(1 - ALPHA / 2, df)
        line = {"setting": row.scope, "traffic": row.traffic, "se": 100 * se, "df": df}
        steps = {"first step": ALPHA / TEN, "last step": ALPHA}
        lines.append(line | {name: 100 * estimate.detectable(se, df, at) for name, at in steps.items()})
    return pd.DataFrame(lines)


def agent(
    rng: np.random.Generator, danger: float, crash: float, spread: float, two_kinds: bool = False
) -> dict[str, float]:
    """Of an agent: how often it gets into danger, and how often it crashes from there."""
    away = OTHER_KIND * (rng.random() < 0.5) if two_kinds else 0.0
    found = {"danger": rng.normal(danger - away, spread), "crash": rng.normal(crash, spread)}
    return {name: float(np.clip(value, 0.01, 0.99)) for name, value in found.items()}


def of_moments(repeats: int) -> pd.DataFrame:
    """By true difference (of both), spread of agents and kinds: shares of studies that find caution and skill, at
    Holm's first step and at its last."""
    lines = []
    worlds = [(spread, False) for spread in (0.03, 0.08)] + [(0.03, True)]
    for spread, two_kinds in worlds:
        for difference in (0.0, 0.1, 0.2, 0.3):
            control = partial(agent, danger=DANGER, crash=CRASH, spread=spread, two_kinds=two_kinds)
            treated = partial(
                agent,
                danger=DANGER - difference,
                crash=CRASH - difference,
                spread=spread,
                two_kinds=two_kinds,
            )
            rng = np.random.default_rng(6)
            p = pd.DataFrame(
                takeover.answers(drawn(rng, (control, treated), scenarios=200)).set_index("question")["p"]
                for _ in range(repeats)
            )
            line = {"spread": spread, "two kinds": two_kinds, "difference": difference}
            for question in (takeover.CAUTION, takeover.SKILL):
                for name, at in (("first", ALPHA / takeover.FAMILY), ("last", ALPHA)):
                    line[f"{question}, {name}"] = (p[question] < at).mean()
            lines.append(line)
    return pd.DataFrame(lines)


if __name__ == "__main__":
    print(of_crashes().to_string(index=False, float_format="%.1f"))
    print(of_moments(int(sys.argv[1]) if len(sys.argv) > 1 else 200).to_string(index=False))
