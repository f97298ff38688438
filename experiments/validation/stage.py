"""Scenes of one or a few vehicles, driven in either simulator, and what everybody did in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from experiments.backends import make_env
from sumo_env.config import Config
from sumo_env.drivers import driver_pool
from sumo_env.networks.roads import LaneIndex
from sumo_env.scenario import EGO, Scenario, VehicleSpec
from sumo_env.tasks import get_task
from sumo_env.tasks.base import Task, ego_driver, make_on_lane

FREQUENCY = {"sumo": 10, "highway-env": 15}  # [Hz] of simulation, and of sampling


FIELDS = ("time", "x", "y", "speed", "heading")  # of a `Motion`


@dataclass(frozen=True)
class Place:
    """Where a vehicle starts: lane, s [m] along it, speed [m/s]; `target`: desired speed if another one."""

    lane: LaneIndex
    s: float
    speed: float
    target: float | None = None
    destination: str | None = None


@dataclass(frozen=True)
class Scene:
    """A scene to be driven.

    Attributes:
        name: of the case.
        task: whose road and drivers.
        ego: where the ego starts.
        others: the other vehicles, in order; they never change lane.
        actions: (time [s], name of the meta-action); otherwise the ego idles.
        seconds: how long it is driven.
        config: changes of the task's configuration.
    """

    name: str
    task: str
    ego: Place
    others: tuple[Place, ...] = ()
    actions: tuple[tuple[float, str], ...] = ()
    seconds: float = 10.0
    config: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Motion:
    """What was driven: time (t,), and x, y, speed, heading of all vehicles (t, vehicles); SI units."""

    time: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    speed: NDArray[np.float64]
    heading: NDArray[np.float64]

    def as_dict(self) -> dict[str, Any]:
        """Plain lists, rounded to 1e-4."""
        return {name: np.round(getattr(self, name), 4).tolist() for name in FIELDS}

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> Motion:
        """The reverse of `as_dict`."""
        return cls(*(np.array(value[name], dtype=float) for name in FIELDS))

    def at(self, times: NDArray[np.float64], name: str, vehicle: int = 0) -> NDArray[np.float64]:
        """A quantity of one vehicle at other times, linear in between."""
        return np.interp(times, self.time, getattr(self, name)[:, vehicle])


def scenario_of(scene: Scene, config: Config) -> Scenario:
    """The scene as a scenario: everybody drives like the task's regular driver with exponent 4."""
    task = get_task(scene.task)
    road = task.road(config)
    driver = driver_pool(task.car_following, 0.0, True)[0]

    def spec(name: str, place: Place, is_ego: bool) -> VehicleSpec:
        return make_on_lane(
            road, name, place.lane, place.s, place.speed, ego_driver(task) if is_ego else driver,
            destination=place.destination, target_speed=place.target, changes_lanes=False,
        )  # fmt: skip

    others = tuple(spec(f"v{k}", place, False) for k, place in enumerate(scene.others))
    return Scenario(scene.task, 0, 0.0, spec(EGO, scene.ego, True), others)


def staged(name: str, scene: Scene) -> Task:
    """The task `name` with this scene for its only scenario."""

    class Staged(type(get_task(name))):  # type: ignore[misc]
        def scenario(self, config: Config, seed: int) -> Scenario:
            return scenario_of(scene, config)

    return Staged()


def open_env(backend: str, task: str, config: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """The environment of a simulator; highway-env with the compiled searches."""
    env = make_env(backend, task, config)
    if backend == "highway-env":
        from experiments.validation.accelerate import accelerate, within_reach

        accelerate(env.unwrapped)
        env.unwrapped.task = within_reach(task)  # type: ignore[attr-defined]
    return env


def drive(backend: str, scene: Scene, **config: Any) -> Motion:
    """Drive a scene, sampled at every simulation step.

    Args:
        backend: "sumo" or "highway-env".
        config: further changes of the configuration, for example of the variant.
    """
    frequency = config.pop("simulation_frequency", FREQUENCY[backend])
    env = open_env(
        backend,
        scene.task,
        {
            **scene.config, **config, "duration": scene.seconds + 1.0,
            "simulation_frequency": frequency, "policy_frequency": frequency,
        },
    )  # fmt: skip
    inner: Any = env.unwrapped
    inner.task = staged(scene.task, scene)
    numbers = {name: number for number, name in inner.actions.items()}
    env.reset(seed=0)
    frames = [inner.scene]
    pending = list(scene.actions)
    for step in range(round(scene.seconds * frequency)):
        action = "IDLE"
        if pending and pending[0][0] <= step / frequency + 1e-9:
            action = pending.pop(0)[1]
        inner.step(numbers[action])
        frames.append(inner.scene)
    env.close()
    return motion(frames, frequency)


def motion(frames: Sequence[Any], frequency: float) -> Motion:
    """The scenes of an episode as arrays; vehicles that come or go are left out."""
    names = [name for name in frames[0].ids if all(name in frame.ids for frame in frames)]
    arrays: list[NDArray[np.float64]] = []
    for field_name in FIELDS[1:]:
        arrays.append(
            np.array(
                [
                    [float(getattr(frame, field_name)[frame.ids.index(name)]) for name in names]
                    for frame in frames
                ]
            )
        )
    return Motion(np.arange(len(frames)) / frequency, *arrays)
