"""The simulators behind one function: SUMO, highway-env (the reference), and the replica of its physics.

Each is imported only when it is asked for: a SUMO sweep needs neither highway-env nor numba, and the others no
libsumo.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym

from experiments.support.errors import UserError, unknown
from sumo_env.tasks import TASKS

# The package that computes the traffic of each backend.
SIMULATORS = {"sumo": "libsumo", "highway-env": "highway-env", "replica": "numba"}
BACKENDS = tuple(SIMULATORS)
IDS = {
    "sumo": "sumo_env:sumo/{}-v0",
    "replica": "sumo_env:replica/{}-v0",
    "highway-env": "experiments.backends.highway_env:highway-env/{}",
}
REPLICA = {"scenarios": "seeded", "variant": "path", "risk_law": "standard"}


def make_env(
    backend: str, task: str, config: Mapping[str, Any] | None = None, render_mode: str | None = None
) -> gym.Env[Any, Any]:
    """One of the five driving tasks on one of the simulators.

    Args:
        backend: "sumo", "highway-env" or "replica".
        task: "highway", "two-way", "roundabout", "intersection" or "u-turn".
        config: highway-env's configuration keys and `risk`, laid over the task's defaults.
        render_mode: None or "rgb_array".

    Raises:
        UserError: unknown backend or task, or the simulator is not installed.
    """
    if backend not in BACKENDS:
        raise unknown("backend", backend, BACKENDS)
    if task not in TASKS:
        raise unknown("task", task, TASKS)
    settings, fixed = dict(config or {}), {}
    if backend == "replica":  # what is fixed for an environment's life is in the study's configuration
        fixed = {name: settings.pop(name, default) for name, default in REPLICA.items()}
    try:
        # by its specification: an id would warn that highway-env has a later version, and the variant says which
        id: Any = IDS[backend].format(task)
        if backend == "replica":
            id = gym.spec(id.partition(":")[2])
        return gym.make(id, config=settings, render_mode=render_mode, **fixed)
    except ModuleNotFoundError as error:
        name = getattr(error.__cause__ or error, "name", None)  # gymnasium's own error has none
        if name in ("libsumo", "highway_env", "numba"):
            raise UserError(
                f"{backend} needs the package {name}, which is not installed: run make setup"
            ) from None
        raise
