"""The names of highway-env that `sumo_env` must tell apart, from its source: ``python docs/highway_env_names.py``.

Writes `sumo_env/highway_env.json`:

- ignored: for each task, the keys that highway-env's environment of this name does not read, though another environment
  of highway-env, a version before 1.1, or another task of this package has them. Whoever sets them gets a warning.
- methods: what classes derived from the five environments can override there.
- names: what can be read there of an environment, a vehicle, a road, its network, a lane, and the two types.
- types: all types of observation and action.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import highway_env

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sumo_env.tasks import TASKS

FILE = Path(__file__).resolve().parents[1] / "sumo_env" / "highway_env.json"
SOURCE = Path(highway_env.__file__).parent
ENVIRONMENTS = {
    "highway": "HighwayEnv",
    "two-way": "TwoWayEnv",
    "roundabout": "RoundaboutEnv",
    "intersection": "IntersectionEnv",
    "u-turn": "UTurnEnv",
}
# Parts that all environments share, and that read keys.
SHARED = (
    "envs/common/abstract.py",
    "envs/common/graphics.py",
    "envs/common/observation.py",
    "envs/common/action.py",
)
# Of versions before 1.1; many public scripts still set it. Versions 1.1 to 1.9.1 have no key that 1.12.1 lacks.
BEFORE = ("initial_spacing",)
# The classes that are read, by what they are called here.
READ = {
    "vehicle": ("vehicle.objects:RoadObject", "vehicle.kinematics:Vehicle", "vehicle.behavior:IDMVehicle",
                "vehicle.controller:ControlledVehicle", "vehicle.controller:MDPVehicle"),
    "road": ("road.road:Road", "road.regulation:RegulatedRoad"),
    "network": ("road.road:RoadNetwork",),
    "lane": ("road.lane:AbstractLane", "road.lane:StraightLane", "road.lane:SineLane", "road.lane:CircularLane"),
    "observation_type": ("envs.common.observation:KinematicObservation", "envs.common.observation:ObservationType",
                         "envs.common.observation:TimeToCollisionObservation",
                         "envs.common.observation:OccupancyGridObservation"),
    "action_type": ("envs.common.action:ActionType", "envs.common.action:DiscreteMetaAction",
                    "envs.common.action:ContinuousAction", "envs.common.action:DiscreteAction"),
}  # fmt: skip


def keys_read(tree: ast.AST) -> Iterator[str]:
    """Keys of the configuration that code reads: ``config["key"]``, ``config.get("key")``, terms of the reward."""
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Subscript)
            and _is_config(node.value)
            and isinstance(node.slice, ast.Constant)
        ):
            yield str(node.slice.value)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get":
            if _is_config(node.func.value) and node.args and isinstance(node.args[0], ast.Constant):
                yield str(node.args[0].value)
        elif isinstance(node, ast.FunctionDef) and node.name in ("_rewards", "_agent_rewards"):
            yield from _keys(node)


def keys_of_defaults(tree: ast.AST) -> Iterator[str]:
    """Keys that a module's ``default_config`` functions name, without those of dictionaries within them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name == "default_config":
            inner = {
                id(value) for each in ast.walk(node) if isinstance(each, ast.Dict) for value in each.values
            }
            for each in ast.walk(node):
                if isinstance(each, ast.Dict) and id(each) not in inner:
                    yield from (str(key.value) for key in each.keys if isinstance(key, ast.Constant))


def _keys(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Dict):
            yield from (str(key.value) for key in node.keys if isinstance(key, ast.Constant))


def _is_config(node: ast.AST) -> bool:
    return (isinstance(node, ast.Name) and node.id == "config") or (
        isinstance(node, ast.Attribute) and node.attr == "config"
    )


def tree_of(path: Path) -> ast.Module:
    """The parsed file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def environment(task: str) -> Any:
    """highway-env's class for a task."""
    return getattr(import_module("highway_env.envs"), ENVIRONMENTS[task])


def read_by(task: str) -> set[str]:
    """Keys that highway-env's environment of a task reads, or has a default for."""
    read = {key for name in SHARED for key in keys_read(tree_of(SOURCE / name))}
    for part in inspect.getmro(environment(task)):
        if part.__module__.startswith("highway_env.envs"):
            tree = ast.parse(inspect.getsource(part))
            read |= set(keys_read(tree)) | set(keys_of_defaults(tree))
    return read | set(environment(task).default_config())


def named_anywhere() -> set[str]:
    """All keys that any environment of highway-env reads at the top of its configuration, or has a default for."""
    trees = [tree_of(path) for path in sorted(SOURCE.glob("envs/*.py"))]
    return {key for tree in trees for key in (*keys_read(tree), *keys_of_defaults(tree))}


def attributes(of: type) -> set[str]:
    """Public names of a class, and of what its methods assign to ``self``."""
    found: set[str] = set()
    for part in inspect.getmro(of):
        if part.__module__.startswith("highway_env"):
            found |= set(vars(part))
            found |= set(re.findall(r"\bself\.(\w+)(?:: [\w\[\]. |]+)? = ", inspect.getsource(part)))
    return {name for name in found if not name.startswith("_")}


def types(module: str) -> set[str]:
    """Names of types that a module's factory compares with."""
    tree = tree_of(SOURCE / f"envs/common/{module}.py")
    factory = next(
        node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == f"{module}_factory"
    )
    compared = [
        each for node in ast.walk(factory) if isinstance(node, ast.Compare) for each in node.comparators
    ]
    return {str(each.value) for each in compared if isinstance(each, ast.Constant)}


def names() -> dict[str, Any]:
    """All of the file."""
    ours = {key for task in TASKS.values() for key in task.defaults}
    everything = named_anywhere() | set(BEFORE) | ours
    five = [environment(task) for task in ENVIRONMENTS]
    chain = {
        part for each in five for part in inspect.getmro(each) if part.__module__.startswith("highway_env")
    }
    methods = {name for part in chain for name in vars(part) if not name.startswith("__")}
    read = {name: set.union(*(attributes(_class(path)) for path in paths)) for name, paths in READ.items()}
    read["env"] = set.union(*map(attributes, five))
    found: dict[str, Any] = {
        "version": highway_env.__version__,
        "ignored": {task: everything - read_by(task) - TASKS[task].defaults.keys() for task in ENVIRONMENTS},
        "methods": methods,
        "names": read,
        "types": {
            "observation": types("observation"),
            "action": types("action"),
        },
    }
    return {key: _sorted(value) for key, value in found.items()}


def _class(path: str) -> type:
    module, _, name = path.partition(":")
    return getattr(import_module(f"highway_env.{module}"), name)


def _sorted(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _sorted(inner) for key, inner in value.items()}
    return sorted(value) if isinstance(value, set) else value


def text() -> str:
    """The content of the file: each list in a line."""
    return re.sub(r"\[[^\]]*\]", lambda hit: " ".join(hit[0].split()), json.dumps(names(), indent=1)) + "\n"


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
    print(f"written: {FILE.name}")
