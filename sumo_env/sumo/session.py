"""The session with SUMO, in SUMO's own words: through the public functions of libsumo, or of another `Engine`.

A process has one `Session` at most. SUMO's coordinates (y up, front bumper, degrees clockwise from north) end here:
everything above uses highway-env's (y down, centre, radians).
"""

import contextlib
import tempfile
from collections.abc import Iterable, Sequence
from math import cos, pi, radians, sin, sqrt
from pathlib import Path

from sumo_env.contacts.rectangles import Half, State
from sumo_env.networks.meeting import Spot
from sumo_env.scene import CAR_SIZE, GREEN, LETTERS, NO_LIGHT, PERCEPTION_DISTANCE, TURN, Light
from sumo_env.sumo.engine import LIBSUMO, Engine
from sumo_env.sumo.paths import listed, plain_path, temporary_folder
from sumo_env.sumo.settings import Settings

# Speed modes (https://sumo.dlr.de/docs/TraCI/Change_Vehicle_State.html#speed_mode_0xb3)
ALL_CHECKS_OFF = 32  # drive at the commanded speed, whatever is ahead
NO_RULES = 55  # car following and red lights; foes at junctions are ignored
REGULAR = 31  # car following and right of way; how SUMO's vehicles begin
RIGHT_OF_WAY = REGULAR & ~7  # right of way and red lights; a commanded speed counts, whatever is ahead
NO_RIGHT_OF_WAY = 23  # car following; foes that approach a junction are ignored, those inside it are not
# Lane-change modes (https://sumo.dlr.de/docs/TraCI/Change_Vehicle_State.html#lane_change_mode_0xb6)
COMMANDED_LANE_CHANGES = 0  # commanded changes only, without regard to others
OWN_LANE_CHANGES = 1621  # the lane-change model decides; how SUMO's vehicles begin

CENTRED = 0.05  # [m] from the middle of a lane
EGO_COLOUR, FURTHER_COLOUR = (0, 150, 255, 255), (130, 200, 255, 255)
VIEW, SEEN = "View #0", 100.0  # in SUMO's own window, and how much of the road it shows [m]


