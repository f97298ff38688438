"""highway-env's types of action: a gymnasium space, and a function from an action to the command for a simulator.

`DiscreteMetaAction` changes the ego's target speed and target lane, and the simulator decides how the ego reaches them;
`ContinuousAction` and `DiscreteAction` are its acceleration and the angle of its front wheels. All are pure functions
of the road and the scene (``highway_env.envs.common.action``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product
from math import isfinite, pi
from operator import index
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from sumo_env.config import ConfigError
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.scene import Place
from sumo_env.simulator import EgoCommand, SteeringCommand
from sumo_env.tasks.base import TARGET_SPEEDS, lmap, nearest_index
from sumo_env.traffic.scenario import VehicleSpec

NO_ACTION = -1  # in ``info``, at a reset
MOST_PER_AXIS = 100  # actions; their product is a table
PlainAction = int | float | tuple[float, ...]


class Moment(NamedTuple):
    """What a meta-action depends on, before a policy step.

    Attributes:
        road: its lanes.
        route: nodes of the ego's route.
        target_lane: that the ego steers for.
        speed_index: of the ego's target speed.
        x, y: where the ego is [m].
        speed: of the ego [m/s].
        place: what SUMO says about where the ego is, among the traffic of its own files.
    """

    road: Road
    route: tuple[str, ...]
    target_lane: LaneIndex
    speed_index: int
    x: float
    y: float
    speed: float
    place: Place | None = None


# -- meta-actions --------------------------------------------------------------------------------------------------

LONGITUDINAL_AND_LATERAL = {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT", 3: "FASTER", 4: "SLOWER"}
LONGITUDINAL = {0: "SLOWER", 1: "IDLE", 2: "FASTER"}
LATERAL = {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT"}


def action_names(action: dict[str, Any]) -> dict[int, str]:
    """Meta-actions by index for a config's ``action`` entry (``DiscreteMetaAction``).

    Raises:
        ConfigError: the actions are neither longitudinal nor lateral.
    """
    longitudinal, lateral = action.get("longitudinal", True), action.get("lateral", True)
    if longitudinal and lateral:
        return LONGITUDINAL_AND_LATERAL
    if longitudinal:
        return LONGITUDINAL
    if lateral:
        return LATERAL
    raise ConfigError("the action must be longitudinal, lateral or both")


@dataclass(frozen=True)
class DiscreteMetaAction:
    """Lane changes and changes of the target speed.

    Attributes:
        names: meta-actions by index.
        target_speeds: that the ego can be commanded, rising [m/s].
    """

    names: dict[int, str]
    target_speeds: tuple[float, ...]
    steers = False
    no_action = NO_ACTION

    @property
    def space(self) -> spaces.Discrete:
        """The action space."""
        return spaces.Discrete(len(self.names))

    def command(self, action: Any, moment: Moment) -> EgoCommand:
        """The target speed and target lane after a meta-action; ValueError if there is no such one."""
        try:
            name = self.names[index(action)]
        except (KeyError, TypeError):
            raise ValueError(f"action must be one of {self.names}, not {action!r}") from None
        road, route, lane, previous, x, y, speed, place = moment
        target_speed = self.target_speeds[target_speed_index(name, previous, speed, self.target_speeds)]
        if place is not None:
            return EgoCommand(target_speed, lane_beside(name, place, lane))
        return EgoCommand(target_speed, target_lane(name, road, lane, route, x, y))

    def plain(self, action: Any) -> int:
        """The index of an action."""
        return int(action)


def target_speed_index(action: str, index: int, speed: float, target_speeds: tuple[float, ...]) -> int:
    """Index of the target speed after a meta-action; `index` is the previous one, `speed` the measured speed [m/s]."""
    if action not in ("FASTER", "SLOWER"):
        return index
    # relative to the measured speed, not to the previous target
    wanted = nearest_index(speed, target_speeds) + (1 if action == "FASTER" else -1)
    return min(max(wanted, 0), len(target_speeds) - 1)


def target_lane(
    action: str, road: Road, lane: LaneIndex, route: tuple[str, ...], x: float, y: float
) -> LaneIndex:
    """Target lane after a meta-action of the ego at (x, y) [m]; `lane` is the previous one."""
    lane = follow_road(road, lane, route, x, y)
    if action in ("LANE_LEFT", "LANE_RIGHT"):
        start, end, place = lane
        last = road.count(start, end) - 1
        beside = (start, end, min(max(place + (1 if action == "LANE_RIGHT" else -1), 0), last))
        if road.lane(beside).is_reachable_from(x, y):
            return beside
    return lane


def lane_beside(action: str, place: Place, lane: LaneIndex) -> LaneIndex:
    """Target lane after a meta-action where SUMO says what may be done; `lane` is the previous one.

    A lane change that is not allowed leaves the target lane, and a target lane of another road has become the present
    lane.
    """
    start, end, number = place.lane
    if (action == "LANE_LEFT" and place.left) or (action == "LANE_RIGHT" and place.right):
        return start, end, number + (1 if action == "LANE_RIGHT" else -1)
    return lane if lane[:2] == (start, end) else place.lane


def follow_road(road: Road, lane: LaneIndex, route: tuple[str, ...], x: float, y: float) -> LaneIndex:
    """The lane to steer for at (x, y) [m]: `lane`, or at its end the next one of the route."""
    return road.next_lane(lane, route, x, y) if road.lane(lane).after_end(x, y) else lane


def ego_route(road: Road, ego: VehicleSpec) -> tuple[str, ...]:
    """Nodes of the ego's route, from the start of its first lane to its destination."""
    start, end, _ = ego.lane
    if ego.destination is None or ego.destination == end:
        return (start, end)
    return (start, *road.route(end, ego.destination))


