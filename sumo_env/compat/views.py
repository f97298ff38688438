"""The scene under highway-env's names: ``env.unwrapped.vehicle``, ``.road`` and ``.action_type``, to be read only.

Rewards and scripts written for highway-env read the ego's position, speed or lane from these. They are pictures of the
present scene: a simulator drives the vehicles, so nothing can be changed through them.
"""

import sys
from collections.abc import Container, Mapping, Sequence
from functools import cached_property
from importlib import import_module
from math import cos, sin
from operator import itemgetter
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from sumo_env.networks.lanes import Lane, wrap_to_pi
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.scene import Floats, Scene, is_obstacle
from sumo_env.spaces.actions import ActionType as Kind
from sumo_env.spaces.actions import Situation
from sumo_env.spaces.observation import FEATURES, destination_direction
from sumo_env.traffic.scenario import VehicleSpec
from sumo_env.unsupported import missing, page

# Methods of lanes that take a place.
OF_PLACES = {"local_coordinates", "on_lane", "is_reachable_from", "after_end", "distance"}
# Modules of highway-env and, where it has another name there, the class that views stand for.
THEIRS = {
    "Vehicle": "vehicle.behavior:IDMVehicle",
    "DiscreteMetaAction ego": "vehicle.controller:MDPVehicle",
    "ContinuousAction ego": "vehicle.kinematics:Vehicle",
    "DiscreteAction ego": "vehicle.kinematics:Vehicle",
    "dynamical ego": "vehicle.dynamics:BicycleVehicle",
    "Obstacle": "vehicle.objects:Obstacle",
    "RoadView": "road.road:Road",
    "intersection": "road.regulation:RegulatedRoad",
    "RoadNetwork": "road.road",
    **dict.fromkeys(("StraightLane", "SineLane", "CircularLane", "PolyLane"), "road.lane"),
    **dict.fromkeys(("DiscreteMetaAction", "ContinuousAction", "DiscreteAction"), "envs.common.action"),
    "Kinematics": "envs.common.observation:KinematicObservation",
    "ExitObservation": "envs.common.observation",
    "TimeToCollision": "envs.common.observation:TimeToCollisionObservation",
    "OccupancyGrid": "envs.common.observation:OccupancyGridObservation",
    "Lidar": "envs.common.observation:LidarObservation",
}


def only_read(name: str) -> AttributeError:
    """The error about writing what a simulator decides."""
    return AttributeError(
        f"{name!r} can only be read: the simulator drives the vehicles. To change traffic use a task or drivers of "
        f"your own, or reset(options={{'scenario': ...}}) ({page('own-parts')})"
    )


class _Vehicles(tuple["Vehicle", ...]):
    """All vehicles; in highway-env, scripts append to this list."""

    def __getattr__(self, name: str) -> NoReturn:
        raise only_read("vehicles") if hasattr(list, name) else AttributeError(name)

    def __setitem__(self, index: object, value: object = None) -> NoReturn:
        raise only_read("vehicles")

    __delitem__: Any = __setitem__


class View:
    """Values that can only be read; an error about another one says what to use instead."""

    kind: str = "view"  # as users know it; a copy has no values yet while it is made
    _of: object = None  # what has the public attributes that the view itself lacks
    _theirs = ""  # a key of `THEIRS`; else that of the class of `_of`, or of the view

    def __init__(self, **values: Any) -> None:
        vars(self).update(values)

    @property  # type: ignore[misc]
    def __class__(self) -> type:
        """highway-env's own class if that is imported, so that ``isinstance`` answers as in highway-env."""
        name = self._theirs or type(self if self._of is None else self._of).__name__
        if "highway_env" not in sys.modules or name not in THEIRS:
            return type(self)
        module, _, other = THEIRS[name].partition(":")
        return getattr(import_module(f"highway_env.{module}"), other or name, type(self))

    def __dir__(self) -> list[str]:
        return [*dir(type(self)), *vars(self), *(name for name in dir(self._of) if name[0] != "_")]

    def __reduce__(self) -> tuple[Any, ...]:
        return object.__new__, (type(self),), vars(self)  # not by `__class__`

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise only_read(name)

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("_") and hasattr(self._of, name):
            return getattr(self._of, name)
        raise missing(f"the {self.kind}", name, dir(self))


