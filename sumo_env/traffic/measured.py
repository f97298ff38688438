"""Measured drivers: published distributions in the place of highway-env's numbers, without risk.

docs/developers/measured_drivers.md has the sources, what was read of them, and what no source gives.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import inf
from statistics import NormalDist
from typing import NamedTuple

from sumo_env.traffic.drivers import POOL, Calibration, Driver, quantiles
from sumo_env.traffic.scenario import Scenario


class Normal(NamedTuple):
    """A normal distribution between drivers; drivers beyond a limit are set to it."""

    mean: float
    deviation: float = 0.0
    low: float = -inf
    high: float = inf

    def at(self, share: float) -> float:
        """The value that this share of drivers is below."""
        if not self.deviation:
            return self.mean
        return min(max(NormalDist(self.mean, self.deviation).inv_cdf(share), self.low), self.high)


# 1,000 drivers on highways of Ann Arbor (Kusari et al., arXiv 2109.11620); the deviation of `DECEL` is from a figure
TAU = Normal(1.96, 0.60, 0.5, 3.7)  # [s]
ACCEL = Normal(1.19, 0.26, 0.4, 2.0)  # [m/s2]
DECEL = Normal(1.9, 0.6, 0.5, 3.7)  # [m/s2]
DELTA = Normal(3.99, 0.32, 3.0, 5.0)
MIN_GAP = 3.65  # [m] highD's mean driver (Zhang and Sun, arXiv 2210.03571)
# [m/s2] middle of 1.5 to 2, which published studies call comfortable (review by C. Murdoch, hawkins.biz)
FROM_REST = Normal(1.75)
# [s] passenger cars on minor roads with a stop sign: half of the drivers take 6.5 s, 85 % take 8.25 s (Fitzpatrick,
# Transportation Research Record 1303, 1991). Below 4.5 s others would have to stop.
STOP_SIGN = Normal(6.5, 1.69, 4.5, 10.5)
ROUNDABOUT = Normal(4.0)  # [s] middle of 3.3 to 4.7, by method (J. Adv. Transp. 2018, 2726732)
EMERGENCY_DECEL = 6.0  # [m/s2] highway-env's: no source


class MeasuredPool(NamedTuple):
    """The drivers of a task as they were measured, in the place of its `DriverPool`.

    Attributes:
        accel: [m/s2].
        critical_gap: the smallest one that a driver takes who has to give way [s]; None on roads without a crossing.
        crossing: the part of it that SUMO's estimate of the crossing takes [s] (tests/sumo_env/traffic/test_measured.py
            measures it); jmTimegapMinor is the rest.
    """

    accel: Normal = ACCEL
    critical_gap: Normal | None = None
    crossing: float = 0.0

    @property
    @lru_cache(maxsize=64)  # noqa: B019 (a pool is a value)
    def drivers(self) -> tuple[Driver, ...]:
        """The drivers: of each parameter one value in each of POOL equal parts, independent of the others."""

        def driver(k: int) -> Driver:
            def drawn(name: str, law: Normal) -> float:
                return law.at(float(quantiles(name)[k]))

            gap = self.critical_gap and drawn("critical_gap", self.critical_gap) - self.crossing
            return Driver(
                type=f"measured{k}",
                delta=drawn("delta", DELTA),
                accel=drawn("accel", self.accel),
                decel=drawn("decel", DECEL),
                tau=drawn("tau", TAU),
                min_gap=MIN_GAP,
                emergency_decel=EMERGENCY_DECEL,
                attributes=() if gap is None else (("jmTimegapMinor", f"{gap:.6f}"),),
            )

        return tuple(map(driver, range(POOL)))

    def driving(self, scenario: Scenario) -> Scenario:
        """The scenario with the drivers of the same numbers, uncalibrated; drivers of no pool stay."""
        number = {driver.type: k for pool in scenario.pools for k, driver in enumerate(pool.drivers)}
        calibration = Calibration(lane_changes=scenario.calibration.lane_changes)
        drawn = scenario.with_drivers(
            lambda own: self.drivers[number[own.type]] if own.type in number else own
        )
        return replace(drawn, calibration=calibration, pools=())
