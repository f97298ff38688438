"""How each driver does by itself, before anything is compared: what the figure of crashes against speed shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.analysis import estimate
from experiments.analysis.effects import SHARES
from experiments.analysis.scores import arms_of
from experiments.study.design.traffic import TRAFFICS
from experiments.study.results.loaded import SETTING

SHOWN = ("crashed", "mean_speed")


def drivers(episodes: pd.DataFrame, policies: Sequence[str]) -> pd.DataFrame:
    """Crash rate and speed of the agents of each arm, and of policies that do not learn, in regular and risky traffic.

    Args:
        episodes: tests at home, as from `scores.with_outcomes`. policies: those without training that are shown.

    Returns:
        A row a SETTING, driver (an arm, or a policy) and traffic: crashed and mean_speed [m/s], and the ends of their
        95 % intervals over agents and scenarios, "crashed_low" and so on; NaN for one agent or a policy.
    """
    rules = episodes[(episodes["kind"] == "baseline") & episodes["policy"].isin([*policies])]
    agents = episodes[episodes["kind"] == "agent"]
    everybody = pd.concat([agents, rules.assign(arm=rules["policy"], seed=0)])
    rows: list[dict[str, Any]] = []
    for setting, arms in arms_of(everybody, SHOWN).items():
        for driver, outcomes in arms.items():
            for place, traffic in enumerate(TRAFFICS):
                row = {**dict(zip(SETTING, setting, strict=True)), "driver": driver, "traffic": traffic}
                for name in SHOWN:
                    row |= _with_ends(name, outcomes[name][place])
                rows.append(row)
    return pd.DataFrame(rows)


def _with_ends(name: str, scores: estimate.Scores) -> dict[str, float]:
    """The mean of an outcome and the ends of its interval. scores: of agents and scenarios."""
    floor = estimate.binomial_floor(scores[np.newaxis]) if name in SHARES else 0.0
    found = estimate.interval(estimate.linear([(scores, 1.0)], floor))
    return {name: found.estimate, f"{name}_low": float(found.low), f"{name}_high": float(found.high)}
