"""A scenario: every vehicle's place, speed, route and driver at the start, and all that chance brings later.

A scenario is drawn once from named random streams, in highway-env's coordinates, and knows no simulator:
the same value is placed into SUMO and into highway-env, which makes their comparison a paired one.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

from sumo_env.config import pace
from sumo_env.networks import files, mapping
from sumo_env.networks.mapping import Network
from sumo_env.networks.roads import LaneIndex, Road, road
from sumo_env.scene import is_obstacle
from sumo_env.traffic.drivers import (
    RISK_RANGES,
    UNCALIBRATED,
    Calibration,
    Driver,
    DriverPool,
    RiskRanges,
)
from sumo_env.traffic.risk import EventKind, RiskEvent, RiskRates
from sumo_env.traffic.tilt import Tilt

EGO = "ego"
NO_EVENTS = RiskRates()
SPAWN_DISTANCE = 15.0  # [m] between centres when a vehicle is added (IntersectionEnv._spawn_vehicle)
EGO_DISTANCE = 20.0  # [m] vehicles closer than this to the ego are removed when it is placed after a warm-up
EXIT_LENGTH = 20.0  # [m] from the end of the intersection's exits, where vehicles leave (_clear_vehicles)


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
        concerns_ego: whether the ego can ever see the vehicle; simulators may leave the others out.
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
    concerns_ego: bool = True

    def __deepcopy__(self, memo: dict[int, object]) -> "VehicleSpec":
        return self  # immutable

    @property
    def is_obstacle(self) -> bool:
        """Whether it is an obstacle of the road: it stands, and nobody drives it."""
        return is_obstacle(self.id)

    def route(self, road: Road) -> tuple[str, ...]:
        """Nodes of its route, from the start of its first lane to its destination."""
        start, end, _ = self.lane
        if self.destination is None or self.destination == end:
            return (start, end)
        return (start, *road.route(end, self.destination))


@dataclass(frozen=True, slots=True)
class Spawn:
    """An attempt to add a vehicle after policy step `step`, or at the end of the warm-up if `step` is 0.

    It is refused where another vehicle is within 15 m (`fits`).
    """

    step: int
    vehicle: VehicleSpec


@dataclass(frozen=True, slots=True)
class Origin:
    """How the ego comes into the traffic of SUMO's files.

    Attributes:
        edges: SUMO's edges of its route, or only the first and the last one where `is_trip`; none for a vehicle of
            the files.
        is_trip: whether SUMO finds the route between the two edges.
        type: its vehicle type; a vehicle of the files has its own.
        speed: at the departure [m/s], or SUMO's word for one.
    """

    edges: tuple[str, ...] = ()
    is_trip: bool = False
    type: str = "DEFAULT_VEHTYPE"
    speed: str = "avg"


class Arrival(NamedTuple):
    """Where the way of a vehicle of the files ends, in SUMO's words: arrivalPos and arrivalEdge."""

    pos: str = "max"
    edge: str = ""

    def place(self, length: float) -> float:
        """On the last edge, of this length [m]; a random place is not known, and taken for the end."""
        try:
            place = float(self.pos)
        except ValueError:
            return length / 2.0 if self.pos == "center" else length
        return min(max(place + length if place < 0.0 else place, 0.0), length)

    def end(self, index: int, edges: int) -> int:
        """Number of the edge that comes after the last one, of a route of so many edges on which it is at `index`."""
        return int(self.edge) + 1 if self.edge.isdecimal() and index <= int(self.edge) < edges else edges


@dataclass(frozen=True, slots=True)
class SumoTraffic:
    """Traffic that SUMO loads, routes and inserts itself.

    Attributes:
        options: SUMO's, by long names without dashes: the network, the files, and all else but the seed.
        origin: of the ego.
        car_type: of the vehicles of the files that are learning cars, the first `max_cars` that depart; "" where they
            are the ego and `Scenario.further`.
        elements: vehicle types, routes and vehicles that were drawn for this episode, as XML of an additional file.
        wait: longest time that SUMO may need to insert the ego after the warm-up [s].
        ranges, rates, own_kinds: what risk does to the drivers.
        models: car-following models of vehicle types, where the files name one.
        arrivals: of vehicles and flows, by their ids, that do not arrive at the end of their route.
        removing: edges on which something removes vehicles: calibrators and vaporizers.
        duration: of the episode [s], after which no event begins.
        seed: of SUMO's random numbers; None for that of the scenario.
        measures_energy, sees_foes: whether SUMO is asked what the ego consumes, and to whom it has to give way.
        overlaps_are_crashes: whether the ego crashes where its outline touches another one that SUMO lets pass.
        imagined: of each `Simulator.imagine` its time [s], and the seed of risk events from then on.
    """

    options: tuple[tuple[str, str], ...]
    origin: Origin
    elements: str = ""
    wait: float = 600.0
    ranges: RiskRanges = RISK_RANGES
    rates: RiskRates = NO_EVENTS
    own_kinds: tuple[EventKind, ...] = ()
    models: tuple[tuple[str, str], ...] = ()
    arrivals: tuple[tuple[str, Arrival], ...] = ()
    removing: frozenset[str] = frozenset()
    duration: float = 60.0
    seed: int | None = None
    imagined: tuple[tuple[float, int], ...] = ()
    measures_energy: bool = False
    sees_foes: bool = False
    overlaps_are_crashes: bool = False
    car_type: str = ""
    max_cars: int = 1


