"""What scripts and subclasses that were written for highway-env meet of an environment."""

import copy
from collections.abc import Callable, Mapping
from functools import update_wrapper
from operator import attrgetter
from types import MethodType
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, TypeVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sumo_env.compat.views import RoadView, Vehicle, View, only_read, road_view
from sumo_env.config import COMMON, STOCK_FREQUENCY, Config, ConfigError, keys_of, resolve, tell_of_steps
from sumo_env.scene import PERCEPTION_DISTANCE, Scene
from sumo_env.spaces.actions import SIDES, ActionType, Situation, lane_after
from sumo_env.spaces.factory import Interface, interface
from sumo_env.tasks.base import EgoState, Task
from sumo_env.traffic.scenario import Scenario
from sumo_env.unsupported import NEVER_CALLED, missing, page

T = TypeVar("T")


class _ClassOrInstance:
    """A method of an environment, or of a class of environments where it is called on that, as in highway-env."""

    def __init__(self, function: Callable[[Any], Config]) -> None:
        self._function = function
        update_wrapper(self, function)  # type: ignore[arg-type]

    def __get__(self, instance: object, owner: type) -> MethodType:
        return MethodType(self._function, owner if instance is None else instance)


class_or_instance: Any = _ClassOrInstance  # subclasses may write a method or a class method
AFTER_RESET = ("vehicle", "controlled_vehicles", "road", "scene", "time", "steps", "ego_state", "ego_id")


def returned(owner: object, name: str, value: Any, kind: Callable[[Any], T]) -> T:
    """What a user's method has returned, as a number (float) or a dict. Raises TypeError if it is none."""
    try:
        return kind(value)
    except (TypeError, ValueError):
        wanted = "a number" if kind is float else "a dict"
        raise TypeError(f"{type(owner).__name__}.{name} must return {wanted}, not {value!r}") from None


if TYPE_CHECKING:
    _only_read = property
else:

    class _only_read(property):
        """A property of what the simulator decides, which scripts for highway-env might set."""

        def __set__(self, instance, value):
            raise only_read(self.fget.__name__)


def _of_car(name: str) -> Any:
    """An attribute of the ego's episode, as one of its environment."""
    return property(attrgetter(f"_car.{name}"), lambda env, value: setattr(env._car, name, value))


