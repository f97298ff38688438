"""The replica as a simulator and as an environment."""

from __future__ import annotations

import copy
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from experiments.backends import make_env
from sumo_env.contacts.measures import TTC_RADIUS, ego_ttc
from sumo_env.contacts.rectangles import states
from sumo_env.env import DrivingEnv
from sumo_env.replica.compiled import compiled
from sumo_env.replica.numpy_loops import arcsin, arctan, arctan2, binary, power, tan, unary
from sumo_env.replica.simulator import Replica
from sumo_env.simulator import EgoCommand
from tests.tasks import highway_env_task

SMALL: dict[str, dict[str, Any]] = {"highway": {"vehicles_count": 12}}


def make(task: str, **config: Any) -> DrivingEnv:
    env: Any = make_env("replica", task, {**SMALL.get(task, {}), **config}).unwrapped
    return env


# -- the environment ------------------------------------------------------------------------------------------


@highway_env_task
def test_it_is_an_environment(task: str) -> None:
    env = make(task, risk=1.0)
    check_env(env, skip_render_check=True)
    assert isinstance(env, DrivingEnv)
    assert env.config["simulation_frequency"] == 15  # highway-env's


# -- the simulator --------------------------------------------------------------------------------------------


def start(task: str, seed: int = 0, **config: Any) -> tuple[Replica, Any]:
    env = make(task, **config)
    env.reset(seed=seed)
    simulator = Replica()
    scene = simulator.reset(env.scenario)
    assert scene.time == 0.0
    return simulator, env.scenario


def command(scenario: Any) -> EgoCommand:
    return EgoCommand(scenario.ego.target_speed, scenario.ego.lane)


def test_the_trace_is_the_scene_after_every_sub_step() -> None:
    simulator, scenario = start("u-turn")
    silent = copy.deepcopy(simulator)
    step = simulator.step({"ego": command(scenario)}, trace=True)
    assert [scene.time for scene in step.trace] == pytest.approx(np.arange(1, 16) / 15, abs=1e-6)
    last = step.trace[-1]
    assert (last.time, last.ids) == (step.scene.time, step.scene.ids)
    np.testing.assert_array_equal(last.x, step.scene.x)
    without = silent.step({"ego": command(scenario)})
    assert without.trace == ()
    np.testing.assert_array_equal(without.scene.x, step.scene.x)


@highway_env_task
def test_measures_are_those_of_the_trace(task: str) -> None:
    simulator, scenario = start(task, seed=3, risk=1.0)
    before = simulator.reset(scenario)
    step = simulator.step({"ego": command(scenario)}, trace=True)
    least = np.inf
    for scene in step.trace:
        if scene.crashed[0]:
            break
        ego, *others = states(scene)
        near = [o for o in others if np.hypot(o[0] - ego[0], o[1] - ego[1]) <= TTC_RADIUS]
        least = min(least, ego_ttc(ego, near))
    assert step.ego.min_ttc == pytest.approx(least, abs=1e-9)
    speeds = [before.speed[0], *(scene.speed[0] for scene in step.trace[:-1])]
    assert step.ego.distance == pytest.approx(sum(max(speed, 0.0) for speed in speeds) / 15)


def test_functions_round_as_numpy_does_on_this_processor() -> None:
    rng = np.random.default_rng(7)
    for x, y in zip(rng.uniform(-1.0, 1.0, 2000), rng.uniform(3.5, 4.5, 2000), strict=True):
        theirs = np.tan(x), np.arcsin(x), np.arctan(x), np.arctan2(x, y), np.power(abs(x), y)
        assert functions(x, y) == theirs


@compiled
def functions(x: float, y: float) -> tuple[float, float, float, float, float]:
    """All five, which only kernels can call."""
    return unary(tan, x), unary(arcsin, x), unary(arctan, x), binary(arctan2, x, y), binary(power, abs(x), y)


def stale(folder: Path) -> Path:
    """Machine code that is older than every source."""
    index = folder / "kernels.square-1.py311.nbi"
    index.touch()
    os.utime(index, (0.0, 0.0))
    return index


def test_stale_machine_code_that_cannot_be_removed_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in the directory of another user: the package can be imported, and compiles in each process."""

    def refuse(path: Path, **_: Any) -> None:
        raise PermissionError(path)

    monkeypatch.setattr("numba.core.caching.FunctionCache.cache_path", str(tmp_path))
    index = stale(tmp_path)
    monkeypatch.setattr(Path, "unlink", refuse)

    @compiled
    def square(x: float) -> float:
        return x * x

    assert square(3.0) == 9.0
    machine_code: Any = square
    assert machine_code.stats.cache_path is None and index.exists()


def test_a_simulator_can_be_sent_to_another_process() -> None:
    simulator, scenario = start("u-turn")
    other = pickle.loads(pickle.dumps(simulator))
    simulator.reset(scenario)
    np.testing.assert_array_equal(
        other.step({"ego": command(scenario)}).scene.x, simulator.step({"ego": command(scenario)}).scene.x
    )
