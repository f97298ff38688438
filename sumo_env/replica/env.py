"""`ReplicaEnv`: highway-env's environments on the compiled physics, with highway-env's own seeds or with ours."""

import copy
import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from sumo_env.compat.as_highway_env import class_or_instance
from sumo_env.config import (
    COMMON,
    STOCK_FREQUENCY,
    Config,
    ConfigError,
    ignore,
    one_of,
    refuse_arguments,
)
from sumo_env.env.driving import DrivingEnv, Observation
from sumo_env.env.episode import CarEpisode, EgoPlace, Episode
from sumo_env.replica import draws
from sumo_env.replica.batch import Start
from sumo_env.replica.draws import INSTEAD
from sumo_env.replica.linear import LAWS
from sumo_env.replica.linear import draw as draw_linear
from sumo_env.replica.observation import form_of
from sumo_env.replica.simulator import Replica
from sumo_env.spaces.factory import Interface
from sumo_env.spaces.observation import OFFSETS, Kinematics
from sumo_env.tasks import get_task
from sumo_env.tasks.base import Task
from sumo_env.tasks.reset_options import VARIED
from sumo_env.traffic.scenario import Scenario
from sumo_env.traffic.tilt import TILTED

SCENARIOS = ("highway-env", "seeded")
# Policy steps of tasks that have no duration: ``max_episode_steps`` of the registration, which merge-v0 lacks, too.
TIME_LIMITS = {"two-way": 15, "merge": 2**31 - 1}
# highway-env's default observations where those of `sumo_env` differ.
OBSERVATIONS: dict[str, Config] = {
    "two-way": {"type": "TimeToCollision", "horizon": 5},
    "u-turn": {"type": "TimeToCollision", "horizon": 16},
}
CONNECTED: Config = {"neighbour_vehicles_connected_lanes": True}
# What later versions of highway-env's environments change, by task and version.
VERSIONS: dict[tuple[str, int], Config] = {
    ("roundabout", 1): CONNECTED,
    ("u-turn", 1): CONNECTED,
    ("intersection", 1): {  # ``ContinuousIntersectionEnv``
        "observation": {
            **get_task("intersection").defaults["observation"],
            "vehicles_count": 5,
            "features": ["presence", "x", "y", "vx", "vy", *OFFSETS],
        },
        "action": {
            "type": "ContinuousAction",
            "steering_range": [-math.pi / 3, math.pi / 3],
            "longitudinal": True,
            "lateral": True,
            "dynamical": True,
            "target_speeds": [0, 4.5, 9],
        },
    },
    ("intersection", 2): CONNECTED,
    ("merge", 1): CONNECTED,
    ("exit", 1): CONNECTED,
}
# Keys of `sumo_env` that highway-env's task does not have.
ADDED_KEYS: dict[str, tuple[str, ...]] = {
    "two-way": ("vehicles_count", "oncoming_vehicles_count", "road_length", "duration"),
    "roundabout": ("vehicles_count",),
    "u-turn": ("vehicles_count",),
    "merge": ("vehicles_count", "duration"),
}


