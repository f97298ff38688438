"""The ego among the traffic of SUMO's own files: a vehicle of SUMO that may be commanded.

Its type limits what commands can do. Without a target speed or a target lane SUMO drives it as it does all others.
"""

from itertools import pairwise
from math import inf

from sumo_env.contacts.rectangles import State
from sumo_env.networks.mapping import Network
from sumo_env.networks.meeting import edge_of
from sumo_env.networks.roads import LaneIndex
from sumo_env.scenarios.lights import REACHED, LightsAhead
from sumo_env.scenarios.progress import Progress
from sumo_env.scene import NOBODY, Neighbour, Place
from sumo_env.simulator import EgoCommand, SimulatorError
from sumo_env.sumo.ego import coast, driven
from sumo_env.sumo.nearby_vehicles import foe, neighbours
from sumo_env.sumo.session import Session
from sumo_env.sumo.vehicle import Vehicle
from sumo_env.traffic.scenario import Arrival, Scenario


class RouteEgo:
    """The ego of one episode, from its departure on. `ended`, `ahead` and `overlap`: see `Place`."""

    def __init__(self, session: Session, network: Network, vehicle: Vehicle, scenario: Scenario) -> None:
        """vehicle: it on the road."""
        assert scenario.traffic is not None
        name = vehicle.name
        self._session, self._network, self._name, self.vehicle = session, network, name, vehicle
        self._obeys_lights, self._is_regular = scenario.obeys_lights, scenario.risk == 0.0
        self._measures_energy, self._sees_foes = scenario.traffic.measures_energy, scenario.traffic.sees_foes
        # whether each touch of outlines is a crash
        self.overlaps_count, self.overlap = scenario.traffic.overlaps_are_crashes, ""
        self._class = session.vehicle.getVehicleClass(name)
        self.speed = session.vehicle.getSpeed(name)  # [m/s]
        self.ended, self.lights = "", LightsAhead(session, name)
        self._fuel = self._electricity = 0.0  # in this policy step
        self._target_speed: float | None = None
        self._acceleration: float | None = None
        self._target_lane: LaneIndex | None = None
        self._lane, self._length, self._leads_on, self._may_turn = "", 0.0, True, True
        self._is_on_lane, self._is_opposite, self._was_opposite = True, False, False
        self._sides: tuple[LaneIndex | None, LaneIndex | None] = (None, None)
        self._reaches: tuple[float, float] = (0.0, 0.0)  # how far the lanes beside lead, from their start [m]
        self.ahead: tuple[str, ...] = ()
        self._route = ""  # SUMO's id of it, which changes with the route
        arrivals = dict(scenario.traffic.arrivals)
        self._arrival = arrivals.get(name) or arrivals.get(name.rpartition(".")[0], Arrival())
        self._removing = scenario.traffic.removing
        self._index: LaneIndex = next(iter(network.lanes))
        self._position = 0.0  # on its lane [m]
        # from its front, and from the end of its lane, to the end of its way [m]
        self._left = self._beyond = 0.0
        self.read_lane()
        self._odometer = float(session.vehicle.getDistance(name))  # [m]
        self._progress = Progress(self._route)

    def obey(self, command: EgoCommand) -> None:
        """Take over the command of a policy step, and give SUMO back what is not commanded."""
        paid = self._progress.share(self._route, self._left)
        self.read_lane(again=True)  # routes and lanes may have changed since it came here
        self._progress.begin_step(paid, self._route, self._left)
        self._fuel = self._electricity = 0.0
        self.overlap, self.lights.run = "", 0
        if self.vehicle.crashed:
            return
        self._target_speed, self._target_lane, self._acceleration = command
        if self._target_lane is not None and self._target_lane not in self._sides:
            self._target_lane = self._index
        self.vehicle.command(self._target_speed is not None, self._target_lane is not None)

    @property
    def is_sumos(self) -> bool:
        """Whether SUMO alone drives it, among traffic without risk: then what it calls no collision is none."""
        return self._is_regular and not (self.vehicle.has_speed or self.vehicle.has_lanes)

    def drive(self, here: State, dt: float) -> None:
        """Command the next step of `dt` [s]; `settle` says how far it gets."""
        session, name, before = self._session, self._name, self.speed
        self.lights.look()
        if self.vehicle.crashed:
            self.vehicle.drive(coast(before, dt)[0])
        elif self._target_speed is not None:
            of = session.vehicle
            accel, decel, hardest = of.getAccel(name), of.getDecel(name), of.getEmergencyDecel(name)
            wanted = driven(before, self._target_speed, self._acceleration, dt)[0]
            speed = min(max(min(wanted, of.getMaxSpeed(name)), before - decel * dt, 0.0), before + accel * dt)
            if self._obeys_lights:
                allowed, mode = self.lights.allowed(before, dt)
                speed = min(speed, max(allowed, before - hardest * dt, 0.0))
                self.vehicle.hold_speed(mode)
            if speed * dt > self.free:
                self.ended = "missed turn"
            self.vehicle.drive(speed)
        if not self.vehicle.crashed:
            self._change_lane()

    def _change_lane(self) -> None:
        """Ask for the target lane; SUMO changes there within the step, or in the time that its options say."""
        if self._target_lane is not None and not self.vehicle.may_change_lane():
            self._target_lane = self._index
        target = self._target_lane
        if target is None or target == self._index or target not in self._sides:
            return
        of, takes = self._session.vehicle, self._session.lane_change_duration
        fastest = self.speed + of.getAccel(self._name) * takes
        leads_on = self._reaches[self._sides.index(target)] == inf
        if leads_on != self._leads_on and self.vehicle.is_late(fastest):  # lanes part before it could end
            self._target_lane = self._index
        elif not self._session.changes_lane(self._name) and self.vehicle.may_begin_change(fastest):
            of.changeLane(self._name, self._network.sumo_index(target), 0.0)

    def settle(self, dt: float) -> float:
        """After the step: what SUMO has made of the commands; returns the distance that was driven [m]."""
        session, before = self._session, self._lane
        if not self.ended:  # at the end of a lane from which its route cannot go on, SUMO stops it at once
            self.speed = session.vehicle.getSpeed(self._name)
        if self._measures_energy:
            self._fuel += session.vehicle.getFuelConsumption(self._name) * dt
            self._electricity += session.vehicle.getElectricityConsumption(self._name) * dt
        self.read_lane()
        metres = self._count_metres()
        if edge_of(self._lane) != edge_of(before):
            self.lights.pass_lines(metres - self._position)
        if not self._may_turn and self._target_lane is not None:
            self.ended = "missed turn"
        return metres

    def leave(self) -> float:
        """SUMO has taken it off the road in this step; returns the distance that was driven [m].

        It has arrived, unless there is what removes vehicles from that edge, and it was not at the end of its way.
        """
        of, name = self._session.vehicle, self._name
        self.ahead, self._route = of.getRoute(name)[of.getRouteIndex(name) :], of.getRouteID(name)
        metres = self._count_metres()
        left = max(self._left - metres, 0.0)
        is_removed = self.ahead[0] in self._removing and left > REACHED
        self.ended, self._left = ("removed", left) if is_removed else ("arrived", 0.0)
        return metres

    def _count_metres(self) -> float:
        """What it has driven since the last call [m], by SUMO's odometer, which counts for vehicles on lanes alone.

        On the lane of oncoming traffic, where it counts from the other end, SUMO's speed says it.
        """
        before, self._odometer = self._odometer, float(self._session.vehicle.getDistance(self._name))
        is_apart, self._was_opposite = self._is_opposite or self._was_opposite, self._is_opposite
        metres = self.speed * self._session.step_length if is_apart else max(self._odometer - before, 0.0)
        self._progress.drive(metres)
        return metres

    def read_lane(self, again: bool = False) -> None:
        """Read where the ego is; what belongs to a lane or a route is read when it comes there, or again.

        A vehicle that is parked, or that SUMO is teleporting, is on no lane: its last one stands.
        """
        of, name = self._session.vehicle, self._name
        lane, route = of.getLaneID(name), of.getRouteID(name)
        self._is_on_lane = bool(lane)
        if not lane:
            return
        if again or (lane, route) != (self._lane, self._route):
            self._lane, self._route = lane, route
            self._look_ahead()
            self._look_aside()
        self._position, length = of.getLanePosition(name), self._network.sumo_lanes[lane].length
        # overtaking on the lane of oncoming traffic, where SUMO counts from the other end
        self._is_opposite = not lane.startswith(":") and edge_of(lane) != self.ahead[0]
        self._left = max(
            self._beyond + (self._position if self._is_opposite else length - self._position), 0.0
        )

    def _look_ahead(self) -> None:
        """Read what is left of its way."""
        of, name, network = self._session.vehicle, self._name, self._network
        route, index = of.getRoute(name), max(of.getRouteIndex(name), 0)
        self.ahead = route[index : self._arrival.end(index, len(route))]
        following, edges, way = self._lane, self.ahead, 0.0
        if following.startswith(":"):  # in a junction the edge before is the first one
            edges = edges[1:]
            while (following := next(iter(network.sumo_lanes[following].following), "")).startswith(":"):
                way += network.sumo_lanes[following].length
            way += self._edge_length(edges[0]) if edges else 0.0
        way += sum(network.junctions.get(pair, 0.0) + self._edge_length(pair[1]) for pair in pairwise(edges))
        length = self._edge_length(self.ahead[-1])
        self._beyond = way - (length - self._arrival.place(length))

    def _look_aside(self) -> None:
        """Read its lane and the lanes beside it."""
        lane = self._lane
        if lane not in self._network.indices:
            raise SimulatorError(
                f"the ego {self._name!r} ({self._class}) is on {lane!r}, no lane for vehicles of roads: take another "
                "one, or a network that has no lane for cars"
            )
        self._index = self._network.indices[lane]
        self._leads_on, self._may_turn, self._sides = True, True, (None, None)
        self._reaches = 0.0, 0.0
        if not lane.startswith(":"):
            self._look_along_the_edge(lane)
        if self._target_lane is None or self._index[:2] != self._target_lane[:2]:
            return
        if self._target_lane not in (self._index, *self._sides):
            self._target_lane = self._index

    def _look_along_the_edge(self, lane: str) -> None:
        session, network = self._session, self._network
        start, end, place = self._index
        beside, takes_lanes = [], self.vehicle.takes_lanes
        for other in ((start, end, place - 1), (start, end, place + 1)):
            there = network.lanes.get(other)
            near = there is not None and abs(network.sumo_index(other) - network.sumo_index(self._index)) == 1
            may = near and there and takes_lanes and session.may_change(lane, there.id, self._class)
            beside.append(other if may else None)
        self._sides = (beside[0], beside[1])
        if len(self.ahead) <= 1:
            self._reaches = (inf if beside[0] else 0.0, inf if beside[1] else 0.0)
            return
        lanes = session.lanes_ahead(self._name)
        if lane not in [found for found, _, _ in lanes]:  # SUMO overtakes on the lane of oncoming traffic
            self._sides = None, None
            return
        reaches = {found: inf if leads else length for found, length, leads in lanes}
        left, right = (reaches.get(network.lanes[side].id, 0.0) if side else 0.0 for side in beside)
        self._reaches = left, right
        here = next(k for k, found in enumerate(lanes) if found[0] == lane)
        _, self._length, self._leads_on = lanes[here]
        gets_on = takes_lanes and any(self._gets_on(lanes, here, side) for side in (1, -1))
        self._may_turn = self._leads_on or gets_on

    def _gets_on(self, lanes: list[tuple[str, float, bool]], place: int, side: int) -> bool:
        """Whether changes to one side, as far as the road's markings let it, lead to a lane that leads on."""
        while 0 <= place + side < len(lanes):
            if not self._session.may_change(lanes[place][0], lanes[place + side][0], self._class):
                return False
            place += side
            if lanes[place][2]:
                return True
        return False

    @property
    def free(self) -> float:
        """How far the ego gets without a lane change [m]; inf where its lane leads on."""
        return inf if self._leads_on else self._length - self._session.vehicle.getLanePosition(self._name)

    def _edge_length(self, edge: str) -> float:
        return self._network.sumo_lanes[f"{edge}_0"].length

    @property
    def target_lane(self) -> LaneIndex:
        """Lane that the ego steers for."""
        target = self._target_lane
        return target if target is not None and target[:2] == self._index[:2] else self._index

    def place(self, waiting: int) -> Place:
        """As a scene has it."""
        left, right = (side is not None for side in self._sides)
        gone = self.ended in ("arrived", "removed")
        driven = 0.0 if gone else self._session.vehicle.getLanePosition(self._name)
        beside = [max(reach - driven, 0.0) for reach in self._reaches]
        return Place(
            lane=self._index,
            left=left,
            right=right,
            ahead=self.ahead,
            free=0.0 if self.ended == "missed turn" else self.free,
            free_left=beside[0],
            free_right=beside[1],
            progress=self._progress.share(self._route, self._left),
            ended=self.ended,
            red_lights=self.lights.run,
            waiting=waiting,
            neighbours=(NOBODY,) * 6 if gone else self._neighbours(),
            foe=foe(self._session, self._name) if self._sees_foes and not gone else NOBODY,
            target_speed=self.speed if self._target_speed is None else self._target_speed,
            fuel=self._fuel,
            electricity=self._electricity,
            overlap=self.overlap,
            on_road=self.ended == "arrived" or (self._is_on_lane and self.ended != "removed"),
        )

    def _neighbours(self) -> tuple[Neighbour, ...]:
        """Leaders and followers, the driver's left lane first; SUMO's left is that of the higher number."""
        found, (start, end, _) = neighbours(self._session, self._name), self._index
        last = self._network.road.count(start, end) - 1
        left, right = (self._network.sumo_index((start, end, place)) for place in (0, last))
        return found if left >= right else (*found[4:], *found[2:4], *found[:2])
