"""Who drives: a driver is a SUMO vehicle type.

Car following is SUMO's IDM with highway-env's own numbers; lane changes are SUMO's LC2013; right of way is SUMO's
junction model. A few settings per task (`Calibration`) bring their traffic close to highway-env's (docs/validation.md).
Risky drivers have the same parameters from wider ranges (`RiskRanges`), so dose 0 *is* regular traffic.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from sumo_env.scene import CAR_SIZE, OBSTACLE_SIZE, VEHICLE_LENGTH, VEHICLE_WIDTH
from sumo_env.streams import stream
from sumo_env.traffic.sumo_schemas import check_attributes

POOL = 64  # drivers of one dose; SUMO holds one vehicle type for each, so the pool is finite
SAFE_BRAKING = 2.0  # [m/s2] IDMVehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED
MIN_GAIN = 0.2  # [m/s2] IDMVehicle.LANE_CHANGE_MIN_ACC_GAIN
LARGEST = 30.0  # [m] length and width of a vehicle
MAX_SPEED = 60.0  # [m/s] more than anybody drives
# Attributes of a vehicle type that a driver of one's own cannot have.
UNCHANGED = {"id", "guiShape", "speedFactor", "speedDev"}


@dataclass(frozen=True, slots=True)
class CarFollowing:
    """The regular IDM driver of a task (Treiber et al. 2000; values of highway-env's IDMVehicle)."""

    accel: float = 3.0  # COMFORT_ACC_MAX [m/s2]
    decel: float = 5.0  # -COMFORT_ACC_MIN [m/s2]
    tau: float = 1.5  # TIME_WANTED [s]
    min_gap: float = 5.0  # DISTANCE_WANTED less one vehicle length [m]
    emergency_decel: float = 6.0  # ACC_MAX [m/s2]


@dataclass(frozen=True, slots=True)
class Calibration:
    """Settings of SUMO's drivers in a task, applied once, that bring their traffic close to highway-env's.

    Attributes:
        lane_changes: whether LC2013 decides on lane changes; else nobody changes but by a risk event.
        speed_gain: lcSpeedGain, eagerness to change for speed.
        speed_gain_lookahead: lcSpeedGainLookahead [s], over which LC2013 compares the speeds of lanes.
        assertive: lcAssertive, divides the gap that LC2013 asks for.
        strategic: lcStrategic, eagerness to change to a lane that leads on; -1 for none.
        sideways: highest speed sideways in a lane change as a share of the speed, so that who stands changes no lane;
            None for SUMO's, which does not depend on the speed.
        waits_for_approaching: whether vehicles that only approach a junction have right of way at all.
        ignores_approaching: share of drivers that do not wait for vehicles approaching a junction (jmIgnoreFoeProb).
        ignores_inside: share of drivers that do not wait for vehicles inside a junction (jmIgnoreJunctionFoeProb).
        tau: factor on tau, SUMO's time gap. SUMO's IDM takes the gap between bumpers and highway-env's the distance
            between centres, so that SUMO's drivers heed a distant leader less.
    """

    lane_changes: bool = True
    speed_gain: float = 2.0
    speed_gain_lookahead: float = 0.0
    assertive: float = 0.7
    waits_for_approaching: bool = True
    ignores_approaching: float = 0.0
    ignores_inside: float = 0.0
    tau: float = 1.0
    strategic: float = 1.0
    sideways: float | None = None


UNCALIBRATED = Calibration()


@dataclass(frozen=True, slots=True)
class Driver:
    """One driver's parameters, SI units. `type` names the driver in the pool of its dose.

    Those that highway-env has too mean the same there. `assertive` and `speed_gain` are relative to the task's
    calibrated value; their counterparts in highway-env are `safe_braking` and `min_gain`.

    Attributes:
        type: name of the vehicle type.
        delta: IDM's exponent.
        accel, decel, emergency_decel: [m/s2].
        tau: desired time gap [s].
        min_gap: at a standstill [m].
        assertive: factor on lcAssertive.
        speed_gain: factor on lcSpeedGain.
        attention: in [0, 1), decides who is among the share that ignores others at junctions.
        gives_way: whether the driver obeys right of way.
        attributes: of SUMO's vType, in place of those that follow from the parameters.
        speed_mode, lane_change_mode: SUMO's, in place of those of the task (`sumo_env.sumo.session` lists them).
    """

    type: str
    delta: float
    accel: float
    decel: float
    tau: float
    min_gap: float
    emergency_decel: float
    assertive: float = 1.0
    speed_gain: float = 1.0
    attention: float = 0.5
    gives_way: bool = True
    attributes: tuple[tuple[str, str], ...] = ()
    speed_mode: int | None = None
    lane_change_mode: int | None = None

    def like(
        self,
        name: str,
        attributes: Mapping[str, object],
        speed_mode: int | None = None,
        lane_change_mode: int | None = None,
    ) -> "Driver":
        """This driver with attributes of SUMO's vType, such as ``{"carFollowModel": "Krauss", "accel": 1.3}``.

        Raises:
            ValueError: attributes that SUMO does not know, or that would have no effect here.
        """
        check_attributes(name, attributes)
        for key in sorted(UNCHANGED & attributes.keys()):
            raise ValueError(f"{key} of {name!r} would have no effect: its VehicleSpec says its speed")
        for key in {"length", "width"} & attributes.keys():
            if not 0.1 <= float(str(attributes[key])) <= LARGEST:
                raise ValueError(f"{key} of {name!r} must be 0.1 to {LARGEST:g} m, not {attributes[key]}")
        own = tuple((key, str(value)) for key, value in attributes.items())
        type = f"{name}.{self.type}"
        return replace(
            self, type=type, attributes=own, speed_mode=speed_mode, lane_change_mode=lane_change_mode
        )

    @property
    def size(self) -> tuple[float, float]:
        """Length and width of the vehicle [m]."""
        if not self.attributes:
            return CAR_SIZE
        own = dict(self.attributes)
        return float(own.get("length", VEHICLE_LENGTH)), float(own.get("width", VEHICLE_WIDTH))

    @property
    def safe_braking(self) -> float:
        """MOBIL's limit on the braking that a lane change may impose [m/s2]: what `assertive` is in highway-env."""
        return SAFE_BRAKING * self.assertive

    @property
    def min_gain(self) -> float:
        """MOBIL's least advantage of a lane change [m/s2]: what `speed_gain` is in highway-env."""
        return MIN_GAIN / self.speed_gain


# Of an obstacle, which stands: of it there is only the size.
_SIZE = ("length", f"{OBSTACLE_SIZE[0]:g}"), ("width", f"{OBSTACLE_SIZE[1]:g}")
STANDING = Driver("obstacle", 4.0, 1.0, 1.0, 1.0, 1.0, 1.0, attributes=_SIZE)
Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class RiskRanges:
    """Ranges from which the parameters of a task's drivers are drawn at dose 1, as factors of the regular values.

    The default is highway-env's own range for risky behaviour, 0.5 to 1.5 times the mean
    (LinearVehicle.ACCELERATION_RANGE). On straight roads ranges are symmetric because one-sided ones (short headways,
    strong brakes) make traffic that leaves gaps, and the ego safer (docs/developers/decisions.md).

    Attributes:
        not_giving_way: share of drivers that do not obey right of way.
    """

    accel: Range = (0.5, 1.5)
    decel: Range = (0.5, 1.5)
    tau: Range = (0.5, 1.5)
    min_gap: Range = (0.5, 1.5)
    emergency_decel: Range = (0.5, 1.5)
    assertive: Range = (0.5, 1.5)
    speed_gain: Range = (0.5, 1.5)
    not_giving_way: float = 0.5


SPREAD_PARAMETERS = ("accel", "decel", "tau", "min_gap", "emergency_decel", "assertive", "speed_gain")
RISK_RANGES = RiskRanges()
# What is drawn from one stream, in this order, on which all published results depend. A parameter that is added later
# is not added here: it has a stream of its own, and shifts no other draw.
ONE_STREAM = (
    *("delta", "accel", "decel", "tau", "min_gap", "emergency_decel", "assertive", "speed_gain"),
    *("gives_way", "attention"),
)


@lru_cache
def quantiles(parameter: str) -> np.ndarray:
    """Quantile in (0, 1) of a parameter of each driver of a pool, (POOL,): one draw in each of POOL equal parts."""
    before = 0
    if parameter in ONE_STREAM:
        rng, before = stream(0, "driver pool"), ONE_STREAM.index(parameter)
    else:
        rng = stream(0, f"driver pool {parameter}")
    for _ in range(before):
        rng.permutation(POOL)
    return (rng.permutation(POOL) + 0.5) / POOL


class DriverPool(NamedTuple):
    """The drivers of one dose, as a value that is quickly sent to another process.

    Attributes:
        base: the regular driver.
        dose: of risk, 0 to 1.
        fixed_delta: whether the IDM exponent is 4 for all, as where highway-env does not call ``randomize_behavior``;
            otherwise U(3.5, 4.5) (``IDMVehicle.DELTA_RANGE``).
        ranges: of the parameters at dose 1.
    """

    base: CarFollowing
    dose: float
    fixed_delta: bool = False
    ranges: RiskRanges = RISK_RANGES

    @property
    @lru_cache(maxsize=64)  # noqa: B019 (a pool is a value)
    def drivers(self) -> tuple[Driver, ...]:
        """The drivers; driver k of any two doses differs only by the dose.

        The paper's law (section "Experiment Setup"): ``p = p_min + U(0, 1) * (p_max - p_min)`` with one fixed draw per
        driver and parameter. The dose widens every range from the regular value to the whole of `ranges`.
        """
        gives_way = quantiles("gives_way") >= self.ranges.not_giving_way * self.dose

        def parameter(name: str, k: int) -> Any:
            regular = float(getattr(self.base, name, 1.0))
            low, high = (
                regular * (1.0 + (factor - 1.0) * self.dose) for factor in getattr(self.ranges, name)
            )
            return low + float(quantiles(name)[k]) * (high - low)

        return tuple(
            Driver(
                type=f"{'f' if self.fixed_delta else 'd'}{k}@{self.dose:g}",
                delta=4.0 if self.fixed_delta else 3.5 + float(quantiles("delta")[k]),
                attention=float(quantiles("attention")[k]),
                gives_way=bool(gives_way[k]),
                **{name: parameter(name, k) for name in SPREAD_PARAMETERS},
            )
            for k in range(POOL)
        )


def vehicle_type(driver: Driver, calibration: Calibration) -> dict[str, str]:
    """Attributes of the SUMO vType that is this driver (https://sumo.dlr.de/docs/Definition_of_Vehicles.html)."""
    # Probabilities are 0 or 1, drawn beforehand: SUMO would redraw fractional ones from its own generator.
    ignores_approaching = not driver.gives_way or driver.attention < calibration.ignores_approaching
    ignores_inside = not driver.gives_way or driver.attention < calibration.ignores_inside
    sideways: dict[str, str] = {}
    if calibration.sideways is not None:
        sideways = {"lcMaxSpeedLatStanding": "0", "lcMaxSpeedLatFactor": f"{calibration.sideways:g}"}
    return {
        "length": f"{VEHICLE_LENGTH:g}",
        "width": f"{VEHICLE_WIDTH:g}",
        # A box. SUMO checks contacts at junctions against the outline that it draws, and a passenger car's has rounded
        # corners: with it 17 of 400 contacts were missed, with this one none (docs/developers/decisions.md).
        "guiShape": "delivery",
        "maxSpeed": f"{MAX_SPEED:g}",
        "speedFactor": "1",
        "speedDev": "0",
        "sigma": "0",
        "carFollowModel": "IDM",
        "accel": f"{driver.accel:.6f}",
        "decel": f"{driver.decel:.6f}",
        "apparentDecel": f"{driver.decel:.6f}",
        "emergencyDecel": f"{max(driver.emergency_decel, driver.decel):.6f}",
        "tau": f"{calibration.tau * driver.tau:.6f}",
        "minGap": f"{driver.min_gap:.6f}",
        "delta": f"{driver.delta:.6f}",
        "laneChangeModel": "LC2013",
        # no preference for a side, no courtesy: MOBIL's symmetric rule with politeness 0
        "lcKeepRight": "0",
        "lcSpeedGainRight": "1",
        "lcOvertakeRight": "1",
        "lcCooperative": "0",
        "lcStrategic": f"{calibration.strategic:g}",
        "lcSpeedGain": f"{calibration.speed_gain * driver.speed_gain:.6f}",
        "lcSpeedGainLookahead": f"{calibration.speed_gain_lookahead:g}",
        "lcAssertive": f"{calibration.assertive * driver.assertive:.6f}",
        "jmIgnoreFoeProb": str(int(ignores_approaching)),
        "jmIgnoreFoeSpeed": "100" if ignores_approaching else "0",
        "jmIgnoreJunctionFoeProb": str(int(ignores_inside)),
        **sideways,
        **dict(driver.attributes),
    }
