"""The environments of `sumo_env` over the replica."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym

from sumo_env.config import Config, ConfigError, nearest
from sumo_env.env import DrivingEnv
from sumo_env.replica.linear import LAWS, check_law, draw
from sumo_env.replica.simulator import VARIANTS, Replica
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import Task
from sumo_env.traffic.scenario import Scenario

__all__ = ["VARIANTS", "Replica", "make"]

SIMULATION_FREQUENCY = 15  # [Hz] highway-env's


def _environment(task: str, config: Mapping[str, Any], render_mode: str | None = None) -> DrivingEnv:
    """The environment of a task over the replica, as gymnasium's registry makes it."""
    config = {"simulation_frequency": SIMULATION_FREQUENCY, **config}
    variant = config.pop("variant", "path")
    if variant not in VARIANTS:
        raise ConfigError(f"unknown 'variant' {variant!r}: {nearest(str(variant), list(VARIANTS))}")
    law = check_law(config.pop("risk_law", LAWS[0]))
    env = DrivingEnv(task, config, render_mode, simulator=Replica(variant, is_linear=law == "linear"))
    if law == "linear":
        env.task = _with_linear_drivers(env.task)
    return env


def _with_linear_drivers(task: Task) -> Task:
    """The task with the scenarios of the law "linear"."""

    class LinearTask(type(task)):  # type: ignore[misc]
        def scenario(self, config: Config, seed: int) -> Scenario:
            return draw(task, config, seed)

    return LinearTask()


for _task in TASKS:
    gym.register(f"replica/{_task}", entry_point=f"{__name__}:_environment", kwargs={"task": _task})


def make(
    task: str, config: Mapping[str, Any] | None = None, render_mode: str | None = None
) -> gym.Env[Any, Any]:
    """The replica's environment of a task.

    The configuration is that of `sumo_env` with ``simulation_frequency`` 15, highway-env's, and two keys more,
    which are the environment's for its whole life: ``variant`` (see `Replica`) and ``risk_law``, "standard" or "linear"
    (see `sumo_env.replica.linear`).

    Raises:
        ConfigError: unknown key, wrong value.
    """
    return gym.make(f"replica/{task}", config=dict(config or {}), render_mode=render_mode)
