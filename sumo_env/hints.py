"""What highway-env has and this package has not: why, and what to use instead. Messages about it name a page.

`highway_env.json` has the names of highway-env; ``python docs/highway_env_names.py`` makes it of highway-env's source.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

# Where the documentation is as a site (make addresses fills it in); while this is empty, messages name files of the
# repository.
DOCUMENTATION = ""

# Methods of highway-env's environments that are called here, so that subclasses may override them.
CALLED = {
    *("_reward", "_rewards", "_is_terminated", "_is_truncated", "_info", "default_config", "define_spaces"),
    *("configure", "reset", "step", "render", "close", "metadata", "get_available_actions", "vehicle"),
    "set_record_video_wrapper",
}
# Why a name of highway-env is not here, and what to use; by the names, and else by what has them.
_COPY = "the simulator drives the vehicles; copy.deepcopy(env), then step, drives ahead"
_TRAFFIC = "config key 'risk', or drivers of your own, change the other vehicles"
_ROAD = "a road belongs to a task of your own"
_PICTURES = "render_mode='rgb_array' makes pictures, 'human' opens a window"
REASONS: dict[str, str] = {
    **dict.fromkeys(("act", "step", "simplify", "predict_trajectory", "action", "history", "log"), _COPY),
    **dict.fromkeys(("predict_trajectory_constant_speed", "record_history"), _COPY),
    **dict.fromkeys(
        ("change_vehicles", "randomize_behavior", "set_vehicle_field", "set_preferred_lane"), _TRAFFIC
    ),
    **dict.fromkeys(("call_vehicle_method", "set_route_at_intersection"), _TRAFFIC),
    **dict.fromkeys(("add_lane", "from_config", "straight_road_network", "to_config"), _ROAD),
    **dict.fromkeys(("viewer", "enable_auto_render", "update_metadata"), _PICTURES),
    **dict.fromkeys(
        ("route", "destination", "plan_route_to"), "env.unwrapped.scenario has where vehicles drive to"
    ),
    "to_finite_mdp": "the observation 'TimeToCollision' has these predictions",
    "done": "step() returns whether the episode is over",
    "has_arrived": "info['arrived'] says it of the ego",
    "np_random": "env.unwrapped.np_random is the generator",
    "env": "read env.unwrapped",
    "vehicle_class": _COPY,
}
# What to write in place of a method that nothing calls here.
INSTEAD = {
    "_reset": ": override reset(), and begin it with super().reset()",
    **dict.fromkeys(("_make_road", "_create_road", "_make_vehicles", "_create_vehicles"), ": write a task"),
}
OTHERWISE = {
    "env": "scripts can read what the page lists",
    "vehicle": "the simulator drives the vehicles, and the page lists what can be read of them",
    "road": "the simulator drives the vehicles, and the page lists what can be read of them",
    "network": _ROAD,
    "lane": "of a lane here, the geometry, width, speed limit and priority can be read",
    "observation_type": "env.unwrapped.config['observation'] has its settings",
    "action_type": "env.unwrapped.config['action'] has its settings",
}
# Types of observation and action of highway-env that are not here.
TYPES = {
    "GrayscaleObservation": "gymnasium.wrappers.AddRenderObservation(env) observes the pictures of "
    "gym.make(..., render_mode='rgb_array')",
    "LidarObservation": "a gymnasium.ObservationWrapper can read the places of all vehicles from env.unwrapped.scene",
    **dict.fromkeys(
        ("MultiAgentObservation", "MultiAgentAction"),
        "gym.make and sumo_env.parallel_env make several learning cars",
    ),
    **dict.fromkeys(
        ("KinematicsGoal", "AttributesObservation", "ExitObservation"),
        "it belongs to a road that is not here",
    ),
    "TupleObservation": "a gymnasium.ObservationWrapper can join observations",
}


def page(name: str, section: str = "") -> str:
    """Where a page of the documentation is, such as "docs/limits.md", or "limits.html" of the site."""
    section = section and f"#{section}"
    return f"{DOCUMENTATION}/{name}.html{section}" if DOCUMENTATION else f"docs/{name}.md{section}"


@cache
def highway_env() -> dict[str, Any]:
    """The names of highway-env, see ``docs/highway_env_names.py``."""
    return dict(json.loads((Path(__file__).parent / "highway_env.json").read_text(encoding="utf-8")))


def never_called() -> set[str]:
    """What subclasses of highway-env's environments can override there, and nothing calls here."""
    return set(highway_env()["methods"]) - CALLED


def missing(owner: str, kind: str, name: str, known: Iterable[str] = ()) -> AttributeError:
    """The error about an attribute that is not here.

    Args:
        owner: what lacks it, as its user knows it.
        kind: a key of `OTHERWISE`.
        name: the attribute.
        known: what there is instead.
    """
    told = f"{owner} has no attribute {name!r}"
    if name.startswith("_"):
        return AttributeError(told, name=name)
    if name in highway_env()["names"][kind]:
        told += f", which highway-env has: {REASONS.get(name, OTHERWISE[kind])}"
    elif near := difflib.get_close_matches(name, list(known), n=1, cutoff=0.75):
        told += f": did you mean {near[0]!r}?"
    else:
        told += ", and highway-env has none either"
    # with its name alone, so that Python adds no guess of its own
    return AttributeError(f"{told} ({page('from-highway-env')})", name=name)
