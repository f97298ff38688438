"""How each driver does by itself, before anything is compared: what the figure of crashes against speed shows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from experiments.analysis import estimate
from experiments.analysis.effects import SHARES
from experiments.analysis.scores import arms_of
from experiments.study.design.traffic import TRAFFICS
from experiments.study.results.loaded import SETTING

SHOWN = ("crashed", "mean_speed")


def drivers(episodes: pd.DataFrame) -> pd.DataFrame:
    """Crash rate and speed of the agents of each arm, and of policies that do not learn, in regular and risky traffic.

    Args:
        episodes: as from `scores.with_outcomes`.

    Returns:
        A row a SETTING, driver (an arm, or a policy) and traffic: crashed and mean_speed [m/s], and the ends of their
        95 % intervals over agents and scenarios, "crashed_low" and so on; NaN for one agent or a policy.
    """
    rules = episodes[episodes["kind"] == "baseline"]
    agents = episodes[episodes["kind"] == "agent"]
    everybody = pd.concat([agents, rules.assign(arm=rules["policy"], seed=0)])
    ends = [f"{name}{end}" for name in SHOWN for end in ("", "_low", "_high")]
    rows: list[dict[str, Any]] = []
    for setting, arms in arms_of(everybody, SHOWN).items():
        for driver, outcomes in arms.items():
            for place, traffic in enumerate(TRAFFICS):
                row = {**dict(zip(SETTING, setting, strict=True)), "driver": driver, "traffic": traffic}
                for name in SHOWN:
                    row |= _with_ends(name, outcomes[name][place])
                rows.append(row)
    return pd.DataFrame(rows, columns=[*SETTING, "driver", "traffic", *ends])


def _with_ends(name: str, scores: estimate.Scores) -> dict[str, float]:
    """The mean of an outcome and the ends of its interval. scores: of agents and scenarios."""
    floor = estimate.binomial_floor(scores[np.newaxis]) if name in SHARES else 0.0
    found = estimate.interval(estimate.linear([(scores, 1.0)], floor))
    return {name: found.estimate, f"{name}_low": float(found.low), f"{name}_high": float(found.high)}


def hazards(drives: pd.DataFrame) -> pd.DataFrame:
    """Of each agent's drives (rows: cell) still on the road, the share that crashes in each second (columns).

    drives: test episodes as from `scores.with_outcomes`; NaN where an agent has none left.
    """
    second = np.ceil(drives["crash_free_time"]).clip(lower=1).astype(int)
    seconds = range(1, second.max() + 1)
    ending = pd.crosstab(drives["cell"], second).reindex(columns=seconds, fill_value=0)
    crashing = pd.crosstab(drives["cell"], second, drives["crashed"], aggfunc="sum")
    driving = ending.iloc[:, ::-1].cumsum(axis=1).iloc[:, ::-1]
    return crashing.reindex(columns=seconds).fillna(0.0) / driving.where(driving > 0)
