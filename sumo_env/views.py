"""The scene under highway-env's names: ``env.unwrapped.vehicle``, ``.road`` and ``.action_type``, to be read only.

Rewards and scripts written for highway-env read the ego's position, speed or lane from these. They are pictures of the
present scene: a simulator drives the vehicles, so nothing can be changed through them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from math import cos, sin
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sumo_env.actions import ActionType as Kind
from sumo_env.networks.lanes import Lane
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.scene import Floats, Scene
from sumo_env.tasks.base import EgoState

PAGE = "docs/from-highway-env.md says what to use"
# Methods of highway-env's environments that subclasses override there and that would never be called here.
NEVER_CALLED = (
    *("_make_road", "_create_road", "_make_vehicles", "_create_vehicles", "_spawn_vehicle"),
    *("_clear_vehicles", "_reset", "_simulate", "define_spaces", "has_arrived"),
    *("_agent_reward", "_agent_rewards"),
)


class _View:
    """Values that can only be read; an error about another one says which there are."""

    def __init__(self, **values: Any) -> None:
        vars(self).update(values)

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(
            f"{name!r} can only be read: the simulator drives the vehicles. To change traffic use a task or drivers "
            "of your own, or reset(options={'scenario': ...}) (docs/own-parts.md)"
        )


class Vehicle(_View):
    """A vehicle of the scene, as ``highway_env.vehicle.kinematics.Vehicle`` is read."""

    id: str  # its name, "ego" for the ego
    position: Floats  # centre (x, y) [m]
    speed: float  # [m/s]
    heading: float  # [rad]
    crashed: bool
    LENGTH: float  # [m]
    WIDTH: float  # [m]
    _road: Road

    @cached_property
    def lane_index(self) -> LaneIndex:
        """Index of the closest lane."""
        x, y = self.position.tolist()
        return self._road.closest_lane(x, y, self.heading)

    @property
    def lane(self) -> Lane:
        """The closest lane; its methods take x and y."""
        return self._road.lane(self.lane_index)

    @property
    def on_road(self) -> bool:
        """Whether the centre is on the closest lane."""
        return self.lane.on_lane(*self.position.tolist())

    @property
    def direction(self) -> Floats:
        """Unit vector along the heading."""
        return np.array([cos(self.heading), sin(self.heading)])

    @property
    def velocity(self) -> Floats:
        """[m/s]."""
        return self.speed * self.direction


class Ego(Vehicle):
    """The ego, as ``highway_env.vehicle.controller.MDPVehicle`` is read."""

    target_lane_index: LaneIndex  # that it steers for
    speed_index: int  # of its target speed
    target_speed: float  # that it approaches [m/s]
    target_speeds: NDArray[np.float64]  # that it can be commanded [m/s]


class RoadNetwork(_View):
    """The lanes, as ``highway_env.road.road.RoadNetwork`` is asked for them; `road` has the rest."""

    road: Road

    def get_lane(self, index: LaneIndex) -> Lane:
        """The lane of an index."""
        return self.road.lane(index)

    def side_lanes(self, index: LaneIndex) -> list[LaneIndex]:
        """Lanes beside one, the left one first."""
        return list(self.road.side_lanes(index))

    def all_side_lanes(self, index: LaneIndex) -> list[LaneIndex]:
        """All lanes of the same road."""
        return [(*index[:2], lane) for lane in range(self.road.count(*index[:2]))]

    def get_closest_lane_index(self, position: Any, heading: float | None = None) -> LaneIndex:
        """Index of the lane closest to (x, y) [m]."""
        return self.road.closest_lane(float(position[0]), float(position[1]), heading)


class RoadView(_View):
    """Road and traffic of a scene, as ``highway_env.road.road.Road`` is read."""

    network: RoadNetwork  # the lanes
    vehicles: tuple[Vehicle, ...]  # all of the scene, the ego first
    scene: Scene  # places and speeds of all vehicles as arrays


def road_view(scene: Scene, road: Road, **ego: Any) -> RoadView:
    """A scene as highway-env's road; `ego`: the further attributes of the ego."""
    positions = np.column_stack((scene.x, scene.y))
    positions.flags.writeable = False
    vehicles = []
    for row, name in enumerate(scene.ids):
        length, width = scene.size(name)
        make, further = (Vehicle, {}) if row else (Ego, ego)
        vehicles.append(
            make(
                id=name,
                position=positions[row],
                speed=scene.speed.item(row),
                heading=scene.heading.item(row),
                crashed=scene.crashed.item(row),
                LENGTH=length,
                WIDTH=width,
                _road=road,
                **further,
            )
        )
    return RoadView(network=RoadNetwork(road=road), vehicles=tuple(vehicles), scene=scene)


class ActionType(NamedTuple):
    """The meta-actions, as ``highway_env.envs.common.action.DiscreteMetaAction`` is read."""

    actions: dict[int, str]  # names by index
    actions_indexes: dict[str, int]  # indices by name
    target_speeds: NDArray[np.float64]  # [m/s]
    get_available_actions: Callable[[], list[int]]  # `ReadAsHighwayEnv.get_available_actions`


class ReadAsHighwayEnv(gym.Env[NDArray[np.float32], Any]):
    """The part of `DrivingEnv` that scripts and subclasses written for highway-env meet."""

    scene: Scene
    ego_state: EgoState
    actions: dict[int, str]
    target_speeds: tuple[float, ...]
    _action_type: Kind
    _road: Road
    _target_lane: LaneIndex
    _speed_index: int
    _view: RoadView | None = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name in NEVER_CALLED:
            if name in vars(cls):
                raise TypeError(f"{cls.__name__}.{name} would never be called; {PAGE}")

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            hint = "call reset() first" if name in ("vehicle", "road", "scene") else PAGE
            raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}: {hint}")

    @property
    def road(self) -> RoadView:
        """The lanes (`road.network`) and the vehicles (`road.vehicles`) of the present scene."""
        if self._view is None or self._view.scene is not self.scene:
            targets = {
                "target_lane_index": self._target_lane,
                "speed_index": self._speed_index,
                "target_speed": self.target_speeds[self._speed_index],
                "target_speeds": np.array(self.target_speeds),
            }
            self._view = road_view(self.scene, self._road, **(targets if self.actions else {}))
        return self._view

    @property
    def vehicle(self) -> Vehicle:
        """The ego: position, speed, heading, lane_index, crashed, ..."""
        return self.road.vehicles[0]

    @property
    def action_type(self) -> Any:
        """The meta-actions: actions, actions_indexes, target_speeds, get_available_actions(); or `ContinuousAction`."""
        if not self.actions:
            return self._action_type
        indexes = {name: index for index, name in self.actions.items()}
        return ActionType(self.actions, indexes, np.array(self.target_speeds), self.get_available_actions)

    def get_available_actions(self) -> list[int]:
        """Indices of the actions that would change something now, and of IDLE."""
        x, y, lane, road = self.scene.x.item(0), self.scene.y.item(0), self.ego_state.lane, self._road
        beside = {
            other[2] - lane[2] for other in road.side_lanes(lane) if road.lane(other).is_reachable_from(x, y)
        }
        possible = {
            "IDLE": True,
            "LANE_LEFT": -1 in beside,
            "LANE_RIGHT": 1 in beside,
            "FASTER": self._speed_index < len(self.target_speeds) - 1,
            "SLOWER": self._speed_index > 0,
        }
        if (place := self.scene.place) is not None:
            possible |= {"LANE_LEFT": place.left, "LANE_RIGHT": place.right}
        return [index for index, name in self.actions.items() if possible[name]]