# -- pedals and steering wheel -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ContinuousAction:
    """The ego's acceleration, the angle of its front wheels, or both in this order, each from -1 to 1.

    Attributes:
        acceleration_range: that -1 and 1 stand for [m/s2].
        steering_range: likewise [rad].
        speed_range: speeds beyond which the ego is slowed down softly [m/s]; None: highway-env's 40 m/s either way.
        longitudinal, lateral: which of the two there are; the other one is 0.
        dynamical: whether tyres slip (``BicycleVehicle``).
        clip: whether numbers beyond -1 and 1 are clipped.
    """

    acceleration_range: tuple[float, float] = (-5.0, 5.0)
    steering_range: tuple[float, float] = (-pi / 4, pi / 4)
    speed_range: tuple[float, float] | None = None
    longitudinal: bool = True
    lateral: bool = True
    dynamical: bool = False
    clip: bool = True
    # by which highway-env pays a car that has no target speeds (``MDPVehicle.get_speed_index``)
    target_speeds = TARGET_SPEEDS
    names: ClassVar[dict[int, str]] = {}  # there are no meta-actions
    steers = True

    @property
    def size(self) -> int:
        """Number of axes."""
        return int(self.longitudinal) + int(self.lateral)

    @cached_property
    def space(self) -> spaces.Space[Any]:
        """The action space."""
        return spaces.Box(-1.0, 1.0, (self.size,), np.float32)

    @property
    def no_action(self) -> Any:
        """Zeros."""
        return np.zeros(self.size, np.float32)

    def command(self, action: Any, moment: Moment) -> SteeringCommand:
        """The pedals and the steering wheel; ValueError if these are not the axes' numbers."""
        if np.shape(action) != self.space.shape:
            raise ValueError(f"action must be one of {self.space}, not {action!r}")
        acceleration, steering = self.controls(self.numbers(action))
        return SteeringCommand(float(acceleration), float(steering), self.speed_range, self.dynamical)

    def plain(self, action: Any) -> PlainAction:
        """A number, or a tuple of both."""
        values = tuple(map(float, action))
        return values if len(values) > 1 else values[0]

    def numbers(self, actions: Any) -> NDArray[Any]:
        """Actions as numbers, shape (..., size), here one action or several; ValueError if they are none."""
        values = np.asarray(actions)
        if (
            values.shape[-1:] != (self.size,)
            or not np.issubdtype(values.dtype, np.number)
            or not np.isfinite(values).all()
        ):
            raise ValueError(f"action must be {self.size} finite numbers from -1 to 1, not {actions!r}")
        return values

    def controls(self, numbers: NDArray[Any]) -> tuple[Any, Any]:
        """Accelerations [m/s2] and angles [rad], shape (...), of numbers of shape (..., size).

        In the precision of the numbers, as highway-env computes them.
        """
        if self.clip:
            numbers = np.clip(numbers, -1, 1)
        nothing = np.zeros(numbers.shape[:-1])
        first: Any = numbers[..., 0]
        last: Any = numbers[..., -1]
        return (
            lmap(first, (-1, 1), self.acceleration_range) if self.longitudinal else nothing,
            lmap(last, (-1, 1), self.steering_range) if self.lateral else nothing,
        )