class LaneView(View):
    """A lane, as ``highway_env.road.lane.AbstractLane`` is read.

    The methods `OF_PLACES` are those of `Lane`; a place in the world is a position (x, y) [m], or x and y.
    """

    kind = "lane"
    _of: Lane

    def __getattr__(self, name: str) -> Any:
        found = super().__getattr__(name)
        return (lambda *place, **more: found(*_at(place), **more)) if name in OF_PLACES else found

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LaneView) and self._of == other._of

    def __hash__(self) -> int:
        return hash(self._of)

    def __repr__(self) -> str:
        return repr(self._of)

    def position(self, longitudinal: float, lateral: float) -> Floats:
        """The place (x, y) of a point of the lane [m]."""
        return np.array(self._of.position(float(longitudinal), float(lateral)))

    def width_at(self, longitudinal: float) -> float:
        """[m]."""
        return self._of.width

    def local_angle(self, heading: float, longitudinal: float) -> float:
        """A heading relative to the lane's, in [-pi, pi)."""
        return wrap_to_pi(heading - self._of.heading_at(float(longitudinal)))

    def distance_with_heading(self, position: Any, heading: float | None) -> float:
        """L1 distance of a position to the lane [m], and 1 m for each radian between the headings."""
        return self._of.distance(*_at((position,)), heading)


def _at(place: tuple[Any, ...]) -> tuple[float, float]:
    """x and y [m] of a position, or of x and y themselves."""
    x, y = place[0] if np.ndim(place[0]) else place[:2]
    return float(x), float(y)


class Vehicle(View):
    """A vehicle of the scene, as ``highway_env.vehicle.kinematics.Vehicle`` is read."""

    kind = "vehicle"
    id: str  # its name, "ego" for the ego
    position: Floats  # centre (x, y) [m]
    speed: float  # [m/s]
    heading: float  # [rad]
    crashed: bool
    target_speed: float  # that its driver wants, or the ego approaches [m/s]
    LENGTH: float  # [m]
    WIDTH: float  # [m]
    road: "RoadView"  # the road and all vehicles

    def __repr__(self) -> str:
        x, y = self.position
        return f"{type(self).__name__} {self.id!r} at ({x:.1f}, {y:.1f}) m, {self.speed:.1f} m/s, on {self.lane_index}"

    @cached_property
    def lane_index(self) -> LaneIndex:
        """Index of the closest lane."""
        return self.road.network.get_closest_lane_index(self.position, self.heading)

    @property
    def lane(self) -> LaneView:
        """The closest lane."""
        return self.road.network.get_lane(self.lane_index)

    @property
    def lane_offset(self) -> Floats:
        """Longitudinal and lateral place in the closest lane [m], and the angle to it [rad]."""
        s, lateral = self.lane.local_coordinates(self.position)
        return np.array([s, lateral, self.lane.local_angle(self.heading, s)])

    @property
    def on_road(self) -> bool:
        """Whether the centre is on the closest lane."""
        return self.lane.on_lane(self.position)

    @property
    def direction(self) -> Floats:
        """Unit vector along the heading."""
        return np.array([cos(self.heading), sin(self.heading)])

    @property
    def destination_direction(self) -> Floats:
        """Unit vector to the end of its route; zeros without a route."""
        view = self.road
        row = view.scene.ids.index(self.id)
        return np.array(destination_direction(view.scene, view.network.road, row, view.specs.get(self.id)))

    @property
    def velocity(self) -> Floats:
        """[m/s]."""
        return self.speed * self.direction

    def lane_distance_to(self, other: "Vehicle | None", lane: LaneView | None = None) -> float:
        """How far ahead another vehicle is along a lane, by default the own one [m]; NaN without another vehicle."""
        if other is None:
            return float("nan")
        along = lane or self.lane
        return along.local_coordinates(other.position)[0] - along.local_coordinates(self.position)[0]

    def front_distance_to(self, other: "Vehicle") -> float:
        """How far ahead another vehicle is along the own heading [m]."""
        return float(self.direction.dot(other.position - self.position))

    def to_dict(self, origin_vehicle: "Vehicle | None" = None) -> dict[str, float]:
        """The features of `Kinematics` [m, m/s, rad]; places and velocities relative to another vehicle, if given."""
        goal = self.destination_direction
        own = (self.velocity, [self.heading], self.direction, goal, self.lane_offset)
        values = np.concatenate((self.position, *own)).tolist()
        if origin_vehicle is not None:
            origin = np.concatenate((origin_vehicle.position, origin_vehicle.velocity))
            values[:4] = (np.array(values[:4]) - origin).tolist()
        return {"presence": 1, **dict(zip(FEATURES[1:], values, strict=True))}


