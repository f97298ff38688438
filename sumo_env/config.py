"""Configuration: highway-env's keys, checked. Each default is defined once, in `KEYS` or in its task's file."""

import copy
import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np

from sumo_env.unsupported import TYPES as NOT_HERE
from sumo_env.unsupported import did_you_mean, page

Config = dict[str, Any]

MEASURED = "measured"
DRIVERS = ("highway-env", MEASURED)
STEP_ERROR = 0.0101  # of SUMO's step: 1 %, and rounding
STOCK_FREQUENCY = 15  # [Hz] highway-env's ``simulation_frequency``
MOST_ENVS = 1_000_000  # side by side
MOST_VEHICLES = 10_000  # more would take all memory or all time


@dataclass(frozen=True)
class Key:
    """What holds for a key of the configuration in every task that has it: a row of `KEYS`."""

    # where a task says no other one; None: only tasks whose `defaults` name the key have it
    default: Any = None
    within: str = ""  # limits of a number, such as "(0, 1000]"; "" for none
    is_whole: bool = False  # whether the number must be whole
    like: Any = None  # what a value is like where the default is None, which it may be too
    renamed: str = ""  # by other tasks or earlier versions of highway-env

    def check(self, key: str, default: Any, value: Any) -> None:
        """Raises ConfigError where a task in which the key has this default cannot have this value."""
        if value is not None or default is not None:
            _check_kind(f"config key {key!r}", self.like if default is None else default, value)
        if not self.within or value is None:
            return
        (least, most), is_open = map(float, self.within[1:-1].split(",")), self.within[0] == "("
        if self.is_whole:
            whole_number(f"config key {key!r}", value, int(most), int(least) + is_open)
        elif not least <= value <= most or (value == least and is_open):
            raise ConfigError(f"config key {key!r} must lie in {self.within}, not {value!r}")


# A row a key: those of all tasks, then those of some that have limits. Of others the default says what they may be.
KEYS = {
    # [Hz] SUMO's step is its inverse (highway-env: 15)
    "simulation_frequency": Key(10, "(0, 1000]", is_whole=True),
    "policy_frequency": Key(1, "(0, 1000]", is_whole=True),  # [Hz]
    "risk": Key(0.0, "[0, 1]"),  # dose of risky traffic, 0 (regular) to 1
    "drivers": Key("highway-env"),  # one of `DRIVERS`: whose numbers the other drivers have
    "screen_width": Key(600, "(0, 10000]", is_whole=True),  # [px]
    "screen_height": Key(150, "(0, 10000]", is_whole=True),  # [px]
    "scaling": Key(5.5, "(0, inf]"),  # [px/m]
    "centering_position": Key([0.3, 0.5]),
    "vehicles_count": Key(within=f"[0, {MOST_VEHICLES}]", is_whole=True, renamed="initial_vehicle_count"),
    "initial_vehicle_count": Key(within=f"[0, {MOST_VEHICLES}]", is_whole=True, renamed="vehicles_count"),
    "oncoming_vehicles_count": Key(within=f"[0, {MOST_VEHICLES}]", is_whole=True),
    "lanes_count": Key(within="(0, 6]", is_whole=True),  # `networks.plans.LANES_COUNTS`
    "ego_spacing": Key(within="[0, inf]", renamed="initial_spacing"),
    "vehicles_density": Key(within="(0, inf]"),
    "road_length": Key(within="(0, 100000]"),  # [m]
    "duration": Key(within="(0, 100000]"),  # [s] SUMO's clock counts milliseconds
    "spawn_probability": Key(within="[0, 1]"),
    "reward_speed_range": Key(like=[0.0, 1.0]),  # [m/s]
    "initial_speed": Key(within="[0, 1000]", like=0),  # [m/s]
    "time_gap": Key(within="(0, 100000]"),  # [s]
    "begin": Key(within="[0, 1e10]", like=0),  # [s]
    "warm_up": Key(within="[0, 100000]"),  # [s]
    "wait": Key(within="[0, 100000]"),  # [s]
}
WEIGHT = Key(within="[-1e9, 1e9]")  # of a term of the reward
COMMON: Config = {key: row.default for key, row in KEYS.items() if row.default is not None}