class ReplicaEnv(DrivingEnv):
    """A task on highway-env's physics, with all of highway-env's types of action.

    Args:
        task: its name, or highway-fast: the highway with the defaults of highway-fast-v0, which looks for the ego's
            contacts alone.
        config: configuration keys to change.
        render_mode: None or ``"rgb_array"``.
        scenarios: "highway-env": ``reset(seed=s)`` starts the episode that it starts in highway-env, and the
            configuration's defaults are highway-env's; "seeded": the traffic of `sumo_env`, with ``risk``.
        variant: see `Replica`.
        risk_law: of seeded scenarios, "standard" or "linear".
        version: of highway-env's environment, whose defaults the configuration has.

    Raises:
        ConfigError: unknown task, key or name, wrong value.
    """

    steers = True
    is_stock, _versioned = True, Config()  # of the class, which has no arguments

    def __init__(
        self,
        task: str | Task,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        scenarios: str = SCENARIOS[0],
        variant: str = "stock",
        risk_law: str = LAWS[0],
        version: int = 0,
        **unknown: Any,
    ) -> None:
        if version and (task, version) not in VERSIONS:
            known = ", ".join(f"{name}-v{number}" for name, number in VERSIONS)
            raise ConfigError(f"there is no version {version!r} of {task!r}; later versions are {known}")
        self._versioned = VERSIONS.get((str(task), version), {})
        self.is_stock = one_of("scenarios", scenarios, SCENARIOS) == SCENARIOS[0]
        self._is_linear = one_of("risk_law", risk_law, LAWS) == "linear"
        self.replica = Replica(variant, self._is_linear, ego_contacts=task == "highway-fast")
        refuse_arguments(unknown, {**COMMON, **get_task(task).defaults})
        super().__init__(task, config, render_mode, self.replica)

    # -- configuration -------------------------------------------------------------------------------------

    @class_or_instance
    def default_config(self) -> Config:
        """Every key with its default."""
        defaults = super().default_config()
        task = getattr(self, "task", None)  # the class has none
        if "simulation_frequency" not in getattr(task, "defaults", {}):
            defaults["simulation_frequency"] = STOCK_FREQUENCY
        if self.is_stock:
            defaults["neighbour_vehicles_connected_lanes"] = False
            if task and task.name in OBSERVATIONS:
                defaults["observation"] = dict(OBSERVATIONS[task.name])
        return {**defaults, **copy.deepcopy(self._versioned)}

    def _checked(self, config: Config) -> tuple[Config, bool, Interface]:
        return super()._checked(self._without_ours(config) if self.is_stock else config)

    def _take(self, config: Config, is_raised: bool, offered: Interface) -> None:
        super()._take(config, is_raised, offered)
        if self.is_stock or self._versioned:
            self.replica.connected = bool(self.config.get("neighbour_vehicles_connected_lanes", False))
        kinematics = self._observation_type
        self.form = form_of(kinematics) if isinstance(kinematics, Kinematics) else None

    def _without_ours(self, config: Mapping[str, Any]) -> Config:
        """The configuration without keys that highway-env's task does not have, which it ignores.

        Raises:
            ConfigError: `risk`, which nobody wants to be ignored.
        """
        defaults, known = self._defaults(), {**getattr(self, "config", {}), **config}
        if known.get("risk", 0.0) != 0.0:
            raise ConfigError(
                f"config key 'risk' can only be 0.0, not {known['risk']!r}: highway-env's "
                f"{self.task.name}-v0 has no such key; {INSTEAD}"
            )
        ours = ADDED_KEYS.get(self.task.name, ())
        for key in ours:
            if known.get(key, defaults[key]) != defaults[key]:
                ignore(f"the task {self.task.name!r}", key, INSTEAD)
                if hasattr(self, "config"):
                    self.config[key] = defaults[key]
        return {key: value for key, value in config.items() if key not in ours}

    # -- gymnasium -----------------------------------------------------------------------------------------

    def start_episode(self, seed: int | None, options: dict[str, Any] | None) -> Episode:
        """See `DrivingEnv.start_episode`."""
        if tilted := [name for name in TILTED if name in (options or {})]:
            raise ConfigError(
                f"{', '.join(tilted)}: on the replica, events come as often as drawn; sumo/* has it"
            )
        varied = [part for part in VARIED if part in (options or {})]
        if varied and self.is_stock:
            raise ConfigError(f"highway-env has no {', '.join(varied)} that a reset could vary; {INSTEAD}")
        self.draws_arrivals = False
        episode = super().start_episode(seed, options)
        if self._action_type.steers:  # who steers follows no route
            episode.specs |= {car.id: car._replace(destination=None) for car in episode.scenario.cars}
        return episode

    def _imagined(self, seed: int) -> Scenario:
        return draws.with_other_drivers(super()._imagined(seed), seed)

    def _draw(self, task: Task) -> Scenario:
        if self.is_stock:
            self.draws_arrivals = task.name == "intersection"
            return draws.draw(task, self._law, self.np_random, self.replica.warm_up)
        if self._is_linear:
            return draw_linear(task, self._law, int(self.np_random.integers(2**31)))
        return super()._draw(task)

    def draw_arrival(self) -> None:
        """As highway-env's intersection draws it."""
        if self.draws_arrivals:
            episode, centres = self._car.episode, self.replica.staying()
            spawn = draws.arrival(self.config, self._car.road, self.np_random, centres, self.steps)
            if spawn is not None:
                episode.scenario = self.replica.expect(spawn)
                episode.specs[spawn.vehicle.id] = spawn.vehicle

    def _shuffling(self, car: CarEpisode) -> np.random.Generator:
        return self.np_random if self.is_stock else super()._shuffling(car)

    def begin(self) -> Start:
        """The traffic of the next episode, for a batch: drawn as by `reset`, with `np_random`."""
        return self.replica.load(self._draw(self.task))

    def time_limit(self) -> int:
        """Policy steps after which time is up."""
        if self.is_stock and self.task.name in TIME_LIMITS:
            return TIME_LIMITS[self.task.name]
        return _time_limit(self.config["duration"], self.config["policy_frequency"], self.is_stock)

    def _is_truncated(self) -> bool:
        return self.steps >= self.time_limit()

    # -- what the ego sees ---------------------------------------------------------------------------------

    def _ego_place(self) -> EgoPlace:
        whole: Any = self._car.episode.simulator
        if whole is not self._access.given:  # it is the first learning car's
            self.replica = whole.seen_by(self._car.id)
        return self.replica.ego_place()

    def _observe(self) -> Observation:
        if self._own_observation is not None or self.form is None:
            self._car.before_ego = self.replica.before_ego()
            return super()._observe()
        table = self.replica.table(self.form)
        if self.form.is_shuffled:
            self._car.rng.shuffle(table[1:])
        return table


@lru_cache
def _time_limit(duration: float, frequency: float, added_up: bool) -> int:
    """Policy steps of an episode of this duration [s]; highway-env adds up times, rounding included."""
    steps, time = 0, 0.0
    while time < duration:
        steps += 1
        time = time + 1 / frequency if added_up else steps / frequency
    return steps
