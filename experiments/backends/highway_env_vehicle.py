"""highway-env's driver with a scenario's numbers and manoeuvres, and a variant that measures along the path.

Parameters are set on the instance, never on the class: highway-env's intersection changes the class, and with
it every other task of the process.
"""

from typing import Any, Self

from highway_env.road.lane import AbstractLane
from highway_env.road.road import LaneIndex, Road
from highway_env.utils import not_zero
from highway_env.vehicle.behavior import IDMVehicle, LinearVehicle
from highway_env.vehicle.kinematics import Vehicle

from sumo_env.replica.linear import LinearDriver
from sumo_env.scene import VEHICLE_LENGTH
from sumo_env.traffic.risk import SWERVE_TIME
from sumo_env.traffic.scenario import VehicleSpec

ALMOST = 1e-9  # [s] rounding of sums of steps


class ScenarioVehicle(IDMVehicle):
    """A driver of a `Scenario`: IDM and MOBIL as in highway-env, and what risk events make it do.

    Attributes:
        id: name of the vehicle.
        gives_way: whether the driver obeys the intersection's rule.
    """

    id: str = ""
    gives_way: bool = True
    target_lane_index: LaneIndex
    _cuts_in = False  # a forced lane change is running
    _swerve_left = 0.0  # [s] until a swerve into the oncoming lane ends

    @classmethod
    def place(cls, road: Road, spec: VehicleSpec) -> Self:
        """The vehicle of a scenario as it is at its start."""
        vehicle = cls(road, [spec.x, spec.y], spec.heading, spec.speed, enable_lane_change=spec.changes_lanes)
        # the constructor takes the closest lane, which is a guess where lanes cross, and takes 0 for "not given"
        vehicle.lane_index = vehicle.target_lane_index = spec.lane
        vehicle.lane = road.network.get_lane(spec.lane)
        vehicle.target_speed = spec.target_speed
        vehicle.timer = spec.timer
        if spec.destination is not None:
            vehicle.plan_route_to(spec.destination)
        driver = spec.driver
        vehicle.id, vehicle.gives_way = spec.id, driver.gives_way
        vehicle.COMFORT_ACC_MAX, vehicle.COMFORT_ACC_MIN = driver.accel, -driver.decel
        vehicle.DISTANCE_WANTED = driver.min_gap + VEHICLE_LENGTH  # between centres
        vehicle.TIME_WANTED, vehicle.DELTA = driver.tau, driver.delta
        vehicle.ACC_MAX = driver.emergency_decel
        vehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED = driver.safe_braking
        vehicle.LANE_CHANGE_MIN_ACC_GAIN = driver.min_gain
        return vehicle

    def lanes_beside(self, direction: int) -> list[LaneIndex]:
        """The lanes that a cut-in may go to, the preferred one first; -1 is left, +1 right."""
        start, end, lane = self.target_lane_index
        lanes = self.road.network.graph[start][end]
        beside = [k for k in (lane + direction, lane - direction) if 0 <= k < len(lanes)]
        return [(start, end, k) for k in beside if not lanes[k].forbidden]

    def cut_in(self, lane: LaneIndex) -> None:
        """Head for this lane at once, whatever MOBIL says, until it is reached."""
        self.target_lane_index = lane
        self._cuts_in = True

    def swerve(self, lane: LaneIndex) -> None:
        """Head for the oncoming lane, left of one's own, and come back after SWERVE_TIME."""
        self._swerves_from, self.target_lane_index = self.target_lane_index, lane
        self._swerve_left = SWERVE_TIME

    def change_lane_policy(self) -> None:
        """MOBIL, and giving up a change that another driver makes too; not during a forced change."""
        if self._cuts_in and self.lane_index != self.target_lane_index:
            return
        self._cuts_in = False
        super().change_lane_policy()

    def step(self, dt: float) -> None:
        """Move by `dt` [s]; a swerve whose time is over ends."""
        super().step(dt)
        if self._swerve_left > 0.0:
            self._swerve_left -= dt
            if self._swerve_left <= ALMOST:
                self._swerve_left = 0.0
                self.target_lane_index = self._swerves_from