class Ego(Vehicle):
    """The ego, as ``highway_env.vehicle.controller.MDPVehicle`` is read."""

    target_lane_index: LaneIndex  # that it steers for
    speed_index: int  # of its target speed
    target_speeds: NDArray[np.float64]  # that it can be commanded [m/s]


class RoadNetwork(View):
    """The lanes, as ``highway_env.road.road.RoadNetwork`` is asked for them; `road` has the rest."""

    kind = "network"
    road: Road

    def __repr__(self) -> str:
        return repr(self.road)

    @cached_property
    def graph(self) -> dict[str, dict[str, list[LaneView]]]:
        """The lanes by the nodes where they begin and end."""
        graph: dict[str, dict[str, list[LaneView]]] = {}
        for (start, end, _), lane in self.lanes_dict().items():
            graph.setdefault(start, {}).setdefault(end, []).append(lane)
        return graph

    def lanes_dict(self) -> dict[LaneIndex, LaneView]:
        """All lanes by their index."""
        return {index: LaneView(_of=lane) for index, lane in self.road.lanes.items()}

    def lanes_list(self) -> list[LaneView]:
        """All lanes."""
        return list(self.lanes_dict().values())

    def get_lane(self, index: LaneIndex) -> LaneView:
        """The lane of an index."""
        return LaneView(_of=self.road.lane((*index[:2], index[2] or 0)))

    def side_lanes(self, index: LaneIndex) -> list[LaneIndex]:
        """Lanes beside one, the left one first."""
        return [lane for lane in self.all_side_lanes(index) if abs(lane[2] - index[2]) == 1]

    def all_side_lanes(self, index: LaneIndex) -> list[LaneIndex]:
        """All lanes of the same road."""
        return [(*index[:2], lane) for lane in range(self.road.count(*index[:2]))]

    def get_closest_lane_index(self, position: Any, heading: float | None = None) -> LaneIndex:
        """Index of the lane closest to (x, y) [m]."""
        return self.road.closest_lane(float(position[0]), float(position[1]), heading)


