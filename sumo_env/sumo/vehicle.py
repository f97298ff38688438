"""Who commands a vehicle on the road: SUMO, or one of those who take its speed or its lanes, and give them back.

The agent takes those of a learning car, an event of risk those of a driver, and a crash those of anybody, for good.
No other module sets modes.
"""

from contextlib import suppress
from math import inf

from sumo_env.sumo.session import (
    ALL_CHECKS_OFF,
    COMMANDED_LANE_CHANGES,
    NO_RIGHT_OF_WAY,
    NO_RULES,
    OWN_LANE_CHANGES,
    REGULAR,
    Session,
)
from sumo_env.traffic.drivers import Calibration
from sumo_env.traffic.scenario import VehicleSpec

# The parameters of drivers in SUMO's words.
IN_SUMO = {"accel": ("Accel",), "emergency_decel": ("EmergencyDecel",), "decel": ("ApparentDecel", "Decel")}
IN_SUMO |= {"tau": ("Tau",), "min_gap": ("MinGap",)}
OF_SUMO = REGULAR, OWN_LANE_CHANGES  # modes in which SUMO's vehicles begin
ROUNDING = 1e-6  # [s] SUMO counts in whole milliseconds
MOVING = 1.0  # [m/s] below it no commanded lane change begins: SUMO would slide the vehicle sideways
LEAST_SIDEWAYS = 0.01  # [m/s]
REACTION = 1.0  # [s] before a vehicle brakes for a red light, or the end of a lane


def modes(spec: VehicleSpec, calibration: Calibration) -> tuple[int, int]:
    """Speed mode and lane-change mode of a vehicle that SUMO drives."""
    speed_mode, lane_change_mode = spec.driver.speed_mode, spec.driver.lane_change_mode
    if speed_mode is None:
        speed_mode = REGULAR if calibration.waits_for_approaching else NO_RIGHT_OF_WAY
    if lane_change_mode is None:
        changes = spec.changes_lanes and calibration.lane_changes
        lane_change_mode = OWN_LANE_CHANGES if changes else COMMANDED_LANE_CHANGES
    return speed_mode, lane_change_mode


