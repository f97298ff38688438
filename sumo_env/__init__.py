"""Driving tasks of highway-env on the traffic simulator SUMO, as gymnasium environments.

``import sumo_env`` registers ``sumo/highway-v0``, ``sumo/two-way-v0``, ``sumo/roundabout-v0``,
``sumo/intersection-v0`` and ``sumo/u-turn-v0``, and ``sumo/highway-fast-v0``, the highway with highway-env's defaults
for that id; ``gym.make("sumo_env:sumo/highway-v0")`` needs no import. The same tasks on highway-env's own physics,
compiled, are ``replica/highway-v0`` and so on, with ``replica/highway-fast-v0`` and the later versions that highway-env
has, such as ``replica/u-turn-v1`` (extra ``[replica]``).
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym

if TYPE_CHECKING:
    from sumo_env.benchmark import benchmark_scenarios as benchmark_scenarios
    from sumo_env.check import check_task as check_task
    from sumo_env.env import DrivingEnv as DrivingEnv
    from sumo_env.scenarios import SumoDrivingEnv as SumoDrivingEnv
    from sumo_env.tasks.base import Task as Task

_HERE = Path(__file__).parent
# a clone without symbolic links: the folder networks is beside this package
if not (_HERE / "networks").is_dir():
    __path__.append(str(_HERE.parent))

from sumo_env.tasks import TASKS as _TASKS  # noqa: E402  (below the path of sumo_env.networks)
from sumo_env.tasks import get_task as _get_task  # noqa: E402
from sumo_env.unsupported import NOT_HERE  # noqa: E402
from sumo_env.unsupported import did_you_mean as _did_you_mean  # noqa: E402

__version__ = "0.1.0"

# What runs; ids of highway-env that do not are `sumo_env.unsupported.NOT_HERE`.
IDS = tuple(f"sumo/{name}-v0" for name in _TASKS)
REPLICA_IDS = tuple(f"replica/{name}-v0" for name, task in _TASKS.items() if task.versions)

FAST_ID = "replica/highway-fast-v0"  # highway-env's faster variant of its highway
SUMO_FAST_ID = "sumo/highway-fast-v0"  # the highway with the defaults of that
# highway-env's later versions: with connected lanes, and intersection-v1 with steering
LATER_IDS = tuple(
    f"replica/{name}-v{version}" for name, task in _TASKS.items() for version in task.versions[1:]
)
# highway-env's intersection with two learning cars; on SUMO lanes are always connected, as in its last version
TUPLE_IDS = tuple(f"replica/intersection-multi-agent-v{version}" for version in range(3))
SUMO_TUPLE_IDS = tuple(f"sumo/intersection-multi-agent-v{version}" for version in range(2))


def register_highway_envs() -> None:
    """As in earlier versions of highway_env. The import has registered the ids."""


def task_of(id: str) -> str:
    """Name of the task that an id stands for: ``sumo/u-turn-v0`` is u-turn."""
    return id.partition("/")[2].rpartition("-v")[0]


def version_of(id: str) -> int:
    """The number at the end of an id."""
    return int(id.rpartition("-v")[2])


def register(id: str, task: Any) -> None:
    """Register an environment with gymnasium: ``gym.make(id)`` and ``gym.make_vec(id)`` make it.

    Args:
        id: such as ``"me/ramp-v0"``.
        task: a `sumo_env.tasks.base.Task` of your own (docs/own-parts.md), or the name of one that is here.
    """
    if isinstance(task, type):
        raise TypeError(
            f"register({id!r}, {task.__name__}) needs a task, not a class: {task.__name__}() of a Task; classes of "
            "environments are for gym.register"
        )
    _get_task(task)
    if id in NOT_HERE:
        gym.registry.pop(id, None)
    gym.register(
        id,
        entry_point="sumo_env.env.cars:make",
        vector_entry_point="sumo_env.vector:SumoVectorEnv",
        kwargs={"task": task},
    )


def parallel_env(env: Any, config: Any = None, **keywords: Any) -> Any:
    """Several learning cars as PettingZoo's ``ParallelEnv``, see `sumo_env.parallel.parallel_env`."""
    from sumo_env.parallel import parallel_env  # PettingZoo, of the extra [multi-agent]

    return parallel_env(env, config, **keywords)


# What is imported when it is asked for, so that ``import sumo_env`` takes no time.
_LATER = {
    "DrivingEnv": "sumo_env.env",
    "SumoDrivingEnv": "sumo_env.scenarios",
    "Task": "sumo_env.tasks.base",
    "check_task": "sumo_env.check",
    "benchmark_scenarios": "sumo_env.benchmark",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(import_module(_LATER[name]), name)
    if name == "envs":  # as highway_env.envs
        return import_module("sumo_env.envs")
    hint = _did_you_mean(name, (name for name in __dir__() if name[0] != "_"), 0.75)
    if name in import_module("sumo_env.envs").__all__:
        hint = "classes to derive from are in sumo_env.envs"
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}" + (hint and f"; {hint}"), name=name)


def __dir__() -> list[str]:
    return [*globals(), *_LATER]


for _id in (*IDS, SUMO_FAST_ID):
    register(_id, task_of(_id))
for _id in (*REPLICA_IDS, FAST_ID, *LATER_IDS):
    gym.register(
        _id,
        entry_point="sumo_env.env.cars:make_replica",
        vector_entry_point="sumo_env.replica.vector:make",
        kwargs={"task": task_of(_id), "version": version_of(_id)},
    )
for _id in (*TUPLE_IDS, *SUMO_TUPLE_IDS):
    _version, _make = version_of(_id), "make"
    _several: dict[str, Any] = {"task": "intersection", "cars": 2, "per_car": _version > 0}
    if _id in TUPLE_IDS:
        _make, _several["version"] = "make_replica", _version - _version % 2
    gym.register(_id, entry_point=f"sumo_env.env.cars:{_make}", kwargs=_several)
for _id in NOT_HERE:
    _not_here = "sumo_env.unsupported:not_here"
    gym.register(_id, entry_point=_not_here, vector_entry_point=_not_here, kwargs={"id": _id})
    gym.registry[_id].name += ", not here"  # so that gymnasium calls no version before it out of date
