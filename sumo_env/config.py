"""Configuration: highway-env's keys, checked. Each default is defined once, in `COMMON` or in its task's file."""

from __future__ import annotations

import copy
import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from gymnasium import logger

Config = dict[str, Any]

COMMON: Config = {
    "simulation_frequency": 10,  # [Hz] SUMO's step is its inverse (highway-env: 15)
    "policy_frequency": 1,  # [Hz]
    "traffic_model": "sumo",  # accepted for older code; SUMO's own drivers are the only ones
    "risk": 0.0,  # dose of risky traffic, 0 (regular) to 1
    "screen_width": 600,  # [px]
    "screen_height": 150,  # [px]
    "scaling": 5.5,  # [px/m]
    "centering_position": [0.3, 0.5],
    "show_trajectories": False,
}

DISCRETE_META_ACTION: Config = {"type": "DiscreteMetaAction", "longitudinal": True, "lateral": True}
ACTION_KEYS = {"type", "longitudinal", "lateral", "target_speeds"}
OBSERVATION_KEYS: dict[str, set[str]] = {
    "Kinematics": {
        "type",
        "features",
        "vehicles_count",
        "features_range",
        "absolute",
        "order",
        "normalize",
        "clip",
        "see_behind",
        "observe_intentions",
        "include_obstacles",
        "flatten",
    },
    "TimeToCollision": {"type", "horizon"},
}
NOT_PORTED = (
    "AttributesObservation",
    "ExitObservation",
    "GrayscaleObservation",
    "KinematicsGoal",
    "LidarObservation",
    "MultiAgentObservation",
    "OccupancyGrid",
    "TupleObservation",
)
# What takes all memory or all time beyond; frequencies: SUMO's clock counts milliseconds.
LARGEST = {
    "policy_frequency": 1000,
    "simulation_frequency": 1000,
    "lanes_count": 50,
    "road_length": 100_000.0,
    "duration": 100_000.0,
    "screen_width": 10_000,
    "screen_height": 10_000,
}
MOST_VEHICLES = 10_000
POSITIVE = (
    "lanes_count",
    "road_length",
    "duration",
    "policy_frequency",
    "simulation_frequency",
    "vehicles_density",
    "screen_width",
    "screen_height",
    "scaling",
)
# Keys of highway-env and rl-agents that the tasks on SUMO do not have. A whole configuration of theirs is accepted if
# it describes the same task and kept: keys that only concern the display or the file have no effect (with a warning,
# unless they have one of these values), the others may only have these values.
LEFT_OUT: dict[str, tuple[Any, ...]] = {
    "offscreen_rendering": (None, False, True),
    "real_time_rendering": (False,),
    "render_agent": (True,),
    "show_history": (False,),
    "neighbour_vehicles_connected_lanes": (False, True),  # SUMO's drivers always see across lane joins
}
FILE_KEYS = ("id", "import_module")  # rl-agents hands its whole JSON file to `configure`
FIXED: dict[str, tuple[Any, str]] = {
    "controlled_vehicles": (1, "there is one ego"),
    "manual_control": (False, "the agent drives the ego"),
    "obey_traffic_lights": (False, "this road has no traffic lights"),
    "other_vehicles_type": (
        "highway_env.vehicle.behavior.IDMVehicle",
        "SUMO drives the other vehicles of sumo/* (docs/own-parts.md brings drivers of your own), and replica/* has "
        "IDMVehicle compiled; 'risk' makes both risky",
    ),
}


class ConfigError(ValueError):
    """The configuration is invalid; the message names the key, the reason, and what is accepted."""


def did_you_mean(word: str, choices: Iterable[str]) -> str:
    """A question for an error message: the nearest known word; "" if none is near."""
    match = difflib.get_close_matches(word, sorted(choices), n=1, cutoff=0.5)
    return f"did you mean {match[0]!r}?" if match else ""


def nearest(word: str, choices: Mapping[str, Any] | set[str] | list[str]) -> str:
    """End of an error message: the nearest known word, or all known words."""
    known = sorted(map(str, choices))
    return did_you_mean(str(word), known) or f"known: {', '.join(known)}"


def refuse_keywords(keywords: Mapping[str, Any]) -> None:
    """An error if an environment was made with further arguments, as in ``gym.make(id, vehicles_count=5)``."""
    if keywords:
        names = ", ".join(map(repr, keywords))
        raise TypeError(
            f"unexpected keyword argument {names}: give keys of the configuration as config={dict(keywords)!r}, to "
            "gym.make or in reset(options={'config': ...})"
        )


def one_of(name: str, value: Any, choices: tuple[str, ...]) -> str:
    """The value of an argument of this name that can only be one of some words.

    Raises:
        ConfigError: it is none of them.
    """
    if value not in choices:
        raise ConfigError(f"unknown {name!r} {value!r}: {nearest(str(value), list(choices))}")
    return str(value)


