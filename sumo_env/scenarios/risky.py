"""Risky drivers among vehicles of SUMO's files: how they differ from their own vehicle types."""

from collections.abc import Mapping
from contextlib import suppress

from sumo_env.streams import stream
from sumo_env.sumo.session import Session
from sumo_env.sumo.vehicle import IN_SUMO, Vehicle
from sumo_env.traffic.drivers import ONE_STREAM, SPREAD_PARAMETERS, RiskRanges

# Classes whose drivers risk changes: those of roads, but bicycles.
RISKY_CLASSES = {
    *("passenger", "private", "taxi", "hov", "evehicle", "bus", "coach", "delivery", "truck", "trailer"),
    *("motorcycle", "moped", "emergency", "authority", "army", "vip", "custom1", "custom2", "ignoring"),
}
# Car-following models that do not have all the parameters that risk changes (SUMO's schema lists them).
LACKING = {"W99": ("accel", "decel", "tau"), "Rail": ("accel", "decel", "tau", "min_gap")}


def deviation(ranges: RiskRanges, dose: float, seed: int, vehicle: str, model: str) -> dict[str, float]:
    """How a risky driver of SUMO's files differs from its own vehicle type: factors of the parameters that `model` has.

    One fixed quantile a parameter, as of the drivers of a `DriverPool`; ``gives_way`` is 0 where the driver does not
    obey right of way.
    """
    together = ONE_STREAM[1:-1]
    shares = stream(seed, f"driver of {vehicle}").random(len(together)).tolist()
    drawn = dict(zip(together, shares, strict=True))
    factors = {"gives_way": float(drawn["gives_way"] >= ranges.not_giving_way * dose)}
    for name in SPREAD_PARAMETERS:
        if name not in drawn:
            drawn[name] = float(stream(seed, f"{name} of the driver of {vehicle}").random())
        low, high = getattr(ranges, name)
        if name not in LACKING.get(model, ()):
            factors[name] = 1.0 + dose * (low + drawn[name] * (high - low) - 1.0)
    return factors


def deviate(session: Session, vehicle: Vehicle, factors: Mapping[str, float]) -> None:
    """Multiply the parameters of a vehicle's own type by the factors of a risky driver (`drivers.deviation`)."""
    of, name = session.vehicle, vehicle.name
    for parameter, keys in IN_SUMO.items():
        factor = factors.get(parameter, 1.0)
        for key in keys if factor != 1.0 else ():  # each setter copies the vehicle's type
            getattr(of, f"set{key}")(name, factor * getattr(of, f"get{key}")(name))
    for key, factor in (("lcAssertive", factors["assertive"]), ("lcSpeedGain", factors["speed_gain"])):
        parameter = f"laneChangeModel.{key}"
        with suppress(ValueError, *session.errors):  # there are models of lane changes without it
            present = float(of.getParameter(name, parameter))
            of.setParameter(name, parameter, f"{factor * present:.6g}")
    if not factors["gives_way"]:
        vehicle.ignore_rules()
