"""highway-env's types of action: a gymnasium space, and a function from an action to the command for a simulator.

`DiscreteMetaAction` changes the ego's target speed and target lane, and the simulator decides how the ego reaches them;
`ContinuousAction` and `DiscreteAction` are its acceleration and the angle of its front wheels or, on SUMO, which moves
cars along lanes, the lane. All are pure functions of the road and the scene (``highway_env.envs.common.action``).
Where the configuration says "sumo" in place of True, SUMO drives what the agent does not (`EgoCommand`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product
from math import inf, isfinite, pi
from operator import index
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from sumo_env.config import ConfigError, whole_number
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.scene import MAX_SPEED, Place, Scene
from sumo_env.simulator import Command, EgoCommand, SteeringCommand
from sumo_env.tasks.base import TARGET_SPEEDS, EgoState, lmap, nearest_index
from sumo_env.traffic.scenario import VehicleSpec

NO_ACTION = -1  # in ``info``, at a reset
MOST_PER_AXIS = 100  # actions; their product is a table
BY_SUMO = "sumo"  # a value of the keys 'longitudinal' and 'lateral'
CHANGES_LANE = 1 / 3  # the lateral number of `ContinuousAction` beyond which the ego changes lane on SUMO
PlainAction = int | float | tuple[float, ...]


class Situation(NamedTuple):
    """What actions and observations are made of, before a policy step.

    before_ego: others that are first in their cell of a grid, before the ego; is_first: of an episode.
    """

    scene: Scene
    road: Road
    ego: EgoState
    specs: Mapping[str, VehicleSpec]  # of the vehicles, by id
    rng: np.random.Generator  # shuffles the rows of a table
    target_speeds: tuple[float, ...]  # that the ego can be commanded [m/s]
    route: tuple[str, ...]  # nodes of the ego's
    before_ego: int = 0
    is_first: bool = False


# -- meta-actions --------------------------------------------------------------------------------------------------

# by whether they are longitudinal, and lateral
NAMES = {
    (True, True): {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT", 3: "FASTER", 4: "SLOWER"},
    (True, False): {0: "SLOWER", 1: "IDLE", 2: "FASTER"},
    (False, True): {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT"},
    (False, False): {0: "IDLE"},
}
SIDES = {"LANE_LEFT": -1, "LANE_RIGHT": 1}


@dataclass(frozen=True)
class DiscreteMetaAction:
    """Lane changes and changes of the target speed."""

    names: dict[int, str]  # meta-actions by index
    target_speeds: tuple[float, ...]  # that the ego can be commanded, rising [m/s]
    by_sumo: tuple[bool, bool] = (False, False)  # whether SUMO drives the ego's speed, and its lanes
    steers = False
    no_action = NO_ACTION

    @property
    def space(self) -> spaces.Discrete:
        """The action space."""
        return spaces.Discrete(len(self.names))

    def command(self, action: Any, now: Situation) -> EgoCommand:
        """The target speed and target lane after a meta-action; ValueError if there is no such one."""
        try:
            name = self.names[index(action)]
        except (KeyError, TypeError):
            raise ValueError(f"action must be one of {self.names}, not {action!r}") from None
        index_of_speed = target_speed_index(name, now.ego.speed_index, now.ego.speed, self.target_speeds)
        return _commanded(self.by_sumo, self.target_speeds[index_of_speed], name, now)


def _commanded(
    by_sumo: tuple[bool, bool], speed: float, change: str, now: Situation, acceleration: float | None = None
) -> EgoCommand:
    """The command to approach a speed [m/s] and to change lanes, but for what SUMO drives."""
    lane = None if by_sumo[1] else lane_after(change, now)
    return EgoCommand(None if by_sumo[0] else speed, lane, acceleration)


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
    lane = road.follow(lane, route, x, y)
    beside = road.beside(lane, SIDES[action]) if action in SIDES else None
    # the lane of oncoming traffic goes on beyond highway-env's
    if beside is not None and (road.oncoming or road.lane(beside).is_reachable_from(x, y)):
        return beside
    return lane


def lane_after(action: str, now: Situation) -> LaneIndex:
    """Target lane after a meta-action, by what SUMO or else the road says may be done."""
    scene, lane = now.scene, now.ego.target_lane
    if scene.place is not None:
        return lane_beside(action, scene.place, lane)
    return target_lane(action, now.road, lane, now.route, scene.x.item(0), scene.y.item(0))


def lane_beside(action: str, place: Place, lane: LaneIndex) -> LaneIndex:
    """Target lane after a meta-action where SUMO says what may be done; `lane` is the previous one.

    A lane change that is not allowed leaves the target lane, and a target lane of another road has become the present
    lane.
    """
    start, end, number = place.lane
    if (action == "LANE_LEFT" and place.left) or (action == "LANE_RIGHT" and place.right):
        return start, end, number + (1 if action == "LANE_RIGHT" else -1)
    return lane if lane[:2] == (start, end) else place.lane


# -- pedals and steering wheel -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ContinuousAction:
    """The ego's acceleration, the angle of its front wheels, or both in this order, each from -1 to 1.

    Where it does not steer, the second number changes lanes: below -1/3 to the left, above 1/3 to the right.
    """

    acceleration_range: tuple[float, float] = (-5.0, 5.0)  # that -1 and 1 stand for [m/s2]
    steering_range: tuple[float, float] = (-pi / 4, pi / 4)  # likewise [rad]
    # speeds beyond which the ego is slowed down softly [m/s]; None: highway-env's 40 m/s either way. On SUMO it stops
    # accelerating and braking there, and at 0.
    speed_range: tuple[float, float] | None = None
    longitudinal: bool = True  # whether there is the first of the two, which is 0 else
    lateral: bool = True  # likewise the second
    dynamical: bool = False  # whether tyres slip (``BicycleVehicle``)
    clip: bool = True  # whether numbers beyond -1 and 1 are clipped
    by_sumo: tuple[bool, bool] = (False, False)  # whether SUMO drives the ego's speed, and its lanes
    steers: bool = True  # whether the angle is that of the front wheels
    # by which highway-env pays a car that has no target speeds (``MDPVehicle.get_speed_index``)
    target_speeds = TARGET_SPEEDS
    names: ClassVar[dict[int, str]] = {}  # there are no meta-actions

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

    def command(self, action: Any, now: Situation) -> Command:
        """The pedals and the steering wheel, or the lane; ValueError if these are not the axes' numbers."""
        if np.shape(action) != self.space.shape:
            raise ValueError(f"action must be one of {self.space}, not {action!r}")
        acceleration, steering = map(float, self.controls(self.numbers(action)))
        if self.steers:
            return SteeringCommand(acceleration, steering, self.speed_range, self.dynamical)
        low, high = self.speed_range or (0.0, MAX_SPEED)
        speed = high if acceleration > 0.0 else max(low, 0.0) if acceleration < 0.0 else now.ego.speed
        change = (
            "LANE_LEFT" if steering < -CHANGES_LANE else "LANE_RIGHT" if steering > CHANGES_LANE else "IDLE"
        )
        return _commanded(self.by_sumo, speed, change, now, abs(acceleration))

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
        values: Any = numbers
        nothing = np.zeros(numbers.shape[:-1])
        return (
            lmap(values[..., 0], (-1, 1), self.acceleration_range) if self.longitudinal else nothing,
            lmap(values[..., -1], (-1, 1), self.steering_range) if self.lateral else nothing,
        )