def resolve(task: str, defaults: Config, *overrides: Mapping[str, Any] | None) -> Config:
    """`defaults` updated with `overrides`; top-level keys are replaced as a whole, as in highway-env.

    Raises:
        ConfigError: unknown key, wrong type or value out of range.
    """
    known = {**COMMON, **defaults}
    config = copy.deepcopy(known)
    ignored = []
    for override in overrides:
        if not isinstance(override, Mapping | None):
            raise ConfigError(
                f"the configuration must be a dict such as {{'vehicles_count': 5}}, not {override!r}"
            )
        for key, given in (override or {}).items():
            value = _plain(given)
            if key in known:
                config[key] = value
                continue
            if key in FIXED:
                expected, reason = FIXED[key]
                if value != expected:
                    raise ConfigError(f"config key {key!r} can only be {expected!r}, not {value!r}: {reason}")
            elif key in LEFT_OUT:
                if value not in LEFT_OUT[key]:
                    ignored.append(key)
            elif key not in FILE_KEYS:
                raise ConfigError(f"unknown config key {key!r} for task {task!r}: {nearest(key, known)}")
            config[key] = value
    if ignored:
        logger.warn(f"config keys without effect on SUMO's pictures are ignored: {', '.join(ignored)}")
    _check(task, config, known)
    return config


def simulated_frequency(config: Config) -> int:
    """Steps that are simulated per second [Hz]: ``simulation_frequency``, or its first multiple of at least 5.

    With longer steps, cars would pass through each other.
    """
    return int(config["simulation_frequency"]) * math.ceil(5 / config["simulation_frequency"])


def _plain(value: Any) -> Any:
    """A copy of a value, with numpy's scalars and arrays as Python's numbers and lists."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return copy.deepcopy(value)


def _check(task: str, config: Config, defaults: Config) -> None:
    for key in defaults:
        value = config[key]
        wanted = _wanted(defaults[key], value)
        if wanted:
            raise ConfigError(f"config key {key!r} must be {wanted}, not {value!r}")
        if key.endswith("_count") and (value != int(value) or not 0 <= value <= MOST_VEHICLES):
            raise ConfigError(
                f"config key {key!r} must be a whole number from 0 to {MOST_VEHICLES}, not {value!r}"
            )
    if config["traffic_model"] == "matched":
        raise ConfigError(
            "traffic_model 'matched' is gone: SUMO's own drivers drive now. highway-env's physics is the backend "
            "'replica' of the experiments, which is equal to highway-env and faster"
        )
    if config["traffic_model"] != "sumo":
        raise ConfigError(f"config key 'traffic_model' can only be 'sumo', not {config['traffic_model']!r}")
    for key in ("risk", "spawn_probability"):
        if not 0.0 <= config.get(key, 0.0) <= 1.0:
            raise ConfigError(f"config key {key!r} must lie in [0, 1], not {config[key]!r}")
    for key in POSITIVE:
        if key in config and config[key] <= 0:
            raise ConfigError(f"config key {key!r} must be positive, not {config[key]!r}")
    for key, most in LARGEST.items():
        if key in config and config[key] > most:
            raise ConfigError(f"config key {key!r} must be at most {most:g}, not {config[key]!r}")
    for key in ("policy_frequency", "simulation_frequency"):
        if config[key] != int(config[key]):
            raise ConfigError(f"config key {key!r} must be a whole number, not {config[key]!r}")
    limits = config.get("reward_speed_range")
    if limits is not None and limits[0] == limits[1]:
        raise ConfigError(f"config key 'reward_speed_range' must be two different speeds, not {limits!r}")
    if config["simulation_frequency"] % config["policy_frequency"]:
        raise ConfigError(
            f"'simulation_frequency' ({config['simulation_frequency']}) must be a multiple of 'policy_frequency' "
            f"({config['policy_frequency']})"
        )
    _check_types(config)


def _check_types(config: Config) -> None:
    """The types of observation and action, then their options."""
    kind = config["observation"].get("type")
    if kind not in OBSERVATION_KEYS:
        wrong = (
            "config['observation'] needs a 'type'" if kind is None else f"unknown observation type {kind!r}"
        )
        hint = nearest(str(kind), set(OBSERVATION_KEYS))
        if kind is None or kind in NOT_PORTED:
            ported = "highway-env has it, here it is not ported; " if kind else ""
            hint = f"{ported}known: {', '.join(OBSERVATION_KEYS)}"
        raise ConfigError(f"{wrong}: {hint} (for pictures use gymnasium.wrappers.AddRenderObservation)")
    if config["action"].get("type") != "DiscreteMetaAction":
        raise ConfigError(
            f"unknown action type {config['action'].get('type')!r}: the ego is driven by 'DiscreteMetaAction'"
        )
    for group, known in (("observation", OBSERVATION_KEYS[kind]), ("action", ACTION_KEYS)):
        for key in config[group]:
            if key not in known:
                raise ConfigError(f"unknown key {key!r} in config[{group!r}]: {nearest(key, known)}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _wanted(default: Any, value: Any) -> str | None:
    """The kind of value that the default asks for; None if `value` is of that kind."""
    if isinstance(default, bool):
        return None if isinstance(value, bool | int) else "True or False"
    if isinstance(default, int | float):
        return None if _is_number(value) else "a number"
    if isinstance(default, dict):
        return None if isinstance(value, dict) else 'a dict such as {"type": ...}'
    if isinstance(default, list):
        numbers = (
            isinstance(value, list | tuple) and len(value) == len(default) and all(map(_is_number, value))
        )
        return None if numbers else f"a list of {len(default)} numbers"
    return None