class Vehicle:
    """A vehicle on the road.

    Attributes:
        is_learning: whether it has come as a learning car.
        now: its speed mode and its lane-change mode.
        has_speed: whether its speed is commanded; else it is SUMO's.
        crashed: whether it has; then it only coasts to a stop, and nothing is SUMO's any more.
        coasting: speed of a crashed vehicle that is no learning car [m/s].
    """

    def __init__(
        self,
        session: Session,
        name: str,
        base: tuple[int, int],
        is_learning: bool = False,
        held: bool = False,
    ) -> None:
        """base: speed mode and lane-change mode in which SUMO drives it; held: whether it comes commanded."""
        self._session, self.name, self._base, self.is_learning = session, name, base, is_learning
        self.now = (ALL_CHECKS_OFF, COMMANDED_LANE_CHANGES) if held else base
        self.has_speed = held
        self._steering = {""} if held else set[str]()  # who commands its lanes
        self.crashed, self.coasting = False, 0.0
        self._is_changing = False  # whether a lane change of SUMO's may still be running
        self._regular: dict[str, float] = {}  # its own parameters, where others are commanded

    def ignore_rules(self) -> None:
        """From now on it gives way to nobody when SUMO drives it."""
        self._base = NO_RULES, self._base[1]
        self._set(*self._base)

    def hold_speed(self, mode: int = ALL_CHECKS_OFF) -> None:
        """From now on its speed is commanded (`drive`), in this speed mode."""
        if not self.crashed:
            self.has_speed = True
            self._set(mode, self.now[1])

    def drive(self, speed: float) -> None:
        """Command the speed of the next step [m/s]."""
        self._session.vehicle.setSpeed(self.name, speed)

    def free_speed(self) -> None:
        """Give the speed back to SUMO, if it is commanded."""
        if self.has_speed and not self.crashed:
            self.has_speed = False
            self._set(self._base[0], self.now[1])
            self.drive(-1.0)

    @property
    def has_lanes(self) -> bool:
        """Whether its lanes are commanded; else they are SUMO's."""
        return bool(self._steering)

    def hold_lanes(self, by: str = "") -> None:
        """From now on its lane changes are commanded, by one of those who may do so at a time."""
        if not self._steering:
            self._is_changing = True
            self._set(self.now[0], COMMANDED_LANE_CHANGES)
        self._steering.add(by)

    def free_lanes(self, by: str = "") -> None:
        """Give the lane changes back to SUMO, once nobody else commands them."""
        if self._steering and not self.crashed:
            self._steering.discard(by)
            if not self._steering:
                self._set(self.now[0], self._base[1])

    def command(self, speed: bool, lanes: bool) -> None:
        """From now on its speed, its lane changes, both or neither are commanded."""
        if speed != self.has_speed:
            (self.hold_speed if speed else self.free_speed)()
        if lanes != self.has_lanes:
            (self.hold_lanes if lanes else self.free_lanes)()

    def set_parameters(self, **values: float) -> None:
        """Command parameters of its driver: accel, decel, emergency_decel [m/s2], tau [s], min_gap [m].

        Raises:
            ValueError: there is no such parameter.
        """
        of = self._session.vehicle
        for parameter, value in values.items():
            if parameter not in IN_SUMO:
                raise ValueError(f"no parameter {parameter!r} can be commanded, only {', '.join(IN_SUMO)}")
            for key in IN_SUMO[parameter]:
                present = getattr(of, f"get{key}")(self.name)
                self._regular.setdefault(key, present)
                if present != value:  # each setter copies the vehicle's type
                    getattr(of, f"set{key}")(self.name, value)

    def free_parameters(self) -> None:
        """Give its driver the parameters back that were commanded."""
        for key, value in self._regular.items():
            getattr(self._session.vehicle, f"set{key}")(self.name, value)
        self._regular = {}

    def may_change_lane(self) -> bool:
        """Whether a lane may be commanded: once lanes are taken from SUMO, it ends the change that it has begun."""
        self._is_changing = self._is_changing and self._session.changes_lane(self.name)
        return self.has_lanes and not self._is_changing

    def way_to_stop(self, speed: float) -> float:
        """Way [m] in which it stops from a speed with its type's `decel`, which it begins after REACTION."""
        return speed * (speed / (2.0 * float(self._session.vehicle.getDecel(self.name))) + REACTION)

    def changes_by_itself(self) -> bool:
        """Whether a lane change runs that SUMO has begun."""
        return not self.has_lanes and self._session.changes_lane(self.name)

    def is_late(self, fastest: float) -> bool:
        """Whether its lane ends before a lane change that begins now would, at up to `fastest` [m/s].

        SUMO would then drop the change, so that it jumps sideways, or break down.
        """
        of, lanes, takes = self._session.vehicle, self._session.sumo.lane, self._session.lane_change_duration
        if takes == 0.0:
            return False
        lane, position = of.getLaneID(self.name), of.getLanePosition(self.name)
        sideways = inf  # [m/s]
        with suppress(*self._session.errors):  # there are models of lane changes without it
            standing, factor = (
                float(of.getParameter(self.name, f"laneChangeModel.lcMaxSpeedLat{key}"))
                for key in ("Standing", "Factor")
            )
            sideways = max(standing + factor * fastest, LEAST_SIDEWAYS)
        takes = max(takes, lanes.getWidth(lane) / sideways)
        is_oncoming = lane.rpartition("_")[0] != of.getRoute(self.name)[of.getRouteIndex(self.name)]
        left = position if is_oncoming else lanes.getLength(lane) - position
        return bool(left < fastest * (takes + self._session.step_length))

    def may_begin_change(self, fastest: float) -> bool:
        """Whether a lane change may begin now: it does not stand, and its lane goes on until the change is over."""
        is_moving = self._session.vehicle.getSpeed(self.name) >= MOVING
        return is_moving and self.takes_lanes and not self.is_late(fastest)

    @property
    def takes_lanes(self) -> bool:
        """Whether SUMO survives a commanded change: not one that takes time, of a driver that acts rarely."""
        session = self._session
        acts = session.vehicle.getActionStepLength(self.name)
        return bool(session.lane_change_duration == 0.0 or acts < session.step_length + ROUNDING)

    def crash(self, speed: float) -> None:
        """From now on it coasts to a stop from its `speed` [m/s], and stays where it is, as in highway-env."""
        if not self.crashed:
            self.hold_speed()
            self.hold_lanes()
            self.crashed, self.coasting = True, speed

    def _set(self, speed_mode: int, lane_change_mode: int) -> None:
        of, before = self._session.vehicle, self.now
        self.now = speed_mode, lane_change_mode
        if speed_mode != before[0]:
            of.setSpeedMode(self.name, speed_mode)
        if lane_change_mode != before[1]:
            of.setLaneChangeMode(self.name, lane_change_mode)