class PathVehicle(ScenarioVehicle):
    """A driver who sees leaders beyond the end of the lane as far away and as fast as they are.

    highway-env, with connected lanes, projects them on the follower's lane and heading: beyond a bend a leader
    looks nearer than it is and one that drives away looks stopped, so that cars brake for nothing.
    """

    def acceleration(
        self, ego_vehicle: Any, front_vehicle: Vehicle | None = None, rear_vehicle: Vehicle | None = None
    ) -> float:
        """``IDMVehicle.acceleration`` [m/s2], with the distance along the path and the difference of speeds."""
        distance = distance_beyond(ego_vehicle, front_vehicle) if ego_vehicle and front_vehicle else None
        if distance is None:
            return float(super().acceleration(ego_vehicle, front_vehicle, rear_vehicle))
        wanted = self.desired_gap(ego_vehicle, front_vehicle, projected=False)
        free = float(super().acceleration(ego_vehicle))
        ratio = float(wanted / not_zero(distance))
        return free - self.COMFORT_ACC_MAX * (ratio * ratio)


class LinearScenarioVehicle(ScenarioVehicle, LinearVehicle):
    """A risky driver of the law "linear": highway-env's LinearVehicle with a scenario's parameters."""

    def drive_as(self, driver: LinearDriver) -> None:
        """Take over the parameters of a driver."""
        self.ACCELERATION_PARAMETERS = list(driver.acceleration)
        self.STEERING_PARAMETERS = list(driver.steering)
        self.TIME_WANTED = LinearVehicle.TIME_WANTED
        self.collecting_data = False  # for regressions, in every sub-step


class PathLinearVehicle(LinearScenarioVehicle):
    """A LinearVehicle that sees leaders beyond the end of the lane as far away as they are."""

    def acceleration_features(
        self, ego_vehicle: Any, front_vehicle: Vehicle | None = None, rear_vehicle: Vehicle | None = None
    ) -> Any:
        """``LinearVehicle.acceleration_features``, with the distance along the path."""
        features = super().acceleration_features(ego_vehicle, front_vehicle, rear_vehicle)
        distance = distance_beyond(ego_vehicle, front_vehicle) if ego_vehicle and front_vehicle else None
        if distance is not None:
            safe = self.DISTANCE_WANTED + max(ego_vehicle.speed, 0.0) * self.TIME_WANTED
            features[2] = min(distance - safe, 0.0)
        return features


def distance_beyond(vehicle: Any, front: Vehicle) -> float | None:
    """Way to a vehicle on one of the lanes that follow [m]; None if it is on the vehicle's own road, or on none."""
    network = vehicle.road.network
    start, end, _ = vehicle.lane_index
    if any(lane.on_lane(front.position, margin=1) for lane in network.graph[start][end]):
        return None
    own = vehicle.lane
    following = _successors(network, vehicle.lane_index, own.length)
    if vehicle.target_lane_index[:2] != (start, end):  # at the end of a lane the next one is steered for
        target = network.get_lane(vehicle.target_lane_index)
        following.append((target, own.length))
        following += _successors(network, vehicle.target_lane_index, own.length + target.length)
    for lane, offset in following:
        if lane.on_lane(front.position, margin=1):
            place = lane.local_coordinates(front.position)[0] - own.local_coordinates(vehicle.position)[0]
            return float(place + offset)
    return None


def _successors(network: Any, index: LaneIndex, offset: float) -> list[tuple[AbstractLane, float]]:
    """The lanes that ``Road.neighbour_vehicles`` looks at beyond a lane, each with where it begins [m]."""
    roads = network.graph.get(index[1], {}).values()
    return [(lanes[index[2]] if index[2] < len(lanes) else lanes[0], offset) for lanes in roads]
