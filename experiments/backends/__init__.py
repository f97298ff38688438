"""The simulators behind one function: SUMO, highway-env (the reference), and the replica of its physics.

Each is imported only when it is asked for: a SUMO sweep needs neither highway-env nor numba, and the others no
libsumo.
"""

import importlib
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym

from experiments.support.errors import UserError, check_known
from sumo_env.tasks import TASKS

# The package that computes the traffic of each backend.
SIMULATORS = {"sumo": "libsumo", "highway-env": "highway-env", "replica": "numba"}
BACKENDS = tuple(SIMULATORS)
IDS = {
    "sumo": "sumo_env:sumo/{}-v0",
    "replica": "sumo_env:replica/{}-v0",
    "highway-env": "experiments.backends.highway_env:highway-env/{}",
}
MakeEnv = Callable[..., gym.Env[Any, Any]]  # from (backend, task, config), as `make_env` below
REPLICA = {"scenarios": "seeded", "variant": "path", "risk_law": "standard"}


def has(backend: str, task: str) -> bool:
    """Whether a backend has a task. UserError for an unknown backend, ImportError for one that is not installed."""
    check_known("backend", [backend], BACKENDS)
    module, _, id = IDS[backend].format(task).partition(":")
    importlib.import_module(module)
    return id in gym.registry


def require(backend: str, task: str) -> None:
    """Raise UserError for a task that does not exist, or that a backend does not have."""
    check_known("task", [task], TASKS)
    if not has(backend, task):
        known = ", ".join(name for name in TASKS if has(backend, name))
        raise UserError(f"the backend {backend} has no task {task}: it has {known}")


def make_env(
    backend: str, task: str, config: Mapping[str, Any] | None = None, render_mode: str | None = None
) -> gym.Env[Any, Any]:
    """A driving task on one of the simulators.

    Args:
        backend: "sumo", "highway-env" or "replica".
        task: of `sumo_env.tasks.TASKS`.
        config: highway-env's configuration keys and `risk`, laid over the task's defaults.
        render_mode: None or "rgb_array".

    Raises:
        UserError: unknown backend or task, or the backend lacks the task. ImportError: it is not installed.
    """
    require(backend, task)
    settings, fixed, id = dict(config or {}), dict[str, Any](), IDS[backend].format(task)
    if backend == "replica":  # what is fixed for an environment's life is in the study's configuration
        fixed = {name: settings.pop(name, default) for name, default in REPLICA.items()}
        # by its specification: an id would warn that highway-env has a later version, and the variant says which
        return gym.make(gym.spec(id.partition(":")[2]), config=settings, render_mode=render_mode, **fixed)
    return gym.make(id, config=settings, render_mode=render_mode)
