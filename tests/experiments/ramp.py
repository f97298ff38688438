"""A sixth task, an on-ramp: what somebody adds to the catalogue, on a simulator that is the fake environment.

Importing this module registers it: the task, its sheet, and its environment on the backend sumo. The other backends
and the table of fingerprints do not know it.
"""

from __future__ import annotations

import sys
from typing import Any

import gymnasium as gym
import numpy as np

import sumo_env
from experiments import backends
from experiments.study.design.sheet import SHEETS, Sheet
from sumo_env.config import DISCRETE_META_ACTION, Config
from sumo_env.networks.lanes import StraightLane
from sumo_env.networks.roads import Road
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import Drivers, EgoState, Task, ego_driver, make_on_lane
from sumo_env.traffic.scenario import EGO, VehicleSpec
from tests.experiments.fake_env import FakeEnv


class OnRamp(Task):
    """Merge from a ramp into the traffic of a main road."""

    name = "on-ramp"
    ego_road = ("r", "m")
    defaults: Config = {  # noqa: RUF012
        "observation": {"type": "Kinematics"},
        "action": {**DISCRETE_META_ACTION, "target_speeds": [10, 20, 30]},
        "vehicles_count": 3,
        "duration": 10,
        "collision_reward": -1.0,
        "merged_reward": 0.5,
    }
    levels = {str(count): {"vehicles_count": count} for count in (3, 6)}  # noqa: RUF012

    def road(self, config: Config) -> Road:
        ramp, main = StraightLane((0.0, 8.0), (200.0, 4.0)), StraightLane((0.0, 4.0), (200.0, 4.0))
        onward = StraightLane((200.0, 4.0), (400.0, 4.0))
        return Road("on-ramp", {("r", "m", 0): ramp, ("a", "m", 0): main, ("m", "b", 0): onward})

    def ego(self, config: Config, road: Road, rng: np.random.Generator) -> VehicleSpec:
        return make_on_lane(road, EGO, ("r", "m", 0), 0.0, 20.0, ego_driver(self))

    def vehicles(
        self, config: Config, road: Road, ego: VehicleSpec, rng: np.random.Generator, drivers: Drivers
    ) -> list[VehicleSpec]:
        places = 40.0 * np.arange(config["vehicles_count"])
        return [
            make_on_lane(road, f"v{k}", ("a", "m", 0), float(s), 20.0, drivers.next())
            for k, s in enumerate(places)
        ]

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        return {"collision_reward": float(ego.crashed), "merged_reward": float(ego.lane[0] == "m")}

    def terminated(self, ego: EgoState, config: Config) -> bool:
        return ego.crashed or (ego.lane[0] == "m" and ego.s > 100.0)


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
