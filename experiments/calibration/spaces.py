"""What calibration may change, by task: fields of `Calibration` (SUMO's drivers), `RiskRates` and `RiskRanges` (risk).

Of a range of factors, the lower end is searched; the upper end stays as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from sumo_env.tasks.base import Task


@dataclass(frozen=True)
class Range:
    """A number between two bounds; `log`: searched on a logarithmic scale."""

    low: float
    high: float
    log: bool = False


Space = dict[str, Range | tuple[bool, ...]]

SHARE = Range(0.0, 1.0)
FACTOR = Range(0.1, 1.0)  # of the regular value
# Of car following only the time gap at the intersection is searched: elsewhere nothing was gained by changes of
# highway-env's own numbers for IDM on other scenarios.
DRIVERS: dict[str, Space] = {
    "highway": {
        "speed_gain": Range(2.0, 150.0, log=True),
        "speed_gain_lookahead": Range(0.0, 40.0),
        "assertive": Range(0.5, 1.3),
    },
    "two-way": {},  # drivers keep their lane and nobody crosses: nothing to choose
    "roundabout": {
        "lane_changes": (False, True),
        "waits_for_approaching": (False, True),
        "ignores_approaching": SHARE,
        "ignores_inside": SHARE,
    },
    "intersection": {
        "waits_for_approaching": (False, True),
        "ignores_approaching": SHARE,
        "ignores_inside": SHARE,
        "tau": Range(0.8, 1.6),
    },
    "u-turn": {"lane_changes": (False, True), "assertive": Range(0.5, 1.3)},
}
RISK: dict[str, Space] = {
    "highway": {"cut_in": Range(0.0, 0.1), "brake": Range(0.0, 0.1)},
    "two-way": {"cut_in": Range(0.0, 0.03), "brake": Range(0.0, 0.4)},
    "roundabout": {
        "brake": Range(0.0, 0.3),
        "surge": Range(0.0, 0.6),
        "cut_in": Range(0.0, 0.3),
        "tau": FACTOR,
        "min_gap": FACTOR,
        "not_giving_way": SHARE,
    },
    "intersection": {
        "surge": Range(0.0, 0.5),
        "brake": Range(0.0, 0.3),
        "tau": FACTOR,
        "min_gap": FACTOR,
        "decel": FACTOR,
        "not_giving_way": SHARE,
    },
    "u-turn": {
        "cut_in": Range(0.0, 0.6),
        "brake": Range(0.0, 0.3),
        "tau": FACTOR,
        "min_gap": FACTOR,
        "decel": FACTOR,
    },
}


def present_risk(task: Task) -> dict[str, Any]:
    """Rates of events and ranges of parameters that are in force; of a range, its lower end."""
    ranges = asdict(task.risk_ranges)
    lower = {name: value[0] if isinstance(value, tuple) else value for name, value in ranges.items()}
    return {**asdict(task.risk_rates), **lower}


def changes_of_risk(task: Task, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a search as an engine takes them: a lower end becomes a range up to the present upper end."""
    present = asdict(task.risk_ranges)
    return {
        name: (value, present[name][1]) if isinstance(present.get(name), tuple) else value
        for name, value in settings.items()
    }