@dataclass(frozen=True)
class DiscreteAction(ContinuousAction):
    """A grid of the accelerations and angles of `ContinuousAction`, the acceleration's axis first."""

    actions_per_axis: int = 3  # numbers from -1 to 1 on each
    no_action = NO_ACTION

    @cached_property
    def space(self) -> spaces.Space[Any]:
        """The action space."""
        return spaces.Discrete(self.actions_per_axis**self.size)

    @cached_property
    def _table(self) -> NDArray[Any]:
        ends = np.ones(self.size, np.float32)
        return np.array(list(product(*np.linspace(-ends, ends, self.actions_per_axis).T)))

    def numbers(self, actions: Any) -> NDArray[Any]:
        """The numbers that indices of actions stand for, shape (..., size); ValueError if there is none."""
        places, count = np.asarray(actions), len(self._table)
        if not np.issubdtype(places.dtype, np.integer) or not ((places >= 0) & (places < count)).all():
            raise ValueError(f"action must be a whole number from 0 to {count - 1}, not {actions!r}")
        return self._table[places]


# -- configuration -------------------------------------------------------------------------------------------------

# Each has a `space`, the `names` of its meta-actions, and says whether it `steers`: then the ego has no target lane and
# no target speed. `command` makes the command for a policy step.
ActionType = DiscreteMetaAction | ContinuousAction