@dataclass(frozen=True, slots=True)
class Scenario:
    """An episode before it is driven: all that a simulator has to know, and all that the traffic owes to chance.

    Attributes:
        task: name of the task, for messages; the road is that of this name where `net` is empty.
        seed: that the scenario was drawn from.
        risk: dose of risky traffic, 0 to 1.
        ego, vehicles: at the start; the vehicles in the order of highway-env's list.
        further: ids of those vehicles that are learning cars as well.
        spawns: attempts to add a vehicle later.
        events: of risky drivers, sorted by time.
        warm_up: time that the traffic drives before the ego is placed [s], see `Simulator.reset`.
        simulation_frequency, policy_frequency: sub-steps and policy steps per second [Hz]; a policy step has the whole
            number of sub-steps that is not above their ratio.
        net: name of the road, a road of a user's own, or the file of a SUMO network.
        road_arguments: of `networks.roads.road`, beside the name of the road.
        pools: drivers that scenarios like this one are made of, which a simulator may load in advance.
        calibration: of SUMO's drivers.
        obeys_lights: whether the ego stops at red and yellow traffic lights of SUMO's files.
        traffic: of SUMO's files, in place of `vehicles`, `spawns` and `events`; the ego's place is then SUMO's choice.
        tilt: how much more often events near learning cars come; None as often as drawn.
    """

    task: str
    seed: int
    risk: float
    ego: VehicleSpec
    vehicles: tuple[VehicleSpec, ...]
    spawns: tuple[Spawn, ...] = ()
    events: tuple[RiskEvent, ...] = ()
    simulation_frequency: int = 10
    policy_frequency: int = 1
    warm_up: float = 0.0
    net: str | Road = ""
    road_arguments: tuple[tuple[str, float], ...] = ()
    pools: tuple[DriverPool, ...] = ()
    calibration: Calibration = UNCALIBRATED
    obeys_lights: bool = False
    traffic: SumoTraffic | None = None
    further: tuple[str, ...] = ()
    tilt: Tilt | None = None

    def __deepcopy__(self, memo: dict[int, object]) -> "Scenario":
        return self  # immutable

    @property
    def network(self) -> Network:
        """The road in SUMO; ValueError if there is none."""
        if isinstance(self.net, str) and files.is_file(self.net):
            return files.network(self.net)
        return mapping.network(self.road)

    @property
    def road(self) -> Road:
        """The road in highway-env's geometry."""
        if isinstance(self.net, Road):
            return self.net
        if files.is_file(self.net):
            return self.network.road
        return road(self.net or self.task, **dict(self.road_arguments))

    @property
    def specs(self) -> tuple[VehicleSpec, ...]:
        """The ego and the others, in the order of the scene's rows."""
        return (self.ego, *self.vehicles)

    @property
    def everybody(self) -> tuple[VehicleSpec, ...]:
        """Likewise, with those that come later."""
        return (*self.specs, *(spawn.vehicle for spawn in self.spawns))

    def with_drivers(self, other: Callable[[Driver], Driver]) -> "Scenario":
        """This scenario with another driver in every vehicle but learning cars: what `other` makes of each driver."""

        def changed(spec: VehicleSpec) -> VehicleSpec:
            is_fixed = spec.id in self.further or spec.is_obstacle
            return spec if is_fixed else spec._replace(driver=other(spec.driver))

        vehicles = tuple(map(changed, self.vehicles))
        spawns = tuple(replace(spawn, vehicle=changed(spawn.vehicle)) for spawn in self.spawns)
        return replace(self, vehicles=vehicles, spawns=spawns)

    @property
    def lifetimes(self) -> tuple[tuple[str, float], ...]:
        """Ids of the vehicles that may have events, and when they come [s]."""
        others = [spec for spec in self.vehicles if not (spec.id in self.further or spec.is_obstacle)]
        return lifetimes(others, self.spawns, pace(self.simulation_frequency, self.policy_frequency))

    def tilted(self, tilt: Tilt) -> "Scenario":
        """This scenario with further events near learning cars; SUMO's own traffic brings them as it comes."""
        further = () if self.traffic is not None else tilt.further(self.lifetimes, self.seed)
        events = tuple(sorted((*self.events, *further), key=lambda event: event.time))
        return replace(self, events=events, tilt=tilt)

    @property
    def cars(self) -> tuple[VehicleSpec, ...]:
        """The learning cars, the ego first."""
        return (self.ego, *(spec for spec in self.vehicles if spec.id in self.further))


def lifetimes(
    vehicles: Iterable[VehicleSpec], spawns: Iterable[Spawn], policy_steps: float
) -> tuple[tuple[str, float], ...]:
    """Ids of vehicles that are there from the start, or come later, and when they come [s].

    policy_steps: per second [Hz].
    """
    later = [(spawn.vehicle.id, spawn.step / policy_steps) for spawn in spawns]
    return (*((spec.id, 0.0) for spec in vehicles), *later)


def car_id(number: int) -> str:
    """Id of a learning car of a task, from 0 on."""
    return f"{EGO}_{number}" if number else EGO


def fits(vehicle: VehicleSpec, centres: Iterable[tuple[float, float]]) -> bool:
    """Whether a vehicle may be added among vehicles with these centres [m] (highway-env's spawn rule)."""
    return all(math.hypot(vehicle.x - x, vehicle.y - y) >= SPAWN_DISTANCE for x, y in centres)