class ReadAsHighwayEnv(gym.Env[NDArray[np.float32], Any]):
    """The part of `DrivingEnv` that scripts and subclasses written for highway-env meet."""

    PERCEPTION_DISTANCE = PERCEPTION_DISTANCE  # [m]
    task: Task
    _is_raised = False  # whether the frequency of the simulation only follows that of the policy
    config: dict[str, Any]
    actions: dict[int, str]
    target_speeds: tuple[float, ...]
    _action_type: ActionType
    _observation_type: Any
    _own_observation: Any = None  # a subclass's
    _car: Any  # a `CarEpisode`, from the first reset on
    _access: Any  # a `SumoAccess`
    _screen: Any
    _asked: Config  # changes for the next episode
    render_mode: str | None
    steers: ClassVar[bool]
    scene: Scene = _of_car("scene")  # the present one, as the ego sees it
    ego_state: EgoState = _of_car("ego_state")
    steps: int = _of_car("steps")  # policy steps of this episode
    _view: RoadView | None = None

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            owner = type(self).__name__
            if "_access" not in vars(self):
                what = f"{owner!r} has no attribute {name!r}: its __init__ has to call super().__init__()"
                raise AttributeError(what, name=name)
            if name in AFTER_RESET:
                raise AttributeError(f"{owner!r} has no attribute {name!r}: call reset() first", name=name)
            raise missing(repr(owner), name, dir(type(self)))

    def _refuse_overrides(self) -> None:
        """A TypeError about what a subclass overrides as in highway-env, and nothing calls here."""
        for name, instead in NEVER_CALLED.items():
            if getattr(type(self), name, None) is not getattr(ReadAsHighwayEnv, name, None):
                owner = type(self).__name__
                where = page("from-highway-env", "subclasses")
                raise TypeError(f"{owner}.{name} would never be called: {instead} ({where})")

    @class_or_instance
    def default_config(self) -> Config:
        """Every key with its default. A subclass may change defaults and add keys for a reward of its own.

        Of an environment, or of a class, as in highway-env: ``HighwayEnv.default_config()``.
        """
        task = getattr(self, "task", None)  # a class may have none
        return copy.deepcopy({**COMMON, **(task.defaults if task else {})})

    def _defaults(self) -> Config:
        """What `default_config` returns, over the task's defaults. In a subclass it may be a class method.

        That asks its class for the task by ``super().default_config()``, so it is called on a class that has what this
        environment has.
        """
        defaults = self.default_config
        if isinstance(defaults.__self__, type):
            known: Any = type(type(self).__name__, (type(self),), vars(self))
            defaults = known.default_config
        return {**COMMON, **self.task.defaults, **returned(self, "default_config", defaults(), dict)}

    def _resolved(self, config: Mapping[str, Any] | None) -> tuple[Config, bool]:
        """The configuration with these changes, and whether its `simulation_frequency` is one that nobody asked for."""
        asked, frequency = {**keys_of(getattr(self, "config", {}))}, "simulation_frequency"
        if self._is_raised and asked[frequency] == STOCK_FREQUENCY:
            del asked[frequency]
        defaults = self._defaults()
        changed = resolve(self.task.name, defaults, asked, config)
        return changed, changed[frequency] != {**defaults, **asked, **(config or {})}[frequency]

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Change these keys of the configuration; they take effect at the next reset, before the first one at once."""
        asked = {**self._asked, **keys_of(config)}
        checked = self._checked(asked)
        if "_car" in vars(self):
            self._asked = asked
        else:
            self._take(*checked)

    def _checked(self, config: Config) -> tuple[Config, bool, Interface]:
        """The configuration with these changes, see `_resolved`, and its spaces. Raises ConfigError for wrong ones."""
        changed, is_raised = self._resolved(config)
        if changed.get("manual_control") and self.render_mode != "human":
            raise ConfigError("'manual_control' needs render_mode='human': keys are pressed in its window")
        offered = interface(self.task, changed, self.steers)
        if offered.action_type.names:
            self._access.refuse_backwards("'target_speeds'", offered.action_type.target_speeds[0])
        self._access.refuse_backwards("'initial_speed'", changed.get("initial_speed") or 0.0)
        tell_of_steps(self.task.frequency(changed), int(changed["policy_frequency"]), self._access.is_sumo)
        return changed, is_raised, offered

    def _take(self, config: Config, is_raised: bool, offered: Interface) -> None:
        """The next episode has this configuration."""
        self.config, self._is_raised, self._offered, self._asked = config, is_raised, offered, {}
        self._configured = copy.deepcopy(config)
        self.define_spaces()
        self._set_frame_rate()

    def define_spaces(self) -> None:
        """Set the types and spaces of observation and action, whenever the configuration changes."""
        self._action_type, self._observation_type = self._offered
        self.actions, self.target_speeds = self._action_type.names, self._action_type.target_speeds
        self._own_observation = None
        self.observation_space, self.action_space = self._observation_type.space, self._action_type.space

    def _observe(self) -> NDArray[np.float32]:
        if self._own_observation is not None:
            return self._own_observation.observe()
        seen: NDArray[np.float32] = self._observation_type.observe(self._car.situation(self.target_speeds))
        return seen

    @property
    def scenario(self) -> Scenario | None:
        """The present episode's, in which this car is the ego; None before the first reset."""
        return self._car.scenario if "_car" in vars(self) else None

    @_only_read
    def time(self) -> float:
        """Since the start of the episode [s]."""
        return self.steps / float(self.config["policy_frequency"])

    @_only_read
    def controlled_vehicles(self) -> list[Vehicle]:
        """The ego."""
        return [self.vehicle]

    @property
    def observation_type(self) -> Any:
        """The type of observation; ``observe()`` is the present observation. A subclass may set one of its own."""
        if self._own_observation is not None:
            return self._own_observation
        own, space = self._observation_type, self.observation_space
        return View(kind="observation type", _of=own, space=lambda: space, observe=self._observe)

    @observation_type.setter
    def observation_type(self, value: Any) -> None:
        self._own_observation = value

    @_only_read
    def road(self) -> RoadView:
        """The lanes (`road.network`) and the vehicles (`road.vehicles`) of the present scene."""
        now: Situation = self._car.situation(self.target_speeds)
        if self._view is None or self._view.scene is not now.scene:
            targets = {
                "target_lane_index": now.ego.target_lane,
                "speed_index": now.ego.speed_index,
                "target_speed": self.target_speeds[now.ego.speed_index],
                "target_speeds": np.array(self.target_speeds),
            }
            further, ego = self._car.episode.scenario.further, targets if self.actions else {}
            connected = bool(self.config.get("neighbour_vehicles_connected_lanes"))
            self._view = road_view(now, further, self._action_type, connected, **ego)
        return self._view

    @_only_read
    def vehicle(self) -> Vehicle:
        """The ego: position, speed, heading, lane_index, crashed, ..."""
        return self.road.vehicles[0]

    @property
    def action_type(self) -> Any:
        """The meta-actions: actions, actions_indexes, target_speeds, get_available_actions(); or those that steer."""
        named: dict[str, Any] = {
            "actions": self.actions,  # names by index
            "actions_indexes": {name: index for index, name in self.actions.items()},
            "target_speeds": np.array(self.target_speeds),  # [m/s]
            "get_available_actions": self.get_available_actions,
        }
        own, space = self._action_type, self.action_space
        return View(kind="action type", _of=own, space=lambda: space, **(named if self.actions else {}))

    def set_record_video_wrapper(self, wrapper: gym.wrappers.RecordVideo[Any, Any]) -> None:
        """Make a `gymnasium.wrappers.RecordVideo` film every simulation step, in real time, as in highway-env.

        >>> env = RecordVideo(gym.make("sumo/highway-v0", render_mode="rgb_array"), "videos")
        >>> env.unwrapped.set_record_video_wrapper(env)

        Without this call, a film has one frame per policy step. ``config["simulation_frequency"]`` is the frame rate.
        """
        self._screen.video = wrapper
        self._set_frame_rate()

    def _set_frame_rate(self) -> None:
        if self._screen.video is not None:
            frequency = self.task.frequency(self.config)
            self.metadata = {**self.metadata, "render_fps": frequency}
            self._screen.video.frames_per_sec = frequency

    def get_available_actions(self) -> list[int]:
        """Indices of IDLE, and of the actions that would change something now, in highway-env's order."""
        ego, now = self.ego_state, self._car.situation(self.target_speeds)
        kept = lane_after("IDLE", now)
        possible = {
            "IDLE": True,
            **{name: lane_after(name, now) != kept for name in SIDES},
            "FASTER": ego.speed_index < ego.speed_count - 1,
            "SLOWER": ego.speed_index > 0,
        }
        indices = {name: index for index, name in self.actions.items()}
        return [indices[name] for name, is_possible in possible.items() if is_possible and name in indices]
