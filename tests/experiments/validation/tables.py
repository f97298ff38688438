"""Tables of episodes that nobody drove."""

from typing import Any

import numpy as np
import pandas as pd

from experiments.validation.checks import REFERENCE
from experiments.validation.episodes import HEADWAYS, egos


def episodes(
    engine: str, task: str = "u-turn", level: int = 1, traffic: str = "regular", n: int = 40, **changes: Any
):
    """Episodes of every ego in `n` scenarios; `changes`: column -> value, or a function of ego and scenario."""
    rows = []
    for number, ego in enumerate(egos(task)):
        for scenario in range(n):
            rng = np.random.default_rng([scenario, number])
            crashed = bool(rng.random() < 0.1 + 0.1 * number)
            row = {"engine": engine, "task": task, "level": level, "traffic": traffic, "ego": ego}
            row |= {"scenario": scenario, "return": 5.0 + rng.normal(), "length": 10}
            row |= {"crashed": crashed, "outcome": "crashed" if crashed else "time"}
            row |= {"crash_time": 4.0 if crashed else np.nan, "ego_speed": 10.0, "density": 3.0}
            row |= {"traffic_speed": 10.0 + rng.normal(), "lane_changes": 1.0 + 0.1 * rng.normal()}
            row |= dict.fromkeys(HEADWAYS, 1)
            for name, value in changes.items():
                row[name] = value(ego, scenario) if callable(value) else value
            rows.append(row)
    return pd.DataFrame(rows)


def compared(task: str = "u-turn", **changes: Any) -> pd.DataFrame:
    """The reference beside a simulator named "sumo" that differs from it by `changes`."""
    return pd.concat([episodes("sumo", task, **changes), episodes(REFERENCE, task)], ignore_index=True)
