"""Measured drivers: published distributions in the place of highway-env's numbers, without risk.

Each number below has its source, and in brackets what was read of it. A driver's parameters are drawn independently.
No source gives the spread of critical gaps at roundabouts and of accelerations from rest, laws for two-way roads and
bends (the highway's are used), and the share of drivers that do not give way. On the highway lane changes are SUMO's
LC2013 without calibration: at 22.5 m/s drivers change lanes 0.30 times a minute (16 commuters, Virginia Tech: one in
4.44 km) or 0.17 times (highD, Krajewski et al. 2018: one in 8.0 km) [abstracts].

A vehicle crosses ahead of another one that arrives more than jmTimegapMinor after it has left. SUMO's IDM overestimates
the time of the crossing (8.4 s from rest at the intersection), so jmTimegapMinor is the critical gap less this time.
"""

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


# 1,000 drivers on highways of Ann Arbor: Kusari et al., arXiv 2109.11620 [data: highway-1000.rou.xml of
# arpan-kusari/Naturalistic-SUMO-Gym; `DECEL` a figure: mode 1.8, 0 to 3.7]. Their `TAU` was fitted with a gap of 63 m.
TAU = Normal(1.96, 0.60, 0.5, 3.7)  # [s]
ACCEL = Normal(1.19, 0.26, 0.4, 2.0)  # [m/s2]
DECEL = Normal(1.9, 0.6, 0.5, 3.7)  # [m/s2]
DELTA = Normal(3.99, 0.32, 3.0, 5.0)
MIN_GAP = 3.65  # [m] highD's mean driver: Zhang and Sun, arXiv 2210.03571 [data]
# [m/s2] middle of 1.5 to 2, which papers from 1938 to 2010 call comfortable: C. Murdoch, hawkins.biz [its summary]
FROM_REST = Normal(1.75)
# [s] passenger cars on minor roads with a stop sign: half of the drivers take 6.5 s, 85 % take 8.25 s: Fitzpatrick,
# Transportation Research Record 1303, 1991 [abstract]. Below 4.5 s others would have to stop.
STOP_SIGN = Normal(6.5, 1.69, 4.5, 10.5)
# [s] middle of 3.3 to 4.7, by method (2,421 decisions, Korea): J. Adv. Transp. 2018, 2726732 [abstract]
ROUNDABOUT = Normal(4.0)
EMERGENCY_DECEL = 6.0  # [m/s2] highway-env's: no source


class MeasuredPool(NamedTuple):
    """The drivers of a task as they were measured, in the place of its `DriverPool`."""

    accel: Normal = ACCEL  # [m/s2]
    # the smallest gap that a driver takes who has to give way [s]; None on roads without a crossing
    critical_gap: Normal | None = None
    # the part of it that SUMO's estimate of the crossing takes [s] (tests/sumo_env/traffic/test_measured.py measures
    # it); jmTimegapMinor is the rest
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
        pairs = (zip(pool.drivers, self.drivers, strict=True) for pool in scenario.pools)
        measured = {own.type: driver for pair in pairs for own, driver in pair}
        calibration = Calibration(lane_changes=scenario.calibration.lane_changes)
        drawn = scenario.with_drivers(lambda own: measured.get(own.type, own))
        return replace(drawn, calibration=calibration, pools=())
