"""A scenario: every vehicle's place, speed, route and driver at the start, and all that chance brings later.

A scenario is drawn once from named random streams, in highway-env's coordinates, and knows no simulator:
the same value is placed into SUMO and into highway-env, which makes their comparison a paired one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from sumo_env.drivers import Driver, RiskEvent
from sumo_env.networks.roads import LaneIndex

EGO = "ego"


class VehicleSpec(NamedTuple):  # dozens are made in every episode, a dataclass takes five times as long
    """One vehicle at the start of its life.

    Attributes:
        id: name, ``"ego"`` or ``"v<number>"``.
        lane: highway-env's lane index (from node, to node, lane id).
        s: longitudinal coordinate of the centre on that lane [m].
        x, y: centre [m].
        heading: [rad].
        speed: [m/s].
        target_speed: desired speed; for the ego the commanded one [m/s].
        destination: node that ends the route, None on roads without choices.
        driver: who drives.
        changes_lanes: whether the driver may change lane (highway-env's ``enable_lane_change``).
        timer: time since the last MOBIL decision at the start [s].
        yielding: whether the driver is stopping for others at the start (intersection).
    """

    id: str
    lane: LaneIndex
    s: float
    x: float
    y: float
    heading: float
    speed: float
    target_speed: float
    destination: str | None
    driver: Driver
    changes_lanes: bool = True
    timer: float = 0.0
    yielding: bool = False


@dataclass(frozen=True, slots=True)
class Spawn:
    """An attempt to add a vehicle after policy step `step`; refused where another vehicle is within 15 m."""

    step: int
    vehicle: VehicleSpec


@dataclass(frozen=True, slots=True)
class Scenario:
    """All that an episode's traffic owes to chance."""

    task: str
    seed: int
    risk: float
    ego: VehicleSpec
    vehicles: tuple[VehicleSpec, ...]
    spawns: tuple[Spawn, ...] = ()
    events: tuple[RiskEvent, ...] = ()  # sorted by time

    @property
    def specs(self) -> tuple[VehicleSpec, ...]:
        """The ego and the others, in the order of the scene's rows."""
        return (self.ego, *self.vehicles)


TrafficModel = Literal["matched", "sumo"]
