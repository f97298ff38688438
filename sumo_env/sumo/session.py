"""The session with libsumo: SUMO in its own words, through libsumo's public functions. No other module imports it.

libsumo supports one simulation per process, so a process has one `Session` at most. SUMO's coordinates (y up, front
bumper, degrees clockwise from north) end here: everything above uses highway-env's (y down, centre, radians).
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import cos, pi, radians, sin, sqrt
from pathlib import Path
from xml.etree import ElementTree

from sumo_env.contacts.rectangles import Half, State
from sumo_env.scene import CAR_SIZE, GREEN, NO_LIGHT, RED, VEHICLE_LENGTH, YELLOW, Light
from sumo_env.sumo.options import readable

try:
    # without its warning about versions of pyarrow, which SUMO needs for Parquet output alone
    with contextlib.redirect_stdout(io.StringIO()):
        import libsumo
except ImportError as error:
    raise ImportError(
        "SUMO is missing: libsumo cannot be imported. Install it with 'pip install libsumo==1.28.0' "
        f"(the wheel brings SUMO along; no system-wide SUMO is needed). Python says: {error}"
    ) from error

_vehicle, _simulation = libsumo.vehicle, libsumo.simulation
SumoErrors = (libsumo.TraCIException, libsumo.FatalTraCIError)

# Speed modes (https://sumo.dlr.de/docs/TraCI/Change_Vehicle_State.html#speed_mode_0xb3)
ALL_CHECKS_OFF = 32  # drive at the commanded speed, whatever is ahead
REGULAR = 31  # car following and right of way; how SUMO's vehicles begin
HARD_BRAKING = REGULAR & ~4  # as REGULAR, but a commanded speed may need more than the vehicle type's `decel`
NO_RIGHT_OF_WAY = 23  # car following; foes that approach a junction are ignored, those inside it are not
# Lane-change modes (https://sumo.dlr.de/docs/TraCI/Change_Vehicle_State.html#lane_change_mode_0xb6)
COMMANDED_LANE_CHANGES = 0  # commanded changes only, without regard to others
OWN_LANE_CHANGES = 1621  # the lane-change model decides; how SUMO's vehicles begin

# SUMO's letters for the state of a traffic light (https://sumo.dlr.de/docs/Simulation/Traffic_Lights.html); those that
# are left out mean that it is off. "s" lets vehicles turn right after a stop.
LIGHTS = {"r": RED, "u": RED, "s": RED, "y": YELLOW, "Y": YELLOW, "g": GREEN, "G": GREEN}

HALF_LENGTH = VEHICLE_LENGTH / 2.0
# [s] The ego's centre then crosses the line between two lanes when highway-env's does, after 0.45 to 0.5 s.
LANE_CHANGE_DURATION = 0.8
CENTRED = 0.05  # [m] from the middle of a lane


@dataclass(frozen=True)
class Settings:
    """What a network is loaded with; a change means a reload (about 20 ms)."""

    net_file: Path
    routes: tuple[tuple[str, tuple[str, ...]], ...]  # (id, edges)
    step_length: float  # [s]
    vehicle_types: tuple[tuple[str, Mapping[str, str]], ...]  # (id, attributes of SUMO's vType)
    options: tuple[str, ...] = ()  # further ones of SUMO, as ``--name=value``


class Session:
    """One simulation. `load` first; every method may raise one of `SumoErrors`."""

    def __init__(self) -> None:
        self.step_length = 0.0  # [s] as SUMO counts time, in whole milliseconds: 0.067 at 15 Hz
        self.has_lights = False  # whether the network has traffic lights
        # length and width [m] of the vehicles on the road that do not have highway-env's size
        self.sizes: dict[str, tuple[float, float]] = {}
        self.arrived: tuple[str, ...] = ()  # who has left the road in the last step, at the end of the route
        self.changed = False  # whether a vehicle has come or left in the last step
        self._settings: Settings | None = None
        self._limits: dict[str, float] = {}  # of lanes [m/s]
        self._known: set[str] = set()  # vehicles whose size is known
        self._steps = 0  # since the network was loaded

    def load(self, settings: Settings) -> None:
        """Load a network with its vehicle types and an empty road; only an empty road where it is loaded already."""
        self._known.clear()
        self.sizes.clear()
        if settings == self._settings and self._clock_is_ours():
            for name in _vehicle.getIDList():
                _vehicle.remove(name)
            return
        self._settings = None  # until the new network is loaded
        with contextlib.ExitStack() as stack:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="sumo_env-"))
            written = Path(folder) / "types.add.xml"
            _write_types(written, settings)
            net, types = stack.enter_context(readable(settings.net_file, written))
            given = dict(option.split("=", 1) for option in settings.options)
            additional = [types, given.pop("--additional-files", "")]
            values = {
                "--net-file": net,
                "--additional-files": ",".join(filter(None, additional)),
                "--step-length": f"{settings.step_length:.6g}",
                "--lanechange.duration": f"{LANE_CHANGE_DURATION:g}",
                "--collision.action": "warn",
                "--collision.check-junctions": "true",
                "--collision.mingap-factor": "0",
                "--time-to-teleport": "-1",
                "--max-depart-delay": "-1",
                "--default.speeddev": "0",
                "--xml-validation": "never",
                "--xml-validation.net": "never",
                "--no-step-log": "true",
                "--no-warnings": "true",
                "--duration-log.disable": "true",
                "--seed": "42",
                **given,
            }
            options = [f"{name}={value}" for name, value in values.items()]
            if libsumo.isLoaded():
                libsumo.load(options)
            else:
                libsumo.start(["sumo", *options])
        self._limits.clear()
        self._steps = 0
        self._settings = settings
        self.step_length = round(settings.step_length, 3)
        self.has_lights = libsumo.trafficlight.getIDCount() > 0

    def _clock_is_ours(self) -> bool:
        """Whether nobody else has moved SUMO's clock; a state that is loaded has vehicle types with fewer digits."""
        return abs(_simulation.getTime() - self._steps * self.step_length) < 1e-6

    def forget(self) -> None:
        """Load again at the next `load`, whatever is loaded (somebody else may have changed it)."""
        self._settings = None

    def close(self) -> None:
        """End the simulation."""
        self._settings = None
        if libsumo.isLoaded():
            libsumo.close()

    # -- vehicles ------------------------------------------------------------------------------------------

    def add(
        self,
        name: str,
        route: str,
        vehicle_type: str,
        lane: str,
        position: float,
        speed: float,
        desired_speed: float,
        modes: tuple[int, int] = (REGULAR, OWN_LANE_CHANGES),
        size: tuple[float, float] = CAR_SIZE,
    ) -> None:
        """Place a vehicle with its front bumper at `position` [m] of a lane, driving at `speed` [m/s].

        desired_speed: that it follows on a free road [m/s]; modes: speed mode and lane-change mode.
        """
        self._known.add(name)
        if size == CAR_SIZE:
            self.sizes.pop(name, None)
        else:
            self.sizes[name] = size
        _vehicle.add(name, route, vehicle_type, departSpeed="0")
        _vehicle.moveTo(name, lane, position)
        _vehicle.setPreviousSpeed(name, speed)
        # SUMO asks every vehicle whose mode was ever set for commands at every step, so the defaults are not set
        if modes[0] != REGULAR:
            _vehicle.setSpeedMode(name, modes[0])
        if modes[1] != OWN_LANE_CHANGES:
            _vehicle.setLaneChangeMode(name, modes[1])
        limit = self._limits.get(lane)
        if limit is None:
            limit = self._limits[lane] = libsumo.lane.getMaxSpeed(lane)
        # a factor on the lane's limit: unlike setMaxSpeed it does not copy the vehicle's type
        _vehicle.setSpeedFactor(name, max(desired_speed, 0.01) / limit)

    def remove(self, name: str) -> None:
        """Take a vehicle off the road."""
        _vehicle.remove(name)

    def set_speed(self, name: str, speed: float) -> None:
        """Command a speed [m/s] from now on; -1 gives it back to the car-following model."""
        _vehicle.setSpeed(name, speed)

    def set_modes(
        self, name: str, speed_mode: int | None = None, lane_change_mode: int | None = None
    ) -> None:
        """Which checks apply to commands, and whether the lane-change model decides: the constants of this module."""
        if speed_mode is not None:
            _vehicle.setSpeedMode(name, speed_mode)
        if lane_change_mode is not None:
            _vehicle.setLaneChangeMode(name, lane_change_mode)

    def change_lane(self, name: str, index: int) -> None:
        """Begin a change to the lane of this SUMO index (0 is the rightmost)."""
        _vehicle.changeLane(name, index, 0.0)

    def change_lane_relative(self, name: str, step: int) -> None:
        """Begin a change by `step` lanes, +1 to the left; also onto the opposite lane of a two-way road."""
        _vehicle.changeLaneRelative(name, step, 0.0)

    # -- reading -------------------------------------------------------------------------------------------

    def lane_of(self, name: str) -> str:
        """Id of the lane that the front bumper is on; ids of lanes inside junctions begin with a colon."""
        lane: str = _vehicle.getLaneID(name)
        return lane

    def changes_lane(self, name: str) -> bool:
        """Whether a lane change of a vehicle is running: it is not in the middle of its lane."""
        return abs(float(_vehicle.getLateralLanePosition(name))) >= CENTRED

    def speed_of(self, name: str) -> float:
        """Speed of a vehicle [m/s]."""
        return float(_vehicle.getSpeed(name))

    def next_light(self, name: str) -> Light:
        """The next traffic light on a vehicle's way."""
        for _, _, distance, letter in _vehicle.getNextTLS(name) if self.has_lights else ():
            if letter in LIGHTS:
                return Light(LIGHTS[letter], float(distance))
        return NO_LIGHT

    def vehicles(self) -> tuple[str, ...]:
        """Names of the vehicles on the road, in alphabetical order."""
        names = _vehicle.getIDList()
        if len(names) != len(self._known):
            self._meet(set(names))
        return names

    def _meet(self, present: set[str]) -> None:
        """Ask for the sizes of vehicles that somebody else has added, and forget those that have left."""
        for name in present - self._known:
            size = float(_vehicle.getLength(name)), float(_vehicle.getWidth(name))
            if size != CAR_SIZE:
                self.sizes[name] = size
        for name in self._known - present:
            self.sizes.pop(name, None)
        self._known = present

    def check(self) -> None:
        """An error if somebody else has moved SUMO's clock."""
        if not self._clock_is_ours():
            raise libsumo.TraCIException("SUMO's time is not where this environment has left it")

    def read(self, names: Iterable[str]) -> dict[str, State]:
        """States of these vehicles, in this order."""
        position, angle, speed = _vehicle.getPosition, _vehicle.getAngle, _vehicle.getSpeed
        if not self.sizes:
            return {name: _state(position(name), angle(name), speed(name)) for name in names}
        return {name: _state(position(name), angle(name), speed(name), self.half(name)) for name in names}

    def halves(self, names: Iterable[str]) -> list[Half]:
        """Half the length and the width of these vehicles [m]; empty where all vehicles on the road are cars."""
        if not self.sizes:
            return []
        sizes = (self.sizes.get(name, CAR_SIZE) for name in names)
        return [(length / 2.0, width / 2.0) for length, width in sizes]

    def half(self, name: str) -> float:
        """Half the length of a vehicle [m]."""
        return self.sizes.get(name, CAR_SIZE)[0] / 2.0

    def near(
        self, name: str, others: Iterable[str], radius: float
    ) -> tuple[State, dict[str, State], list[tuple[str, float]]]:
        """State of a vehicle, those of the others within `radius` [m], and how much further away the rest is [m].

        Distances are those of the front bumpers.
        """
        position, angle, speed = _vehicle.getPosition, _vehicle.getAngle, _vehicle.getSpeed
        own = position(name)
        x, y = own
        near, rest, sizes, reach = {}, [], self.sizes, radius * radius
        for other in others:
            front = position(other)
            dx, dy = front[0] - x, front[1] - y
            squared = dx * dx + dy * dy
            if squared <= reach:
                half = self.half(other) if sizes else HALF_LENGTH
                near[other] = _state(front, angle(other), speed(other), half)
            else:
                rest.append((other, sqrt(squared) - radius))
        return _state(own, angle(name), speed(name)), near, rest

    # -- time ----------------------------------------------------------------------------------------------

    def step(self) -> Sequence[tuple[str, str]]:
        """Advance by one step; returns the pairs of vehicles that SUMO reports in collision."""
        libsumo.simulationStep()
        self._steps += 1
        self.arrived = _simulation.getArrivedIDList()
        self.changed = bool(self.arrived or _simulation.getDepartedNumber())
        found = _simulation.getCollisions()
        return [(contact.collider, contact.victim) for contact in found] if found else ()


def _state(front: tuple[float, float], angle: float, speed: float, half: float = HALF_LENGTH) -> State:
    """A vehicle's centre, speed and heading in highway-env's coordinates from SUMO's front bumper and angle [deg]."""
    heading = radians(angle - 90.0)
    if heading > pi:
        heading -= 2.0 * pi
    return front[0] - half * cos(heading), -front[1] - half * sin(heading), speed, heading


def _write_types(path: Path, settings: Settings) -> None:
    """An additional file with every vehicle type and every route."""
    root = ElementTree.Element("additional")
    for name, attributes in settings.vehicle_types:
        ElementTree.SubElement(root, "vType", {"id": name, **attributes})
    for name, edges in settings.routes:
        ElementTree.SubElement(root, "route", {"id": name, "edges": " ".join(edges)})
    ElementTree.ElementTree(root).write(path, encoding="unicode")


def version() -> str:
    """SUMO's version, such as ``SUMO 1.28.0``."""
    return str(libsumo.getVersion()[1])
