"""What highway-env has and this package has not: why, and what to use instead. Messages about it name a page."""

import difflib
from collections.abc import Iterable
from importlib.util import find_spec
from typing import Any, NoReturn

import gymnasium as gym

# Where the documentation is as a site (make addresses fills it in); while this is empty, messages name files of the
# repository.
DOCUMENTATION = ""

# Why a name of highway-env is not here, and what to use.
_COPY = "the simulator drives the vehicles; copy.deepcopy(env), then step, drives ahead"
_TRAFFIC = "config key 'risk', or drivers of your own, change the other vehicles"
_ROAD = "a road belongs to a task of your own"
_TASK = "write a task of your own"
_PICTURES = "render_mode='rgb_array' makes pictures, 'human' opens a window"
_PLACES = "vehicles cannot be placed but by a task of your own; the generator is env.unwrapped.np_random"

# of environments that a compiled batch drives
ALONE = 'gym.make_vec(..., vectorization_mode="sync") has environments that can'


def _all(names: str, reason: str) -> dict[str, str]:
    return dict.fromkeys(names.split(), reason)


# Of these nothing is called or read here, so that a class derived from an environment overrides them in vain.
NEVER_CALLED: dict[str, str] = {
    **_all("_make_road _create_road _make_vehicles _create_vehicles _spawn_vehicle _clear_vehicles", _TASK),
    **_all(
        "_agent_reward _agent_rewards _agent_is_terminal _is_terminal _cost",
        "override _reward, _rewards or _is_terminated",
    ),
    **_all("change_vehicles randomize_behavior set_vehicle_field set_preferred_lane", _TRAFFIC),
    **_all("call_vehicle_method set_route_at_intersection", _TRAFFIC),
    **_all("_simulate simplify", _COPY),
    **_all("_automatic_rendering update_metadata", _PICTURES),
    **_all(
        "ACTIONS ACTIONS_INDEXES",
        "env.unwrapped.action_type has the actions, config['action'] decides on them",
    ),
    "_reset": "override reset(), and begin it with super().reset()",
    "PERCEPTION_DISTANCE": "vehicles are seen within 200 m, which cannot be changed",
    "has_arrived": "info['arrived'] says it of the ego; a task of your own decides on it",
    "to_finite_mdp": "the observation 'TimeToCollision' has these predictions",
}
REASONS: dict[str, str] = {
    **NEVER_CALLED,
    "action": "info has the ego's acceleration, jerk and action",
    **_all("polygon", "position, heading, LENGTH and WIDTH say where a vehicle is"),
    **_all("speed_to_index index_to_speed", "env.unwrapped.action_type.target_speeds has the speeds"),
    **_all("target_lane_index timer", "of the ego alone, as the simulator decides on the others' lanes"),
    **_all("next_lane shortest_path", "env.unwrapped.scenario has the routes"),
    **_all("act step history log vehicle_class record_history", _COPY),
    **_all("predict_trajectory predict_trajectory_constant_speed", _COPY),
    **_all("add_lane from_config straight_road_network to_config", _ROAD),
    **_all("viewer enable_auto_render", _PICTURES),
    **_all("route destination plan_route_to", "env.unwrapped.scenario has where vehicles drive to"),
    **_all("create_random make_on_lane create_from np_random", _PLACES),
    **_all("envs call get_attr set_attr render", ALONE),
    "seed": "reset(seed=...) takes it",
    "done": "step() returns whether the episode is over",
    "env": "read env.unwrapped",
}
# Types of observation and action of highway-env that are not here.
TYPES = {
    **dict.fromkeys(
        ("MultiAgentObservation", "MultiAgentAction"),
        "gym.make and sumo_env.parallel_env make several learning cars",
    ),
    "KinematicsGoal": "it belongs to a road that is not here",
    "AttributesObservation": "a gymnasium.ObservationWrapper can read the attributes of env.unwrapped",
    "TupleObservation": "a gymnasium.ObservationWrapper can join observations",
}
# Ids of highway-env that are not here: other roads, and of the tasks on SUMO the later versions.
_ROADS = """lane-keeping-v0 merge-generic-v0 merge-generic-v1 parking-v0
    parking-ActionRepeat-v0 parking-parked-v0 racetrack-v0 racetrack-v1 racetrack-large-v0 racetrack-large-v1
    racetrack-oval-v0 racetrack-oval-v1 roundabout-generic-v0 roundabout-generic-v1"""
# Without highway-env its own ids say how they are called here; with it they are its own.
_ITS_OWN = "highway highway-fast two-way roundabout intersection u-turn merge exit"
NOT_HERE = {
    **({} if find_spec("highway_env") else {f"{of}-v0": f"use sumo/{of}-v0" for of in _ITS_OWN.split()}),
    **{
        f"{of}/{id}": "write a network or a task of your own"
        for of in ("sumo", "replica")
        for id in _ROADS.split()
    },
    **_all(
        "sumo/roundabout-v1 sumo/intersection-v1 sumo/intersection-v2 sumo/u-turn-v1 sumo/merge-v1 sumo/exit-v1 "
        "sumo/intersection-multi-agent-v2",
        "replica/* has it",
    ),
}


def not_here(id: str, **keywords: Any) -> NoReturn:
    """What ``gym.make`` makes of an id of highway-env that is not here: gymnasium's error, with what to use."""
    error = gym.error.NameNotFound if id.partition("/")[2] in _ROADS.split() else gym.error.VersionNotFound
    where = page("from-highway-env", "what-is-not-here")
    raise error(f"there is no {id}, which highway-env has: {NOT_HERE[id]} ({where})")


def page(name: str, section: str = "") -> str:
    """Where a page of the documentation is, such as "docs/limits.md", or "limits.html" of the site."""
    section = section and f"#{section}"
    return f"{DOCUMENTATION}/{name}.html{section}" if DOCUMENTATION else f"docs/{name}.md{section}"


def did_you_mean(word: str, choices: Iterable[str], cutoff: float = 0.5) -> str:
    """A question for an error message: the nearest known word; "" if none is near."""
    match = difflib.get_close_matches(word, sorted(choices), n=1, cutoff=cutoff)
    return f"did you mean {match[0]!r}?" if match else ""


def missing(owner: str, name: str, known: Iterable[str]) -> AttributeError:
    """The error about an attribute that its owner, as a user knows it, lacks; known: what there is instead."""
    instead = REASONS.get(name) or did_you_mean(name, known, 0.75)
    told = f"{owner} has no attribute {name!r}" + (f": {instead}" if instead else "")
    # with its name alone, so that Python adds no guess of its own
    return AttributeError(f"{told} ({page('from-highway-env')})", name=name)