class Session:
    """One simulation. `load` first; every method may raise one of `errors`.

    Where SUMO has a function for it, others call that: `sumo` is the module, `vehicle` and `simulation` are its parts.
    """

    def __init__(self, engine: Engine = LIBSUMO) -> None:
        self._engine, self.errors = engine, (*engine.errors, *engine.gone)
        self.gone = engine.gone  # errors that say that the user has closed SUMO's own window
        self.sumo = engine.module
        self.vehicle, self.simulation = self.sumo.vehicle, self.sumo.simulation
        self.step_length = 0.0  # [s] as SUMO counts time, in whole milliseconds: 0.067 at 15 Hz
        self.lane_change_duration = 0.0  # [s]; 0: at once
        # length and width [m] of the vehicles on the road that do not have highway-env's size
        self.sizes: dict[str, tuple[float, float]] = {}
        self.arrived: tuple[str, ...] = ()  # who has left the road in the last step, at the end of the route
        self.changed = False  # whether a vehicle has come or left in the last step
        self._settings: Settings | None = None
        self._limits: dict[str, float] = {}  # of lanes [m/s]
        self._known: set[str] = set()  # vehicles whose size is known
        self._listed: tuple[str, ...] = ()  # those on the road, when somebody asked last
        self._begin, self._steps = 0.0, 0  # SUMO's time when the network was loaded [s], and steps since then

    def load(self, settings: Settings) -> None:
        """Load everything anew, as in a new process: SUMO's clock, random numbers and traffic lights begin again."""
        self._known.clear()
        self.sizes.clear()
        self._listed = ()
        self._settings = None  # until all is loaded
        values = {**self._engine.options, **settings.options}
        values["net-file"] = str(plain_path(Path(values["net-file"])))
        with tempfile.TemporaryDirectory(prefix="sumo_env-", dir=temporary_folder()) as folder:
            if settings.elements:
                written = Path(folder) / "elements.add.xml"
                written.write_text(settings.elements, encoding="utf-8")
                values["additional-files"] = listed(written, values.get("additional-files"))
            options = [f"--{name}={value}" for name, value in values.items()]
            if self.sumo.isLoaded():
                self.sumo.load(options)
            else:
                self._engine.start([self._engine.program, *options])
            self._begin, self._steps = float(self.simulation.getTime()), 0  # once all is read
        if self.sumo.hasGUI():
            self.sumo.gui.setSchema(VIEW, "real world")
            self.sumo.gui.setBoundary(VIEW, 0.0, 0.0, SEEN, SEEN)
        self._limits.clear()
        self._settings = settings
        self.step_length = float(self.simulation.getDeltaT())
        self.lane_change_duration = float(self.simulation.getOption("lanechange.duration"))
        has_sublanes = float(self.simulation.getOption("lateral-resolution")) > 0.0
        self._angle = self._lane_angle if has_sublanes else self.vehicle.getAngle

    def clear(self, settings: Settings) -> bool:
        """Empty the road where these settings are loaded; the rest goes on. False where they are not.

        A tenth of the time of `load`. For roads without traffic lights and drivers without noise, whose next episode
        cannot tell the difference.
        """
        if settings is not self._settings or not self._clock_is_ours():
            return False
        self._known.clear()
        self.sizes.clear()
        self._listed = ()
        for name in self.vehicle.getIDList():
            self.vehicle.remove(name)
        return True

    def _clock_is_ours(self) -> bool:
        """True if only this session has stepped SUMO. A loaded state would also have rounded vehicle types."""
        return abs(self.simulation.getTime() - self._begin - self._steps * self.step_length) < 1e-6

    def forget(self) -> None:
        """Load again at the next `load`, whatever is loaded (somebody else may have changed it)."""
        self._settings = None

    def close(self) -> None:
        """End the simulation."""
        self._settings = None
        if self.sumo.isLoaded():
            with contextlib.suppress(*self.errors):  # SUMO's window may be closed already
                self.sumo.close()

    def follow(self, name: str, is_first: bool) -> None:
        """In SUMO's own window: the colour of a learning car, and the view goes with the first one."""
        if self.sumo.hasGUI():
            self.vehicle.setColor(name, EGO_COLOUR if is_first else FURTHER_COLOUR)
            if is_first:
                self.sumo.gui.trackVehicle(VIEW, name)

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
        if size != CAR_SIZE:
            self.sizes[name] = size
        self.vehicle.add(name, route, vehicle_type, departSpeed="0")
        self.vehicle.moveTo(name, lane, position)
        self.vehicle.setPreviousSpeed(name, speed)
        # SUMO asks every vehicle whose mode was ever set for commands at every step, so the defaults are not set
        if modes[0] != REGULAR:
            self.vehicle.setSpeedMode(name, modes[0])
        if modes[1] != OWN_LANE_CHANGES:
            self.vehicle.setLaneChangeMode(name, modes[1])
        limit = self._limits.get(lane)
        if limit is None:
            limit = self._limits[lane] = self.sumo.lane.getMaxSpeed(lane)
        # a factor on the lane's limit: unlike setMaxSpeed it does not copy the vehicle's type
        self.vehicle.setSpeedFactor(name, max(desired_speed, 0.01) / limit)

    def send(self, name: str, edges: Sequence[str], is_trip: bool, vehicle_type: str, speed: str) -> bool:
        """Let SUMO insert a vehicle as soon as it can; False where there is no route.

        It draws none of SUMO's random numbers, so that the others come as without it: its speed factor is the mean. It
        has a copy of its type. Of a trip SUMO finds the fastest route between the first and the last edge. speed: at
        the departure [m/s], or SUMO's word for one.
        """
        route, own_type = f"route of {name}", f"{vehicle_type} of {name}"
        self.sumo.vehicletype.copy(vehicle_type, own_type)
        self.sumo.vehicletype.setSpeedDeviation(own_type, 0.0)
        if is_trip:
            edges = self.simulation.findRoute(edges[0], edges[-1], own_type).edges
            if not edges:
                return False
        self.sumo.route.add(route, edges)
        self.vehicle.add(name, route, own_type, departLane="best", departPos="base", departSpeed=speed)
        return True

    # -- reading -------------------------------------------------------------------------------------------

    def spot(self, name: str) -> Spot:
        """The place of a vehicle on the network."""
        height = float(self.vehicle.getPosition3D(name)[2])
        return Spot(self.vehicle.getLaneID(name), float(self.vehicle.getLanePosition(name)), height)

    def changes_lane(self, name: str) -> bool:
        """Whether a lane change of a vehicle is running: it moves sideways, and is not in the middle of its lane yet.

        With sublanes, or by its departPosLat, a vehicle may drive beside the middle for good.
        """
        beside = abs(float(self.vehicle.getLateralLanePosition(name))) >= CENTRED
        return beside and self.vehicle.getLateralSpeed(name) != 0.0

    def type_of(self, name: str) -> str:
        """The vehicle type that a vehicle came with."""
        return str(self.vehicle.getTypeID(name)).partition("@")[0]

    def edge_before(self, name: str) -> str:
        """The edge by which a vehicle has come to the last junction of its way; "" where there was none."""
        behind = int(self.vehicle.getRouteIndex(name))
        if not self.vehicle.getLaneID(name).startswith(":"):
            behind -= 1
        return str(self.vehicle.getRoute(name)[behind]) if behind >= 0 else ""

    def lanes_ahead(self, name: str) -> list[tuple[str, float, bool]]:
        """Lanes of a vehicle's edge from SUMO's lane 0 on: id, length [m], whether its route goes on from there."""
        length, best = self.sumo.lane.getLength, self.vehicle.getBestLanes(name)
        return [(lane, float(length(lane)), bool(leads)) for lane, _, _, _, leads, _ in best]

    def may_change(self, lane: str, beside: str, vehicles: str) -> bool:
        """Whether a class of vehicles may change between two lanes that lie side by side."""
        side = 1 if int(beside.rpartition("_")[2]) > int(lane.rpartition("_")[2]) else -1
        of, allowed = self.sumo.lane, self.sumo.lane.getAllowed(beside)
        return (not allowed or vehicles in allowed) and vehicles in of.getChangePermissions(lane, side)

    def lights(self, name: str) -> list[Light]:
        """The traffic lights on a vehicle's way as far as it sees, the nearest first, and the next one in any case."""
        found: list[Light] = []
        for signal, _, distance, letter in self.vehicle.getNextTLS(name):
            if found and distance > PERCEPTION_DISTANCE:
                break
            if letter in LETTERS:
                # when SUMO next looks at the phase, which may go on where the light looks at the traffic
                left = self.sumo.trafficlight.getNextSwitch(signal) - self.simulation.getTime()
                found.append(Light(LETTERS[letter], float(distance), max(float(left), 0.0), letter == TURN))
        return found

    def next_light(self, name: str) -> Light:
        """The nearest light on a vehicle's way that is not green, or else the next one."""
        lights = self.lights(name)
        return next((light for light in lights if light.state != GREEN), next(iter(lights), NO_LIGHT))

    def signals(self) -> dict[str, str]:
        """What all traffic lights show, in SUMO's letters, by their ids."""
        lights = self.sumo.trafficlight
        return {name: lights.getRedYellowGreenState(name) for name in lights.getIDList()}

    def vehicles(self) -> tuple[str, ...]:
        """Names of the vehicles on the road, in alphabetical order."""
        names = self.vehicle.getIDList()  # but for those that SUMO is teleporting
        if names != self._listed:
            self._listed = names
            self._meet(set(names))
        return names

    def _meet(self, present: set[str]) -> None:
        """Ask for the sizes of vehicles that somebody else has added, and forget those that have left."""
        for name in present - self._known:
            size = float(self.vehicle.getLength(name)), float(self.vehicle.getWidth(name))
            if size != CAR_SIZE:
                self.sizes[name] = size
        for name in self._known - present:
            self.sizes.pop(name, None)
        self._known = present

    def check(self) -> None:
        """An error if somebody else has moved SUMO's clock."""
        if not self._clock_is_ours():
            raise self.sumo.TraCIException("SUMO's time is not where this environment has left it")

    def _lane_angle(self, name: str) -> float:
        """The direction of a vehicle's lane where its middle is, as SUMO counts angles [deg].

        In the sublane model SUMO's own angle is how it draws a vehicle that moves sideways; what it keeps apart are
        lengths along the lane and widths across it.
        """
        drawn, lane = float(self.vehicle.getAngle(name)), self.vehicle.getLaneID(name)
        middle = float(self.vehicle.getLanePosition(name)) - self.half(name)
        if not lane or middle < 0.0:
            return drawn
        angle = float(self.sumo.lane.getAngle(lane, middle))
        return angle if cos(radians(angle - drawn)) > 0.0 else drawn  # else on the lane of oncoming traffic

    def read(self, names: Iterable[str]) -> dict[str, State]:
        """States of these vehicles, in this order."""
        position, angle, speed = self.vehicle.getPosition, self._angle, self.vehicle.getSpeed
        return {name: _state(position(name), angle(name), speed(name), self.half(name)) for name in names}

    def halves(self, names: Iterable[str]) -> list[Half]:
        """Half the length and the width of these vehicles [m]."""
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
        position, angle, speed = self.vehicle.getPosition, self._angle, self.vehicle.getSpeed
        own = position(name)
        x, y = own
        near, rest, reach = {}, [], radius * radius
        for other in others:
            front = position(other)
            dx, dy = front[0] - x, front[1] - y
            squared = dx * dx + dy * dy
            if squared <= reach:
                near[other] = _state(front, angle(other), speed(other), self.half(other))
            else:
                rest.append((other, sqrt(squared) - radius))
        return _state(own, angle(name), speed(name), self.half(name)), near, rest

    # -- time ----------------------------------------------------------------------------------------------

    def step(self) -> Sequence[tuple[str, str]]:
        """Advance by one step; returns the pairs of vehicles that SUMO reports in collision."""
        self.sumo.simulationStep()
        self._steps += 1
        self.arrived = self.simulation.getArrivedIDList()
        self.changed = bool(self.arrived or self.simulation.getDepartedNumber())
        found = self.simulation.getCollisions()
        return [(contact.collider, contact.victim) for contact in found] if found else ()


def _state(front: tuple[float, float], angle: float, speed: float, half: float) -> State:
    """A vehicle's centre, speed and heading in highway-env's coordinates from SUMO's front bumper and angle [deg]."""
    heading = radians(angle - 90.0)
    if heading > pi:
        heading -= 2.0 * pi
    return front[0] - half * cos(heading), -front[1] - half * sin(heading), speed, heading