DISCRETE_META_ACTION: Config = {"type": "DiscreteMetaAction", "longitudinal": True, "lateral": True}
CONTINUOUS_ACTION: Config = {
    "type": "ContinuousAction",
    "acceleration_range": None,
    "steering_range": None,
    "speed_range": None,
    "longitudinal": True,
    "lateral": True,
    "dynamical": False,
    "clip": True,
    "target_speeds": None,  # accepted as in highway-env, where intersection-v1 has some without effect
}
DISCRETE_ACTION: Config = {
    **{key: value for key, value in CONTINUOUS_ACTION.items() if key != "speed_range"},
    "type": "DiscreteAction",
    "actions_per_axis": 3,
}
# The types of observation and action, with the defaults of their keys (None: see `observation`, `actions`).
KINEMATICS: Config = {
    "type": "Kinematics",
    "features": None,
    "vehicles_count": 5,
    "features_range": None,
    "absolute": False,
    "order": "sorted",
    "normalize": True,
    "clip": True,
    "see_behind": False,
    "observe_intentions": False,
    "include_obstacles": True,
    "flatten": False,
}
EXIT: Config = {**KINEMATICS, "type": "ExitObservation"}
OCCUPANCY_GRID: Config = {
    "type": "OccupancyGrid",
    "features": None,
    "grid_size": None,  # [m]
    "grid_step": None,  # [m]
    "features_range": None,
    "absolute": False,
    "align_to_vehicle_axes": False,
    "clip": True,
    "as_image": False,
}
TIME_TO_COLLISION: Config = {"type": "TimeToCollision", "horizon": 10}
GRAYSCALE: Config = {
    "type": "GrayscaleObservation",
    "observation_shape": [84, 84],  # [px]
    "stack_size": 4,
    "weights": [0.2989, 0.5870, 0.1140],  # of red, green and blue
    "scaling": None,  # [px/m]
    "centering_position": None,
}
LIDAR: Config = {"type": "LidarObservation", "cells": 16, "maximum_range": 60.0, "normalize": True}  # [m]
LEADERS_FOLLOWERS: Config = {"type": "LeadersFollowers", "features": None, "normalize": True}
TYPES: dict[str, tuple[Config, ...]] = {
    "observation": (KINEMATICS, EXIT, TIME_TO_COLLISION, OCCUPANCY_GRID, GRAYSCALE, LIDAR, LEADERS_FOLLOWERS),
    "action": ({**DISCRETE_META_ACTION, "target_speeds": None}, CONTINUOUS_ACTION, DISCRETE_ACTION),
}
# Keys of highway-env and rl-agents that the tasks on SUMO do not have. A whole configuration of theirs is accepted if
# it describes the same task and kept: these keys have no effect, and those of `FIXED` may only have one value.
# rl-agents hands its whole JSON file to `configure`.
WITHOUT_EFFECT = {
    *("id", "import_module", "offscreen_rendering", "real_time_rendering", "render_agent", "show_history"),
    *("show_trajectories", "neighbour_vehicles_connected_lanes"),
    "manual_control",  # of a window (`screen`)
}
FIXED: dict[str, tuple[Any, str]] = {
    "controlled_vehicles": (
        1,
        "gymnasium.make with this key, or sumo_env.parallel_env, makes environments of several learning cars "
        "(docs/several-cars.md)",
    ),
    "obey_traffic_lights": (False, "this road has no traffic lights"),
    "other_vehicles_type": (
        "highway_env.vehicle.behavior.IDMVehicle",
        f"SUMO drives the other vehicles of sumo/* ({page('own-parts')} brings drivers of your own), and replica/* has "
        "IDMVehicle compiled; 'risk' makes both risky",
    ),
}
# Tasks whose configurations are highway-env's. Keys of its other environments and versions, and of our other tasks, are
# ignored there with a warning, as highway-env does; so are unknown keys of its observations and actions.
HIGHWAY_ENVS = ("highway", "two-way", "roundabout", "intersection", "u-turn", "merge", "exit")
IGNORED = {
    *("action_reward", "add_walls", "after_merge_length", "arrived_reward", "before_merge_length"),
    *("block_lane", "converge_merge_length", "derivative_noise", "destination", "ego_spacing"),
    *("force_decision", "goal_reward", "incoming_vehicle_destination", "initial_lane_id"),
    *("initial_spacing", "initial_vehicle_count", "lane_centering_cost", "lane_centering_reward"),
    *("lane_change_reward", "lanes_count", "left_lane_constraint", "left_lane_reward", "length"),
    *("merging_speed_reward", "no_lanes", "normalize_reward", "offroad_terminal"),
    *("oncoming_vehicles_count", "other_vehicles", "parallel_merge_length", "reward_speed_range"),
    *("reward_weights", "right_lane_reward", "road_length", "roundabout_lanes", "roundabout_radius"),
    *("spawn_probability", "speed_limit", "state_noise", "steering_range", "success_goal_reward"),
    *("terminate_off_road", "vehicles_count", "vehicles_density"),
}
# Arguments of some environments, and of which.
ARGUMENTS = {
    **dict.fromkeys(("sumo_options", "live", "output_dir"), "single environments on SUMO"),
    **dict.fromkeys(("scenarios", "variant", "risk_law"), "replica/*"),
    **dict.fromkeys(("ego_route", "ego_trips", "ego_vehicle", "ego_type", "routes"), "SumoDrivingEnv"),
    **dict.fromkeys(("vehicles", "vehicle_type", "max_cars"), "parallel_env of SUMO's files"),
}


