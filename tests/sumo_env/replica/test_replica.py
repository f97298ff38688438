"""The replica as a simulator; as an environment it is tested in tests/sumo_env/env/test_driving.py."""

from __future__ import annotations

import copy
import json
import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.backends import make_env
from sumo_env.env import DrivingEnv
from sumo_env.replica.compiled import compile_notice, compiled
from sumo_env.replica.numpy_loops import arcsin, arctan, arctan2, binary, power, tan, unary
from sumo_env.replica.simulator import Replica
from sumo_env.simulator import EgoCommand
from tests.processes import python

SMALL: dict[str, dict[str, Any]] = {"highway": {"vehicles_count": 12}}


def make(task: str, **config: Any) -> DrivingEnv:
    env: Any = make_env("replica", task, {**SMALL.get(task, {}), **config}).unwrapped
    return env


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


def test_functions_round_as_numpy_does_on_this_processor() -> None:
    rng = np.random.default_rng(7)
    for x, y in zip(rng.uniform(-1.0, 1.0, 2000), rng.uniform(3.5, 4.5, 2000), strict=True):
        theirs = np.tan(x), np.arcsin(x), np.arctan(x), np.arctan2(x, y), np.power(abs(x), y)
        assert functions(x, y) == theirs


@compiled
def functions(x: float, y: float) -> tuple[float, float, float, float, float]:
    """All five, which only kernels can call."""
    return unary(tan, x), unary(arcsin, x), unary(arctan, x), binary(arctan2, x, y), binary(power, abs(x), y)


def test_stale_machine_code_that_cannot_be_removed_is_not_used(tmp_path, monkeypatch) -> None:
    """As in the directory of another user: the package can be imported, and compiles in each process."""

    def refuse(path: Path, **_: Any) -> None:
        raise PermissionError(path)

    monkeypatch.setattr("numba.core.caching.FunctionCache.cache_path", str(tmp_path))
    index = tmp_path / "kernels.square-1.py311.nbi"
    index.touch()
    os.utime(index, (0.0, 0.0))  # older than every source
    monkeypatch.setattr(Path, "unlink", refuse)

    @compiled
    def square(x: float) -> float:
        return x * x

    assert square(3.0) == 9.0
    machine_code: Any = square
    assert machine_code.stats.cache_path is None and index.exists()


def test_who_begins_while_another_one_compiles_waits_and_loads(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("numba.core.caching.FunctionCache.cache_path", str(tmp_path))

    @compiled
    def square(x: float) -> float:
        return x * x

    done = []

    def second() -> None:
        with compile_notice(square):
            done.append(True)

    with compile_notice(square):
        thread = threading.Thread(target=second)  # locks are those of open files: as another process
        thread.start()
        thread.join(0.2)
        assert not done
        (tmp_path / "kernels.square-1.py311.nbi").touch()
    thread.join(10.0)
    assert done and capsys.readouterr().err.count("once for this installation") == 1


EPISODES = """
import json, sys
import gymnasium as gym
import numba
import numpy as np
import sumo_env
from sumo_env.replica.motion import move

task, law = sys.argv[1:]
options = {"config": {"risk": 1.0}, "scenarios": "seeded", "risk_law": law}
env = gym.make(f"replica/{task}-v0", **options)
numbers = [env.reset(seed=3)[0].tolist()]
for action in (1, 2, 0, 1):
    observation, reward, *_ = env.step(action)
    numbers.append([observation.tolist(), reward])
envs = gym.make_vec(f"replica/{task}-v0", num_envs=2, **options)
batch = envs.reset(seed=3)[0].tolist(), *(part.tolist() for part in envs.step(np.array([1, 2]))[:4])
print(json.dumps({"compiled": hasattr(move, "py_func"), "numbers": [numbers, batch]}))
"""


def flat(value: Any) -> list[float]:
    return [number for part in value for number in flat(part)] if isinstance(value, list) else [float(value)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "law"), [("u-turn", "linear"), pytest.param("intersection", "standard", marks=pytest.mark.long)]
)
def test_kernels_as_python_drive_as_compiled_ones_do(task: str, law: str) -> None:
    compiled = json.loads(python("-c", EPISODES, task, law))
    plain = json.loads(python("-c", EPISODES, task, law, NUMBA_DISABLE_JIT="1"))
    assert compiled["compiled"] and not plain["compiled"]
    np.testing.assert_allclose(flat(plain["numbers"]), flat(compiled["numbers"]), rtol=1e-9, atol=1e-12)