class RoadView(View):
    """Road and traffic of a scene, as ``highway_env.road.road.Road`` is read."""

    kind = "road"
    network: RoadNetwork  # the lanes
    vehicles: tuple[Vehicle, ...]  # all of the scene, the ego first
    objects: tuple[Vehicle, ...] = ()  # obstacles
    scene: Scene  # places and speeds of all vehicles as arrays
    specs: Mapping[str, VehicleSpec]  # what vehicles were made from, by id
    neighbour_vehicles_connected_lanes: bool  # whether neighbours are looked for on the next lanes too

    def __repr__(self) -> str:
        return repr(self.vehicles)

    def neighbour_vehicles(
        self, vehicle: Vehicle, lane_index: LaneIndex | None = None
    ) -> tuple[Vehicle | None, Vehicle | None]:
        """The nearest vehicles ahead and behind on a lane, by default the vehicle's own; None where there is none."""
        index = lane_index or vehicle.lane_index
        lanes = [(self.network.get_lane(index), 0.0), *self._connected(index)]
        here = lanes[0][0].local_coordinates(vehicle.position)[0]
        places: list[tuple[float, Vehicle]] = []
        for other in (*self.vehicles, *self.objects):
            on = [each for each in lanes if each[0].on_lane(other.position, margin=1.0)]
            if other is not vehicle and on:
                lane, offset = on[0]
                places.append((lane.local_coordinates(other.position)[0] + offset - here, other))
        # of two at the same place, highway-env takes the later one ahead and the earlier one behind
        ahead = min(
            reversed([each for each in places if each[0] >= 0.0]), key=itemgetter(0), default=(0.0, None)
        )
        behind = max((each for each in places if each[0] < 0.0), key=itemgetter(0), default=(0.0, None))
        return ahead[1], behind[1]

    def _connected(self, index: LaneIndex) -> list[tuple[LaneView, float]]:
        """The lanes before and after one, each with its distance along that one [m]."""
        if not self.neighbour_vehicles_connected_lanes:
            return []
        (start, end, number), graph = index, self.network.graph

        def beside(lanes: Sequence[LaneView]) -> LaneView:
            return lanes[number] if number < len(lanes) else lanes[0]

        length = graph[start][end][number].length
        after = [(beside(lanes), length) for lanes in graph.get(end, {}).values()]
        before = [beside(ends[start]) for ends in graph.values() if start in ends]
        return [*after, *((lane, -lane.length) for lane in before)]

    def close_vehicles_to(
        self,
        vehicle: Vehicle,
        distance: float,
        count: int | None = None,
        see_behind: bool = True,
    ) -> list[Vehicle]:
        """The other vehicles within a distance [m], the nearest along the lane first."""
        close = [
            other
            for other in self.vehicles
            if other is not vehicle
            and np.linalg.norm(other.position - vehicle.position) < distance
            and (see_behind or vehicle.lane_distance_to(other) > -2 * vehicle.LENGTH)
        ]
        close.sort(key=lambda other: abs(vehicle.lane_distance_to(other)))
        return close[:count] if count else close


def road_view(
    now: Situation, further: Container[str], actions: Kind, connected: bool, **ego: Any
) -> RoadView:
    """A scene as highway-env's road; `further`: ids of learning cars beside the ego, `ego`: its attributes alone."""
    scene, road, specs = now.scene, now.road, now.specs
    learning = "dynamical ego" if getattr(actions, "dynamical", False) else f"{type(actions).__name__} ego"
    positions = np.column_stack((scene.x, scene.y))
    positions.flags.writeable = False
    view = RoadView(
        _theirs=road.name if road.name in THEIRS else "",
        network=RoadNetwork(road=road),
        scene=scene,
        specs=specs,
        neighbour_vehicles_connected_lanes=connected,
    )
    vehicles = []
    for row, name in enumerate(scene.ids):
        length, width = scene.size(name)
        spec = specs.get(name)
        make, more = (Vehicle, {"target_speed": spec.target_speed} if spec else {}) if row else (Ego, ego)
        vehicles.append(
            make(
                id=name,
                position=positions[row],
                speed=scene.speed.item(row),
                heading=scene.heading.item(row),
                crashed=scene.crashed.item(row),
                LENGTH=length,
                WIDTH=width,
                road=view,
                _theirs=learning if row == 0 or name in further else "Obstacle" if is_obstacle(name) else "",
                **more,
            )
        )
    vars(view)["vehicles"] = _Vehicles(vehicle for vehicle in vehicles if not is_obstacle(vehicle.id))
    vars(view)["objects"] = _Vehicles(vehicle for vehicle in vehicles if is_obstacle(vehicle.id))
    return view