class ConfigError(ValueError):
    """The configuration is invalid; the message names the key, the reason, and what is accepted."""


def nearest(word: str, choices: Mapping[str, Any] | set[str] | list[str]) -> str:
    """End of an error message: the nearest known word, or all known words."""
    known = sorted(map(str, choices))
    return did_you_mean(str(word), known) or f"known: {', '.join(known)}"


def _meant(key: str, known: Mapping[str, Any]) -> str:
    """End of an error message: the known key that an unknown key must mean, or all known keys.

    An unknown key is taken for a spelling mistake where at most four letters of both keys are not in the other one.
    Keys that look less alike, such as those of the left and the right lane, mean something else.
    """
    for name in known:
        alike = difflib.SequenceMatcher(None, name, key).ratio()
        if KEYS.get(name, Key()).renamed == key or (alike > 0.6 and (1.0 - alike) * len(name + key) < 4.5):
            return f"did you mean {name!r}?"
    return f"known: {', '.join(sorted(known))}"


def one_of(name: str, value: Any, choices: tuple[str, ...]) -> str:
    """The value of an argument of this name that can only be one of some words. Raises ConfigError: it is none."""
    if value not in choices:
        raise ConfigError(f"unknown {name} {value!r}: {nearest(str(value), list(choices))}")
    return str(value)


def whole_number(name: str, value: Any, most: int, least: int = 1) -> int:
    """A value that can only be a whole number from `least` to `most`. Raises ConfigError: it is none."""
    if not isinstance(value, int | float) or not least <= value <= most or value != int(value):
        raise ConfigError(f"{name} must be a whole number from {least} to {most}, not {value!r}")
    return int(value)


def keys_of(
    given: Mapping[str, Any] | None, what: str = "the configuration", like: str = "{'vehicles_count': 5}"
) -> Mapping[str, Any]:
    """The keys of a dict that a user may have given. Raises ConfigError where it is none."""
    if not isinstance(given, Mapping | None):
        raise ConfigError(f"{what} must be a dict such as {like}, not {given!r}")
    return given or {}


