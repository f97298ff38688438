"""Who drives: the regular driver, and risky drivers by dose.

The paper's law (section "Experiment Setup") draws each driver's parameter as
``p = p_min + U(0, 1) * (p_max - p_min)``; the dose widens every range from the regular driver's point to
SPREAD to either side of it. Dose 0 therefore *is* regular traffic. Parameters alone make no road more
dangerous, so a dose also brings seeded events: cut-ins (lane changes that ignore MOBIL's safety and incentive
criteria), sudden braking and surges; at the intersection, drivers that do not give way.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from sumo_env.streams import stream

POOL = 64  # drivers of one dose; SUMO holds one vehicle type for each, so the pool is finite


@dataclass(frozen=True, slots=True)
class CarFollowing:
    """The regular IDM driver of a task (Treiber et al. 2000; values of highway-env's IDMVehicle)."""

    accel: float = 3.0  # COMFORT_ACC_MAX [m/s2]
    decel: float = 5.0  # -COMFORT_ACC_MIN [m/s2]
    tau: float = 1.5  # TIME_WANTED [s]
    min_gap: float = 5.0  # DISTANCE_WANTED less one vehicle length [m]
    emergency_decel: float = 6.0  # ACC_MAX [m/s2]


@dataclass(frozen=True, slots=True)
class Driver:
    """One driver's parameters, SI units. `type` names the driver in the pool of its dose."""

    type: str
    delta: float
    accel: float
    decel: float
    tau: float
    min_gap: float
    emergency_decel: float
    assertive: float  # lcAssertive: divides the gap that SUMO's LC2013 asks for
    speed_gain: float  # lcSpeedGain: eagerness of LC2013 to change for speed
    gives_way: bool = True

    @property
    def safe_braking(self) -> float:
        """MOBIL's limit on the braking that a lane change may impose [m/s2]: what `assertive` is in highway-env."""
        return SAFE_BRAKING * self.assertive / REGULAR["assertive"]

    @property
    def min_gain(self) -> float:
        """MOBIL's least advantage of a lane change [m/s2]: what `speed_gain` is in highway-env."""
        return MIN_GAIN * REGULAR["speed_gain"] / self.speed_gain


SAFE_BRAKING = 2.0  # [m/s2] IDMVehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED
MIN_GAIN = 0.2  # [m/s2] IDMVehicle.LANE_CHANGE_MIN_ACC_GAIN


# Of cars that are told where to drive: they need no parameters. The stronger SUMO thinks their brakes are, the less far
# it looks ahead for them, and those who do not give way need not know who crosses (docs/performance.md).
TOLD = Driver(
    "told", delta=4.0, accel=50.0, decel=50.0, tau=0.1, min_gap=0.0, emergency_decel=50.0, assertive=1.0,
    speed_gain=0.0, gives_way=False,
)  # fmt: skip

# The regular driver's LC2013: its changes satisfy MOBIL's criteria in 94 % of cases (docs/decisions.md).
REGULAR: dict[str, float] = {"assertive": 0.7, "speed_gain": 2.0}

# Half the width of a parameter's range at dose 1, relative to the regular value: highway-env's own ranges for risky
# behaviour reach from 0.5 to 1.5 times the mean (LinearVehicle.ACCELERATION_RANGE). Ranges are symmetric because
# one-sided ones (short headways, strong brakes) make traffic that leaves gaps, and the ego safer (docs/decisions.md).
SPREAD = 0.5
# "Acceleration" and "steering" of the paper's law: what the dose spreads.
SPREAD_PARAMETERS = ("accel", "decel", "tau", "min_gap", "emergency_decel", "assertive", "speed_gain")
RISKY_SHARE_NOT_GIVING_WAY = 0.5
FREE_WAY = 40.0  # [m]


@lru_cache(maxsize=64)
def driver_pool(base: CarFollowing, dose: float, fixed_delta: bool = False) -> tuple[Driver, ...]:
    """The drivers of one dose; driver k of any two doses differs only by the dose.

    `fixed_delta`: the IDM exponent is 4 for all, as where highway-env does not call ``randomize_behavior``;
    otherwise U(3.5, 4.5) (``IDMVehicle.DELTA_RANGE``).
    """
    rng = stream(0, "driver pool")

    def uniform() -> np.ndarray:
        """A stratified uniform sample over the pool (one draw in each of POOL equal parts)."""
        return (rng.permutation(POOL) + 0.5) / POOL

    exponent = uniform()
    draws = {name: uniform() for name in SPREAD_PARAMETERS}
    gives_way = uniform() >= RISKY_SHARE_NOT_GIVING_WAY * dose

    def parameter(name: str, k: int) -> float:
        regular = REGULAR[name] if name in REGULAR else float(getattr(base, name))
        low, high = regular * (1.0 - SPREAD * dose), regular * (1.0 + SPREAD * dose)
        return low + float(draws[name][k]) * (high - low)

    kind = "f" if fixed_delta else "d"
    return tuple(
        Driver(
            type=f"{kind}{k}@{dose:g}",
            delta=4.0 if fixed_delta else 3.5 + float(exponent[k]),
            gives_way=bool(gives_way[k]),
            **{name: parameter(name, k) for name in SPREAD_PARAMETERS},
        )
        for k in range(POOL)
    )


@dataclass(frozen=True, slots=True)
class RiskRates:
    """What the drivers of a task do at dose 1, per vehicle and second (calibration: docs/decisions.md)."""

    cut_in: float = 0.0  # unsafe lane changes [1/s]
    brake: float = 0.0  # sudden braking [1/s]
    brake_decel: float = 6.0  # [m/s2]
    brake_duration: float = 1.0  # [s]
    surge: float = 0.0  # sudden acceleration [1/s]
    surge_accel: float = 4.0  # [m/s2]
    surge_duration: float = 2.0  # [s]
    surge_way: float = FREE_WAY  # [m] free straight ahead, else a surge pauses


@dataclass(frozen=True, slots=True)
class RiskEvent:
    """Something dangerous that a driver does at a time fixed in advance, whatever the ego does.

    Attributes:
        time: since the start of the episode [s].
        vehicle: id of the driver's vehicle.
        kind: ``cut-in``: change to the neighbouring lane at once; only who has nobody beside (`hazards.has_room`) does.
            ``brake``: brake for nothing. ``surge``: accelerate, whoever crosses the way, but pause while somebody is
            near straight ahead (`hazards.free_way`).
        direction: of a cut-in, -1 left or +1 right (the other one where there is no lane or no room).
        decel: of a brake [m/s2].
        accel: of a surge [m/s2].
        duration: of a brake or a surge [s].
        way: of a surge, to the next vehicle straight ahead, from centre to centre [m]; it pauses while that is nearer.
    """

    time: float
    vehicle: str
    kind: Literal["cut-in", "brake", "surge"]
    direction: int = 0
    decel: float = 0.0
    accel: float = 0.0
    duration: float = 0.0
    way: float = FREE_WAY


def draw_events(
    rates: RiskRates, dose: float, vehicles: tuple[tuple[str, float], ...], seed: int, duration: float
) -> tuple[RiskEvent, ...]:
    """Events of an episode, sorted by time; none at dose 0.

    Poisson processes of the rates at dose 1, thinned by the dose: the events of a smaller dose are a subset
    of those of a larger one. `vehicles`: (id, time from which it is on the road [s]).
    """
    if dose <= 0.0:
        return ()
    rng = stream(seed, "risk events")
    events: list[RiskEvent] = []
    for vehicle, start in vehicles:
        for kind, rate in (("cut-in", rates.cut_in), ("brake", rates.brake), ("surge", rates.surge)):
            for _ in range(rng.poisson(rate * duration)):
                time, keep, side = rng.random(3)
                time *= duration
                if keep >= dose or time < start:
                    continue
                if kind == "cut-in":
                    events.append(RiskEvent(time, vehicle, "cut-in", direction=-1 if side < 0.5 else 1))
                elif kind == "brake":
                    decel, seconds = rates.brake_decel, rates.brake_duration
                    events.append(RiskEvent(time, vehicle, "brake", decel=decel, duration=seconds))
                else:
                    accel, seconds = rates.surge_accel, rates.surge_duration
                    events.append(
                        RiskEvent(time, vehicle, "surge", accel=accel, duration=seconds, way=rates.surge_way)
                    )
    return tuple(sorted(events, key=lambda event: (event.time, event.vehicle, event.kind)))
