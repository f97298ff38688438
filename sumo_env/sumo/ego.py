"""The ego in SUMO: highway-env's low-level driver as speeds and lane changes that SUMO is commanded.

Speed follows the target with a first-order lag of 0.6 s, without a limit on acceleration, as in highway-env, or at a
commanded acceleration; the sideways motion of a lane change is SUMO's. What is not commanded SUMO drives, as the task's
regular driver.
"""

from sumo_env.contacts.rectangles import State
from sumo_env.networks.mapping import Network
from sumo_env.simulator import LANE_ENDED, EgoCommand
from sumo_env.sumo.session import Session
from sumo_env.sumo.vehicle import Vehicle
from sumo_env.traffic.risk import CUT_IN_GAP
from sumo_env.traffic.scenario import Scenario, VehicleSpec

TAU = 0.6  # [s] ControlledVehicle.TAU_ACC
LEAST_COVERED = 0.01  # [m] of a step; a car that covers less may stand by itself
REFERENCE_STEP = 1.0 / 15.0  # [s] highway-env's step, whose Euler lag is reproduced at any step length


class Ego:
    """The ego during one episode."""

    ended = ""  # how its way has ended, see `EgoStep`
    overlaps_count = True  # whether each touch of outlines is a crash
    is_sumos, overlap = False, ""  # see `RouteEgo`

    def __init__(
        self, session: Session, scenario: Scenario, network: Network, spec: VehicleSpec, vehicle: Vehicle
    ) -> None:
        """spec: the ego among the scenario's learning cars; vehicle: it on the road."""
        self._name, self.vehicle = spec.id, vehicle
        self._session, self._network, self._road = session, network, scenario.road
        self._route = spec.route(self._road)
        self.speed, self.target_speed, self.target_lane = spec.speed, spec.target_speed, spec.lane
        self._lane, self._stretch = "", 1.0  # of SUMO
        self._way = network.sumo_route(spec.lane, spec.destination)  # of SUMO
        self._acceleration: float | None = None
        self._covered = 0.0  # [m] in this step, as commanded

    def obey(self, command: EgoCommand) -> None:
        """Take over the command of a policy step, and give SUMO what is not commanded."""
        speed, lane, self._acceleration = command
        self.vehicle.command(speed is not None, lane is not None)
        self.target_speed = self.speed if speed is None else speed
        self.target_lane = self.target_lane if lane is None else lane

    def drive(self, here: State, dt: float) -> None:
        """Command the next `dt` [s]; `settle` says how far it gets."""
        session = self._session
        self.target_lane = self._road.follow(self.target_lane, self._route, *here[:2])
        if self.vehicle.crashed:
            self.speed, self._covered = coast(self.speed, dt)
        elif self.vehicle.has_speed:
            self.speed, self._covered = driven(self.speed, self.target_speed, self._acceleration, dt)
        lane = session.vehicle.getLaneID(self._name)
        if lane != self._lane:
            self._lane, self._stretch = lane, self._network.stretch(lane)
            if self.vehicle.has_lanes and (way := self._network.leading_on(self._way, lane)) != self._way:
                self._way = way  # where lanes part, its lane decides
                session.vehicle.setRouteID(self._name, way)
        # lanes of one edge share one length in SUMO, so a metre in a bend is not a metre on the road
        if self.vehicle.has_speed:
            self.vehicle.drive(self._covered / session.step_length * self._stretch)
        if not self.vehicle.crashed:
            self._change_lane(lane)

    def settle(self, dt: float) -> float:
        """After the step: what SUMO has made of it; returns the distance that was covered [m]."""
        speed = self._session.vehicle.getSpeed(self._name)
        if not self.vehicle.has_speed:
            self.speed = speed / self._stretch
            return self.speed * self._session.step_length
        if speed == 0.0 and self._covered > LEAST_COVERED:  # SUMO has stopped it: its lane ends
            self.speed = self._covered = 0.0
            if not self.vehicle.crashed:
                self.ended = LANE_ENDED
        return self._covered

    def _change_lane(self, lane: str) -> None:
        """Begin a lane change where the ego is on another lane than it steers for, and no change is running.

        While it stands, or its edge ends before the change would, it waits and goes on steering for that lane.
        """
        start, end, place = self._network.indices[lane]
        if self.target_lane[0] == start and self.target_lane[1] != end:
            # where lanes parted, it was on another one than it steered for
            self.target_lane = start, end, place
        if not self.vehicle.may_change_lane():
            self.target_lane = (*self.target_lane[:2], place) if self._road.oncoming else (start, end, place)
            if self._road.oncoming and place == 0 and not self.vehicle.has_lanes:
                self._come_back()
            return
        if lane.startswith(":"):
            return
        target = self.target_lane[2]
        if place == target or self._session.changes_lane(self._name):
            return
        count, fastest = self._road.count(start, end), max(self.speed, self.target_speed) * self._stretch
        begins = self.vehicle.may_begin_change(fastest)
        if self._road.oncoming:  # the lane of oncoming traffic is SUMO's opposite lane
            if begins:
                self._session.vehicle.changeLaneRelative(self._name, 1 if target == 0 else -1, 0.0)
        elif count == self._road.count(*self.target_lane[:2]):
            beside = self._network.lanes[start, end, target].id
            if begins:
                self._session.vehicle.changeLane(self._name, self._network.sumo_index(self.target_lane), 0.0)
            elif self._network.leading_on(self._way, beside) != self._way and self.vehicle.is_late(fastest):
                self.target_lane = start, end, place

    def _come_back(self) -> None:
        """Leave the lane of oncoming traffic as soon as nobody on the own lane would have to brake hard for it."""
        session, of, name = self._session, self._session.vehicle, self._name
        if session.changes_lane(name):
            return
        own = self._network.lanes[(*self.target_lane[:2], 1)].id
        there = [other for other in session.vehicles() if of.getLaneID(other) == own]
        (x, _, speed, _), *others = session.read((name, *there)).values()
        for other, (at, _, its_speed, _) in zip(there, others, strict=True):
            behind, closing = (name, speed - its_speed) if at > x else (other, its_speed - speed)
            needed = max(closing, 0.0) ** 2 / (2.0 * of.getDecel(behind))
            if abs(at - x) - session.half(name) - session.half(other) < CUT_IN_GAP + needed:
                return
        of.changeLaneRelative(name, -1, 0.0)


def approach(speed: float, target: float, tau: float, dt: float) -> tuple[float, float]:
    """Speed [m/s] after `dt` [s] of first-order lag `tau` [s], and the distance covered [m].

    highway-env integrates v' = (target - v) / tau by explicit Euler at 15 Hz; speed and distance are those at any `dt`.
    """
    kept = (1.0 - REFERENCE_STEP / tau) ** (dt / REFERENCE_STEP)  # share of the difference that is left
    difference = speed - target
    return target + difference * kept, target * dt + difference * tau * (1.0 - kept)


def driven(speed: float, target: float, acceleration: float | None, dt: float) -> tuple[float, float]:
    """Speed [m/s] after `dt` [s] at an acceleration [m/s2], or None for the lag, and the distance covered [m]."""
    if acceleration is None:
        return approach(speed, target, TAU, dt)
    change = acceleration * dt
    after = min(max(target, speed - change), speed + change)
    return after, (speed + after) / 2.0 * dt


def coast(speed: float, dt: float) -> tuple[float, float]:
    """Speed [m/s] of a crashed vehicle after `dt` [s], and the distance covered [m]: it decelerates with a = -v."""
    return approach(speed, 0.0, 1.0, dt)
