"""The SUMO simulation of this process: the only module that imports libsumo.

libsumo holds one simulation a process. Environments therefore share it: whoever resets last owns it, and an
earlier owner that steps on is told so (`SimulationTaken`). Networks are swapped with ``load``; episodes start by
removing all vehicles and placing new ones, ten times cheaper than a reload. SUMO's coordinates (y up, front bumper,
degrees clockwise from north) end here: everything above speaks highway-env's (y down, centre, radians).
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from sumo_env import direct
from sumo_env.drivers import Driver
from sumo_env.scene import VEHICLE_LENGTH, VEHICLE_WIDTH, Floats

try:
    import libsumo
except ImportError as error:
    raise ImportError(
        "SUMO is missing: libsumo cannot be imported. Install it with 'pip install libsumo==1.28.0' "
        f"(the wheel brings SUMO along, no system SUMO is needed). Python says: {error}"
    ) from error

# What is called often skips libsumo's Python layer, which costs as much as the call itself.
_native = libsumo.libsumo._libsumo
_position, _angle, _speed = _native.vehicle_getPosition, _native.vehicle_getAngle, _native.vehicle_getSpeed
_set_speed, _lane = _native.vehicle_setSpeed, _native.vehicle_getLaneID
_set_lateral = _native.vehicle_setLateralLanePosition
_step, _collisions = _native.simulation_step, _native.simulation_getCollisions

ALL_CHECKS_OFF = 32  # speed mode: drive the commanded speed whatever is ahead
REGULAR = 31  # speed mode: SUMO's car following and right of way, which is how vehicles begin
NO_RIGHT_OF_WAY = 55  # speed mode: car following, but nobody yields at junctions
NO_LANE_CHANGES = 0  # lane-change mode: commanded changes only, and at once
OWN_LANE_CHANGES = 1621  # lane-change mode: SUMO decides, which is how vehicles begin

NOBODY: Mapping[str, str] = MappingProxyType({})

Integers = NDArray[np.int64]


class SimulationTaken(RuntimeError):
    """Another environment of this process has taken over SUMO in the middle of an episode."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What a network is loaded with; a change means a reload."""

    net_file: Path
    routes: tuple[tuple[str, tuple[str, ...]], ...]  # (id, edges)
    step_length: float  # [s]
    lane_change_duration: float  # [s]
    steered: bool  # whether every car is told its place on the lane, and none changes lane by itself
    drivers: tuple[Driver, ...]