def action_type(action: Mapping[str, Any], target_speeds: tuple[float, ...], steers: bool) -> ActionType:
    """What a config's ``action`` entry says; target_speeds [m/s]: the task's, where the entry has none.

    steers: whether the simulator steers the ego's wheels; else it is SUMO.

    Raises:
        ConfigError: a value that makes no sense, or that the simulator has no use for.
    """
    kind, axes = action["type"], [action.get(name, True) for name in ("longitudinal", "lateral")]
    if not any(axes):
        raise ConfigError("the action must be longitudinal, lateral or both")
    lengthwise, sideways = (axis == BY_SUMO for axis in axes)
    if steers and (lengthwise or sideways):
        raise ConfigError("SUMO drives nothing on the replica: 'longitudinal', 'lateral' are True or False")
    agent = bool(axes[0]) and not lengthwise, bool(axes[1]) and not sideways
    shared: dict[str, Any] = {"by_sumo": (lengthwise, sideways)}
    if kind == "DiscreteMetaAction":
        own = action.get("target_speeds")
        speeds = _rising("'target_speeds' [m/s]", target_speeds if own is None else own)
        return DiscreteMetaAction(NAMES[agent], speeds, **shared)
    given = shared | {name: bool(action[name]) for name in ("dynamical", "clip") if name in action}
    ranges = [name for name in action if name.endswith("_range") and action[name]]
    given |= {name: _rising(f"action {name!r}", action[name], most=2) for name in ranges}
    if not steers:
        if "steering_range" in given or given.get("dynamical"):
            key = "steering_range" if "steering_range" in given else "dynamical"
            raise ConfigError(f"{key!r} is for replica/*: SUMO's cars keep to lanes")
        given["steering_range"] = -1.0, 1.0
    given |= {"longitudinal": agent[0], "lateral": agent[1], "steers": steers}
    if kind == "ContinuousAction" and any(agent):
        return ContinuousAction(**given)
    count = whole_number("'actions_per_axis'", action.get("actions_per_axis", 3), MOST_PER_AXIS)
    return DiscreteAction(**{**given, "actions_per_axis": count})


def plain(action: Any) -> PlainAction:
    """An action for `EgoState.action`: an index, a number, or a tuple of both numbers."""
    if np.ndim(action) == 0:
        return int(action)
    values = tuple(map(float, action))
    return values if len(values) > 1 else values[0]


def _rising(what: str, given: Any, most: float = inf) -> tuple[float, ...]:
    """Two or more finite numbers of an entry, the larger one after the smaller."""
    try:
        numbers = tuple(float(number) for number in given)
    except (TypeError, ValueError):
        numbers = ()
    rises = all(low < high for low, high in pairwise(numbers))  # which is false for NaN
    if not 2 <= len(numbers) <= most or not rises or not isfinite(numbers[-1] - numbers[0]):
        count = "two" if most == 2 else "at least two"
        raise ConfigError(f"{what} must be {count} rising numbers, not {given!r}")
    return numbers
