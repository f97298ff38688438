"""With NUMBA_DISABLE_JIT=1 the replica's kernels run as Python, where a debugger stops, and drive alike."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from tests.processes import python

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
    ("task", "law"),
    [("u-turn", "linear"), pytest.param("intersection", "standard", marks=pytest.mark.long)],
)
def test_kernels_as_python_drive_as_compiled_ones_do(task: str, law: str) -> None:
    compiled = json.loads(python("-c", EPISODES, task, law))
    plain = json.loads(python("-c", EPISODES, task, law, NUMBA_DISABLE_JIT="1"))
    assert compiled["compiled"] and not plain["compiled"]
    np.testing.assert_allclose(flat(plain["numbers"]), flat(compiled["numbers"]), rtol=1e-9, atol=1e-12)