class Simulation:
    """The session with libsumo. Use `simulation()`, there is one.

    Attributes:
        check_junctions: whether SUMO compares outlines inside junctions, from the next load of a network on. None: not
            those of steered cars, whose contacts geometry finds without exception (docs/collisions.md).
        step_length: [ms].
    """

    step_length: int

    def __init__(self) -> None:
        self.check_junctions: bool | None = None
        self.settings: Settings | None = None
        self._served: Settings | None = None  # those last asked for, which `settings` suffice for
        self.owner: object | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="sumo_env-")
        self._types: set[str] = set()
        self.lane_ids: tuple[str, ...] = ()
        self.functions = direct.find(_native.__file__, self.version())
        self.lane_pointers: tuple[Integers, Integers]
        self._waiting: set[str] = set()  # vehicles of the last episode
        self._routes: dict[str, str] = {}  # of the vehicles
        self._shared: dict[tuple[str, str], tuple[str, ...]] = {}  # edges that two routes share
        self.stepped = False  # since a vehicle was last removed
        self._limits: dict[str, float] = {}

    def acquire(self, owner: object, settings: Settings, coming: Mapping[str, str] = NOBODY) -> None:
        """Make `owner` the one who drives, in the network of `settings`, with an empty road.

        Vehicles of the last episode that are `coming` again (id -> route) may wait there to be placed again, which SUMO
        does in a tenth of the time that it takes to make one: steered cars, which have no state of their own. They are
        given their new routes when they are placed.
        """
        self.owner = owner
        if settings is self._served:
            self._clear(coming if settings.steered else NOBODY)
        elif self.settings is None or _without_drivers(self.settings) != _without_drivers(settings):
            self._load(settings)
        elif not {driver.type for driver in settings.drivers} <= self._types:
            known = {driver.type: driver for driver in (*self.settings.drivers, *settings.drivers)}
            self._load(_with_drivers(settings, tuple(known.values())))
        else:
            self._clear()
        self._served = settings

    def _clear(self, but: Mapping[str, str] = NOBODY) -> None:
        self._waiting.clear()
        for vehicle in _native.vehicle_getIDList():
            old, new = self._routes.get(vehicle, ""), but.get(vehicle, "")
            if old and new and (old == new or self._shared_edges(old, new)):
                self._waiting.add(vehicle)
            else:
                self.remove(vehicle)

    def _shared_edges(self, one: str, other: str) -> tuple[str, ...]:
        """The edges that two routes share."""
        if (one, other) not in self._shared:
            assert self.settings is not None
            routes = dict(self.settings.routes)
            self._shared[one, other] = tuple(edge for edge in routes[one] if edge in routes[other])
        return self._shared[one, other]

    def _change_route(self, name: str, route: str) -> None:
        """Give a vehicle another route, which SUMO allows where it is on an edge of both.

        Before it is placed: SUMO would draw one that changes its route there a little beside where a new one stands.
        """
        old = self._routes.pop(name)  # not known if it is interrupted here
        _native.vehicle_moveTo(name, f"{self._shared_edges(old, route)[0]}_0", 0.0)
        _native.vehicle_setRouteID(name, route)
        self._routes[name] = route

    def check(self, owner: object) -> None:
        """Raise `SimulationTaken` unless `owner` still drives."""
        if self.owner is not owner:
            raise SimulationTaken(
                "another SUMO environment of this process was reset in the middle of this episode; libsumo runs one "
                "simulation a process. Finish the episode or reset this environment first, or give each environment "
                "its own process: gym.make_vec(id, num_envs=...) without vectorization_mode='sync', or SubprocVecEnv "
                "instead of DummyVecEnv with Stable-Baselines3."
            )

    def release(self, owner: object) -> None:
        """Forget the owner; the loaded network stays for the next one."""
        if self.owner is owner:
            self.owner = None

    def _load(self, settings: Settings) -> None:
        routes = Path(self._folder.name) / "drivers.rou.xml"
        _write_routes(routes, settings)
        check = not settings.steered if self.check_junctions is None else self.check_junctions
        options = [
            "-n", str(settings.net_file),
            "-r", str(routes),
            "--step-length", f"{settings.step_length:.6g}",
            "--lanechange.duration", f"{settings.lane_change_duration:g}",
            "--collision.action", "warn",
            "--collision.check-junctions", str(check).lower(),
            "--collision.mingap-factor", "0",
            "--time-to-teleport", "-1",
            "--max-depart-delay", "-1",
            "--default.speeddev", "0",
            "--xml-validation", "never",
            "--xml-validation.net", "never",
            "--no-step-log", "true",
            "--no-warnings", "true",
            "--duration-log.disable", "true",
            "--seed", "42",
        ]  # fmt: skip
        if self.settings is None:
            libsumo.start(["sumo", *options])
        else:
            libsumo.load(options)
        self.settings = settings
        self.stepped = False
        self._waiting.clear()
        self._types = {driver.type for driver in settings.drivers}
        self.step_length = round(1000 * _native.simulation_getDeltaT())
        self._limits.clear()
        self._routes.clear()
        self._shared.clear()
        self.lane_ids = tuple(sorted(_native.lane_getIDList()))
        self.lane_numbers = {lane: number for number, lane in enumerate(self.lane_ids)}
        if self.functions is not None:
            strings = direct.Strings(self.lane_ids)
            pointers = direct.look_up(self.functions[direct.FIND_LANE], strings.addresses)
            order = np.argsort(pointers)
            self.lane_pointers = pointers[order], order

    def add(
        self,
        name: str,
        route: str,
        driver: str,
        lane: str,
        position: float,
        speed: float,
        speed_mode: int,
        lane_change_mode: int,
        desired_speed: float | None,
    ) -> None:
        """Place a vehicle with its front bumper at `position` [m] of a lane.

        desired_speed: of its driver [m/s], None if that is told.
        """
        if waiting := name in self._waiting:
            self._waiting.discard(name)
            if self._routes[name] != route:
                self._change_route(name, route)
        else:
            _native.vehicle_add(name, route, driver, departSpeed="0")
            self._routes[name] = route
        _native.vehicle_moveTo(name, lane, position)
        # the start speed; sound because action step = simulation step
        _native.vehicle_setPreviousSpeed(name, speed)
        if waiting:
            _set_lateral(name, 0.0)  # which stays what it was if the lane does
            return
        # SUMO asks at every step about a vehicle that it was told anything of, and be it the mode that it has
        if speed_mode != REGULAR:
            _native.vehicle_setSpeedMode(name, speed_mode)
        if lane_change_mode != OWN_LANE_CHANGES:
            _native.vehicle_setLaneChangeMode(name, lane_change_mode)
        if desired_speed is None:
            return
        limit = self._limits.get(lane)
        if limit is None:
            limit = self._limits[lane] = libsumo.lane.getMaxSpeed(lane)
        # A factor on the lane's limit: unlike setMaxSpeed it does not copy the vehicle's type.
        _native.vehicle_setSpeedFactor(name, max(desired_speed, 0.01) / limit)

    def remove(self, name: str) -> None:
        """Take a vehicle off the road."""
        self._routes.pop(name, None)
        _native.vehicle_remove(name)
        self.stepped = False

    def present(self) -> tuple[str, ...]:
        """Names of the vehicles on the road."""
        return libsumo.vehicle.getIDList()

    def step(self) -> None:
        """Advance by one simulation step."""
        _step(0.0)
        self.stepped = True

    def fleet(self, names: Sequence[str]) -> Fleet:
        """These vehicles, which have to be on the road, to be read and commanded together."""
        return Fleet(self, tuple(names))

    def collisions(self) -> list[tuple[str, str]]:
        """Pairs of vehicles that SUMO reports in contact after the last step."""
        found = _collisions()
        return [(contact.collider, contact.victim) for contact in found] if found else []

    def lane_of(self, name: str) -> str:
        """Id of the lane that the front bumper is on; internal lanes begin with a colon."""
        return str(_lane(name))

    def lateral_position(self, name: str) -> float:
        """Distance from the middle of the current lane [m]."""
        return float(_native.vehicle_getLateralLanePosition(name))

    def set_speed(self, name: str, speed: float) -> None:
        """Command a speed [m/s] from now on; a negative one gives it back to SUMO."""
        _set_speed(name, speed)

    def change_lane(self, name: str, index: int) -> None:
        """Change to the lane of this SUMO index (0 is the rightmost) now."""
        libsumo.vehicle.changeLane(name, index, 0.0)

    def move_to_lane(self, name: str, lane: str) -> None:
        """Put a vehicle on another lane of its edge now, as far along as it is."""
        _native.vehicle_moveTo(name, lane, _native.vehicle_getLanePosition(name))

    def put(self, name: str, lane: str, position: float) -> None:
        """Put a vehicle with its front bumper at `position` [m] of a lane of its route (`can_be_on`) now."""
        _native.vehicle_moveTo(name, lane, position)

    def can_be_on(self, name: str, edge: str) -> bool:
        """Whether a vehicle can be put on an edge and then goes its way: it is on its route, and not passed twice."""
        route, index = _native.vehicle_getRoute(name), _native.vehicle_getRouteIndex(name)
        # of an edge that was passed twice SUMO would take the first time, from where the way is another one
        return edge in route[index : index + 1] or (route[:index].count(edge) == 1 and edge not in route[index:])

    def change_lane_relative(self, name: str, step: int) -> None:
        """Change by `step` lanes, +1 to the left; also onto the opposite lane of a two-way road."""
        libsumo.vehicle.changeLaneRelative(name, step, 0.0)

    def set_modes(self, name: str, speed_mode: int, lane_change_mode: int) -> None:
        """Who checks what: the constants above."""
        libsumo.vehicle.setSpeedMode(name, speed_mode)
        libsumo.vehicle.setLaneChangeMode(name, lane_change_mode)

    def lane_change_mode(self, name: str, mode: int) -> None:
        """Who decides on lane changes."""
        libsumo.vehicle.setLaneChangeMode(name, mode)

    def version(self) -> str:
        """SUMO's version, such as `SUMO 1.28.0`."""
        return str(libsumo.getVersion()[1])