def names_of(what: str, given: Any) -> tuple[str, ...]:
    """Names of a list that a user has given. Raises ConfigError for one name alone, and for anything else."""
    names = tuple(given) if isinstance(given, Iterable) and not isinstance(given, str | Mapping) else (None,)
    if not all(isinstance(name, str) for name in names):
        raise ConfigError(f"{what} must be a list of names, not {given!r}")
    return names


def resolve(task: str, defaults: Config, *overrides: Mapping[str, Any] | None) -> Config:
    """`defaults` updated with `overrides`; top-level keys are replaced as a whole, as in highway-env.

    Raises:
        ConfigError: unknown key, wrong type or value out of range.
    """
    known = {**COMMON, **defaults}
    config = copy.deepcopy(known)
    is_theirs = task in HIGHWAY_ENVS
    for override in overrides:
        for key, given in keys_of(override).items():
            value = plain(given)
            if key in known:
                config[key] = value
                continue
            if key in FIXED:
                expected, reason = FIXED[key]
                if value != expected:
                    raise ConfigError(f"config key {key!r} can only be {expected!r}, not {value!r}: {reason}")
            elif is_theirs and (key in IGNORED or (task, key) == ("two-way", "on_road_reward")):
                ignore(f"the task {task!r}", str(key), _meant(str(key), known))
            elif key not in WITHOUT_EFFECT:
                parts = [part for part, types in TYPES.items() if any(key in each for each in types)]
                meant = (
                    f"it belongs in config[{parts[0]!r}]" if parts else _meant(str(key), {**known, **FIXED})
                )
                raise ConfigError(f"unknown config key {key!r} for task {task!r}: {meant}")
            config[key] = value
    frequency, given = "simulation_frequency", (overrides[-1] if overrides else None) or {}
    if is_theirs and frequency not in given and config[frequency] == known[frequency]:
        policy = config["policy_frequency"]
        if is_number(policy) and policy > known[frequency]:  # nobody has asked for the default
            config[frequency] = max(known[frequency], STOCK_FREQUENCY)
    _check(task, config, known)
    return config


