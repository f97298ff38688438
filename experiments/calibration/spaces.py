"""What calibration may change, by task: fields of `Calibration` (SUMO's drivers) and of `RiskRates` (risk events)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Range:
    """A number between two bounds; `log`: searched on a logarithmic scale."""

    low: float
    high: float
    log: bool = False


Space = dict[str, Range | tuple[bool, ...]]

SHARE = Range(0.0, 1.0)
# Car following is not searched: with highway-env's own numbers for IDM, nothing was gained by it on other scenarios.
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
    },
    "u-turn": {"lane_changes": (False, True), "assertive": Range(0.5, 1.3)},
}
RISK: dict[str, Space] = {
    "highway": {"cut_in": Range(0.0, 0.1), "brake": Range(0.0, 0.1)},
    "two-way": {"cut_in": Range(0.0, 0.03), "brake": Range(0.0, 0.4)},
    "roundabout": {"brake": Range(0.0, 0.3), "surge": Range(0.0, 0.6), "cut_in": Range(0.0, 0.3)},
    "intersection": {"surge": Range(0.0, 0.5), "brake": Range(0.0, 0.3)},
    "u-turn": {"cut_in": Range(0.0, 0.6), "brake": Range(0.0, 0.3)},
}
