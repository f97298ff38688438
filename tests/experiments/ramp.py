"""A sixth task, an on-ramp: what somebody adds to the catalogue, on a simulator that is the fake environment.

Importing this module registers it: the task, its sheet, and its environment on the backend sumo. The other backends
and the table of fingerprints do not know it.
"""

from __future__ import annotations

import sys
from typing import Any

import gymnasium as gym

import sumo_env
from experiments import backends
from experiments.study.design.sheet import SHEETS, Sheet
from sumo_env.config import Config
from sumo_env.tasks import TASKS
from sumo_env.tasks.highway import Highway
from tests.experiments.fake_env import FakeEnv


class OnRamp(Highway):
    """Another name, other levels and an episode of its own; its simulator is the fake environment."""

    name = "on-ramp"
    defaults: Config = {**Highway.defaults, "vehicles_count": 3, "duration": 10}  # noqa: RUF012
    levels = {str(count): {"vehicles_count": count} for count in (3, 6)}  # noqa: RUF012


def simulator(config: Any = None, render_mode: str | None = None) -> FakeEnv:
    print("a simulator starts", file=sys.stderr)
    return FakeEnv("on-ramp", dict(config or {}), render_mode)


def make_env(*arguments: Any, **named: Any) -> gym.Env[Any, Any]:
    """As `backends.make_env`; where another process imports it, the task is registered there, too."""
    return backends.make_env(*arguments, **named)


TASKS["on-ramp"] = OnRamp()
SHEETS["on-ramp"] = Sheet(return_range=10.0, episode_length=8, quick_updates=3000)
sumo_env.register("sumo/on-ramp-v0", TASKS["on-ramp"])
gym.registry["sumo/on-ramp-v0"].entry_point = "tests.experiments.ramp:simulator"
gym.registry["sumo/on-ramp-v0"].kwargs.clear()