@dataclass(frozen=True)
class DiscreteAction(ContinuousAction):
    """A grid of the accelerations and angles of `ContinuousAction`, the acceleration's axis first.

    Attributes:
        actions_per_axis: numbers from -1 to 1 on each.
    """

    actions_per_axis: int = 3
    no_action = NO_ACTION

    @cached_property
    def space(self) -> spaces.Space[Any]:
        """The action space."""
        return spaces.Discrete(self.actions_per_axis**self.size)

    @cached_property
    def _table(self) -> NDArray[Any]:
        ends = np.ones(self.size, np.float32)
        return np.array(list(product(*np.linspace(-ends, ends, self.actions_per_axis).T)))

    def plain(self, action: Any) -> int:
        """The index of an action."""
        return int(action)

    def numbers(self, actions: Any) -> NDArray[Any]:
        """The numbers that indices of actions stand for, shape (..., size); ValueError if there is none."""
        places, count = np.asarray(actions), len(self._table)
        if not np.issubdtype(places.dtype, np.integer) or not ((places >= 0) & (places < count)).all():
            raise ValueError(f"action must be a whole number from 0 to {count - 1}, not {actions!r}")
        return self._table[places]


# -- configuration -------------------------------------------------------------------------------------------------

# Each has a `space`, the `names` of its meta-actions, and says whether it `steers`: then the ego has no target lane and
# no target speed. `command` makes the command for a policy step; `plain` is the action for `EgoState.action`.
ActionType = DiscreteMetaAction | ContinuousAction


def action_type(action: Mapping[str, Any], target_speeds: tuple[float, ...]) -> ActionType:
    """What a config's ``action`` entry says; target_speeds [m/s]: the task's, where the entry has none.

    Raises:
        ConfigError: a value that makes no sense.
    """
    if action["type"] == "DiscreteMetaAction":
        return DiscreteMetaAction(action_names(dict(action)), _rising(action, target_speeds))
    given: dict[str, Any] = {}
    for name, value in action.items():
        if name.endswith("_range") and value:
            given[name] = _range(name, value)
        elif name in ("longitudinal", "lateral", "dynamical", "clip"):
            given[name] = bool(value)
    if not (given.get("longitudinal", True) or given.get("lateral", True)):
        raise ConfigError("the action must be longitudinal, lateral or both")
    if action["type"] == "ContinuousAction":
        return ContinuousAction(**given)
    count = action.get("actions_per_axis", 3)
    if count != int(count) or not 1 <= count <= MOST_PER_AXIS:
        raise ConfigError(
            f"'actions_per_axis' must be a whole number from 1 to {MOST_PER_AXIS}, not {count!r}"
        )
    return DiscreteAction(**{**given, "actions_per_axis": int(count)})


def _rising(action: Mapping[str, Any], default: tuple[float, ...]) -> tuple[float, ...]:
    """The target speeds of an entry [m/s]."""
    ladder = action.get("target_speeds") or default
    try:
        speeds = tuple(float(speed) for speed in ladder)
    except (TypeError, ValueError):
        speeds = ()
    rising = all(low < high for low, high in pairwise(speeds))  # which is false for NaN
    if len(speeds) < 2 or not rising or not isfinite(speeds[-1] - speeds[0]):
        raise ConfigError(f"'target_speeds' must be at least two rising speeds [m/s], not {ladder!r}")
    return speeds


def _range(name: str, given: Any) -> tuple[float, float]:
    """A range of an entry."""
    try:
        low, high = (float(number) for number in given)
    except (TypeError, ValueError):
        low = high = np.nan
    if not (np.isfinite([low, high]).all() and low < high):
        raise ConfigError(f"action {name!r} must be two rising numbers, not {given!r}")
    return low, high