class _Addresses(dict[str, int]):
    """Addresses of the few names that vehicles have, as C++ strings for compiled code."""

    def __init__(self) -> None:
        self._strings: list[direct.Strings] = []

    def __missing__(self, name: str) -> int:
        self._strings.append(direct.Strings([name]))
        self[name] = address = int(self._strings[-1].addresses[0])
        return address


_ADDRESSES = _Addresses()


class Fleet:
    """Vehicles by row. All of them are read and commanded at once: directly in SUMO where that can be done."""

    def __init__(self, simulation: Simulation, names: tuple[str, ...]) -> None:
        self._simulation = simulation
        self._names = names
        for name in set(names).difference(_native.vehicle_getIDList()):
            _lane(name)  # raises where there is no such vehicle, which must not happen in compiled code
        self._functions = simulation.functions
        if self._functions is not None:
            self._addresses = np.array([_ADDRESSES[name] for name in names], np.int64)
            self._vehicles = direct.look_up(self._functions[direct.FIND_VEHICLE], self._addresses)
            self._step = simulation.step_length
            self._lanes = simulation.lane_pointers

    def handles(self) -> tuple[int, Integers, Integers, Integers, Integers, Integers] | None:
        """What `loop.Traffic` begins with; None where SUMO's functions are not called directly."""
        if self._functions is None:
            return None
        return (
            self._step, self._functions, self._vehicles, self._addresses, *self._lanes
        )

    def read(self, state: Floats, before: Floats, lane: Integers, own_speed: Floats) -> None:
        """Read x, y [m] of the centres, headings [rad] and speeds [m/s] into the rows of `state`, shape (4, n).

        before: is given the first three rows that were there, shape (3, n).
        lane: is given the numbers of the lanes in `Simulation.lane_ids` that the front bumpers are on, shape (n,).
        own_speed: speeds that are known better than SUMO does, shape (n,), NaN where they are not.
        """
        if self._functions is not None:
            stepped = self._simulation.stepped
            if direct.read(
                self._functions, self._vehicles, *self._lanes, stepped, own_speed, state, before, lane
            ):
                return
            self._functions = None  # somebody has left the road: libsumo says who
        before[:] = state[:3]
        front = np.array([_position(name, False) for name in self._names]).reshape(-1, 2)
        direct.centres(front, np.array([_angle(name) for name in self._names]), state)
        speed = np.array([_speed(name) for name in self._names])
        state[3] = np.where(np.isnan(own_speed), speed, own_speed)
        numbers = self._simulation.lane_numbers
        lane[:] = [numbers[_lane(name)] for name in self._names]

    def read_fronts(self, front: Floats, lane: Integers) -> None:
        """Read front bumpers [m] into `front`, shape (2, n), and the numbers of their lanes, shape (n,)."""
        if self._functions is not None:
            stepped = self._simulation.stepped
            if direct.read_fronts(
                self._functions, self._vehicles, *self._lanes, stepped, front, lane
            ):
                return
            self._functions = None  # somebody has left the road: libsumo says who
        for i, name in enumerate(self._names):
            x, y = _position(name, False)
            front[0, i], front[1, i] = x, -y
            lane[i] = self._simulation.lane_numbers[_lane(name)]

    def command(self, speeds: Floats, lateral: Floats, moved: NDArray[np.bool_]) -> None:
        """`set_speeds`, and put who `moved` `lateral` [m] to the left of the middle of the lane; shapes (n,)."""
        if self._functions is not None:
            direct.command(
                self._functions, self._vehicles, self._addresses, speeds, lateral, moved, self._step
            )
            return
        for row in np.flatnonzero(moved).tolist():
            _set_lateral(self._names[row], float(lateral[row]))
        self.set_speeds(speeds)

    def set_speeds(self, speeds: Floats) -> None:
        """Command speeds [m/s], shape (n,), from now on; NaN is no command, a negative one gives it back to SUMO."""
        if self._functions is not None:
            direct.set_speeds(self._functions, self._vehicles, speeds, self._step)
            return
        for name, speed in zip(self._names, speeds.tolist(), strict=True):
            if not math.isnan(speed):
                _set_speed(name, speed)

    def set_speed_modes(self, modes: Integers) -> None:
        """Who checks a commanded speed, shape (n,): the constants above; negative: as it was."""
        if self._functions is not None:
            direct.set_speed_modes(self._functions, self._vehicles, modes)
            return
        for name, mode in zip(self._names, modes.tolist(), strict=True):
            if mode >= 0:
                libsumo.vehicle.setSpeedMode(name, mode)


