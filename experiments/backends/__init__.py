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
    try:
        if backend == "sumo":
            import sumo_env  # noqa: F401  (registers the ids)

            return gym.make(f"sumo/{task}-v0", config=dict(config or {}), render_mode=render_mode)
        if backend == "replica":
            return _replica(task, dict(config or {}), render_mode)
        from experiments.backends import highway_env

        return highway_env.make(task, config, render_mode)
    except ModuleNotFoundError as error:
        if error.name in ("libsumo", "highway_env", "numba"):
            raise UserError(
                f"{backend} needs the package {error.name}, which is not installed: run make setup"
            ) from None
        raise


def _replica(task: str, config: dict[str, Any], render_mode: str | None) -> gym.Env[Any, Any]:
    """The replica on the study's scenarios; what is fixed for an environment's life is in the study's configuration."""
    import sumo_env  # noqa: F401  (registers the ids)

    fixed = {"variant": config.pop("variant", "path"), "risk_law": config.pop("risk_law", "standard")}
    return gym.make(f"replica/{task}-v0", config=config, render_mode=render_mode, scenarios="seeded", **fixed)