def refuse_arguments(unknown: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    """Python's own TypeError about unknown arguments, which says how a key of a configuration (`known`) is set."""
    for key, value in unknown.items():
        hint = f"; it is for {ARGUMENTS[key]}" if key in ARGUMENTS else ""
        if key in {**known, **FIXED}:
            hint = f"; a key of the configuration is set by config={{{key!r}: {value!r}}}"
        raise TypeError(f"__init__() got an unexpected keyword argument {key!r}{hint}")


def pace(simulation_frequency: int, policy_frequency: int) -> float:
    """Policy steps in a second of simulated time [Hz]; one has a whole number of simulation steps."""
    return simulation_frequency / (simulation_frequency // policy_frequency)


@cache
def warn_once(message: str) -> None:
    """Warn, once in a process."""
    gym.logger.warn("%s", message)  # gymnasium formats what it is given, and ids may have a %


def ignore(where: str, key: str, hint: str) -> None:
    """Warn that a key has no effect; a list of all keys is no hint."""
    told = f"config key {key!r} has no effect on {where}, as in highway-env"
    warn_once(told if hint.startswith("known:") else f"{told}; {hint}")


def tell_of_steps(frequency: int, policy: int, is_sumo: bool) -> None:
    """Warn where steps last otherwise than the frequencies of the simulation and of the policy say [Hz].

    SUMO's step is a whole number of milliseconds, which is told if it is more than 1 % off.
    """
    step = 1000.0 / frequency
    error = round(step) / step - 1.0
    if is_sumo and abs(error) > STEP_ERROR:
        warn_once(
            f"SUMO's steps are whole milliseconds: at a 'simulation_frequency' of {frequency} Hz its clock and "
            f"vehicles are {error:+.0%} off; choose one that divides 1000"
        )
    if frequency % policy:
        warn_once(
            f"a policy step lasts {1.0 / pace(frequency, policy):.3g} s, not 1/{policy} s: a whole number of simulation"
            f" steps, {frequency} a second, while 'duration' and env.unwrapped.time count policy steps, as in "
            f"highway-env; choose a 'policy_frequency' that divides {frequency}"
        )


def plain(value: Any) -> Any:
    """A copy of a value, with numpy's scalars and arrays as Python's numbers and lists."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return copy.deepcopy(value)


def _check(task: str, config: Config, defaults: Config) -> None:
    if lacking := {"duration", *TYPES} - config.keys():
        raise ConfigError(f"the defaults of {task!r} lack {', '.join(sorted(lacking))}: add the base class's")
    for key, default in defaults.items():
        row = KEYS.get(key, WEIGHT if key.endswith("_reward") and is_number(default) else Key())
        row.check(key, default, config[key])
    one_of("value of config['drivers']:", config["drivers"], DRIVERS)
    speeds = config["reward_speed_range"] if "reward_speed_range" in defaults else None
    if speeds is not None and speeds[0] == speeds[1]:
        raise ConfigError(f"config key 'reward_speed_range' must be two different speeds, not {speeds!r}")
    if config["simulation_frequency"] < config["policy_frequency"]:
        frequencies = ("simulation_frequency", "policy_frequency")
        both = " must be at least ".join(f"{key!r} ({config[key]})" for key in frequencies)
        raise ConfigError(f"{both}: otherwise no time passes in a step; set both")
    for group, types in TYPES.items():
        _check_type(task, group, config[group], {known["type"]: known for known in types})


def _check_type(task: str, group: str, given: Config, types: Mapping[str, Config]) -> None:
    """That the entry for the observation or the action has a known type, and keys and values of that type.

    highway-env's types take every key. Of a task of highway-env, a key that resembles no known one is ignored too.
    """
    if "type" not in given:
        raise ConfigError(f"config[{group!r}] needs a 'type': {', '.join(types)}")
    if str(given["type"]) in NOT_HERE:
        raise ConfigError(
            f"the {group} type {given['type']!r} of highway-env is not here: {NOT_HERE[given['type']]} "
            f"({page('from-highway-env')}); known: {', '.join(types)}"
        )
    defaults = types[one_of(f"{group} type", given["type"], tuple(types))]
    for key, value in given.items():
        if key not in defaults:
            meant = _meant(str(key), defaults)
            if task in HIGHWAY_ENVS and defaults is not LEADERS_FOLLOWERS and "known:" in meant:
                ignore(f"the {group} type {given['type']!r}", str(key), meant)
                continue
            raise ConfigError(f"unknown key {key!r} in config[{group!r}]: {meant}")
        if key in ("longitudinal", "lateral") and value == "sumo":  # SUMO drives (`actions`)
            continue
        _check_kind(f"{group} {key!r}", defaults[key], value)


def is_number(value: Any) -> bool:
    """Whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _check_kind(name: str, default: Any, value: Any) -> None:
    """That a value is of the kind of its default; where that is None, or a word, it is checked where it is used."""
    wanted = None
    if isinstance(default, bool):
        wanted = None if isinstance(value, bool | int) else "True or False"
    elif isinstance(default, int | float):
        wanted = None if is_number(value) else "a number"
    elif isinstance(default, dict):
        wanted = None if isinstance(value, dict) else 'a dict such as {"type": ...}'
    elif isinstance(default, list) and not (
        isinstance(value, list) and len(value) == len(default) and all(map(is_number, value))
    ):
        wanted = f"a list of {len(default)} numbers"
    if wanted:
        raise ConfigError(f"{name} must be {wanted}, not {value!r}")