_SIMULATION: Simulation | None = None


def simulation() -> Simulation:
    """The simulation of this process."""
    global _SIMULATION
    if _SIMULATION is None:
        _SIMULATION = Simulation()
    return _SIMULATION


def _without_drivers(settings: Settings) -> Settings:
    return _with_drivers(settings, ())


def _with_drivers(settings: Settings, drivers: tuple[Driver, ...]) -> Settings:
    return Settings(
        settings.net_file,
        settings.routes,
        settings.step_length,
        settings.lane_change_duration,
        settings.steered,
        drivers,
    )


def _write_routes(path: Path, settings: Settings) -> None:
    """A route file with one vehicle type for each driver, and every route."""
    root = ElementTree.Element("routes")
    for driver in settings.drivers:
        ignores = "0" if driver.gives_way else "1"
        # Probabilities are 0 or 1, drawn beforehand: SUMO would redraw fractional ones from its own generator.
        ElementTree.SubElement(root, "vType", {
            "id": driver.type,
            "length": f"{VEHICLE_LENGTH:g}",
            "width": f"{VEHICLE_WIDTH:g}",
            # A box. SUMO checks contacts at junctions against the outline that it draws, and a passenger car's has
            # rounded corners: with it 17 of 400 contacts were missed, with this one none (docs/decisions.md).
            "guiShape": "delivery",
            # a class that may not change lane by itself (networks.build)
            "vClass": "custom1" if settings.steered else "passenger",
            "maxSpeed": "60",
            # Who drives on command is also moved the same by the cheapest model: KraussOrig1 takes a seventh off SUMO's
            # step (docs/performance.md).
            "carFollowModel": "KraussOrig1" if settings.steered else "IDM",
            "accel": f"{driver.accel:.6f}",
            "decel": f"{driver.decel:.6f}",
            "apparentDecel": f"{driver.decel:.6f}",
            "emergencyDecel": f"{max(driver.emergency_decel, driver.decel):.6f}",
            "tau": f"{driver.tau:.6f}",
            "minGap": f"{driver.min_gap:.6f}",
            "delta": f"{driver.delta:.6f}",
            "sigma": "0",
            "speedFactor": "1",
            "speedDev": "0",
            # Who drives on command needs no model of lane changes, and DK2008 asks the least: steps of the highway
            # are a sixth cheaper than with LC2013, and the same bit for bit (docs/performance.md). Not on the two-way
            # road: with it SUMO 1.28 ends the process when a car changes to the lane of oncoming traffic.
            "laneChangeModel": "DK2008" if settings.steered else "LC2013",
            "lcKeepRight": "0",
            "lcSpeedGainRight": "1",
            "lcOvertakeRight": "1",
            "lcCooperative": "0",
            "lcStrategic": "1",
            "lcSpeedGain": f"{driver.speed_gain:.6f}",
            "lcAssertive": f"{driver.assertive:.6f}",
            "jmIgnoreFoeProb": ignores,
            "jmIgnoreJunctionFoeProb": ignores,
            "jmIgnoreFoeSpeed": "100" if ignores == "1" else "0",
        })  # fmt: skip
    for name, edges in settings.routes:
        ElementTree.SubElement(root, "route", {"id": name, "edges": " ".join(edges)})
    ElementTree.ElementTree(root).write(path, encoding="unicode")


__all__ = [
    "ALL_CHECKS_OFF",
    "NO_LANE_CHANGES",
    "NO_RIGHT_OF_WAY",
    "OWN_LANE_CHANGES",
    "REGULAR",
    "Settings",
    "Simulation",
    "SimulationTaken",
    "simulation",
]
