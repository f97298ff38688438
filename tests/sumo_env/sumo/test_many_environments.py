"""Other people's training code, as they write it: several environments in one script without a `__main__` guard."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.processes import ended

SCRIPT = """
import gymnasium as gym, numpy as np
CONFIG = {"vehicles_count": 5, "duration": 8}
if __name__ == "__main__":
    mine = [gym.make("sumo_env:sumo/highway-v0", config=CONFIG) for _ in range(2)]
    for env in mine:
        env.reset(seed=0)
    ENVIRONMENTS
    envs.reset()
    for _ in range(10):
        envs.step(np.array([1, 1]))
    envs.close()
    print(*(env.step(1)[4]["distance"] > 0 for env in mine))
"""


STABLE = """
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import SubprocVecEnv
    envs = make_vec_env(
        "sumo_env:sumo/highway-v0", n_envs=2, vec_env_cls=SubprocVecEnv, env_kwargs={"config": CONFIG},
        vec_env_kwargs={"start_method": "START_METHOD"},
    )
"""
GYMNASIUM = """
    make = lambda: gym.make("sumo_env:sumo/highway-v0", config=CONFIG)
    envs = gym.vector.AsyncVectorEnv([make, make], context="START_METHOD")
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start_method", "makes"),
    [
        ("fork", STABLE),
        ("spawn", GYMNASIUM),  # no torch in every process
        *(pytest.param(method, STABLE, marks=pytest.mark.long) for method in ("spawn", "forkserver")),
    ],
    ids=["fork", "spawn", "spawn-stable", "forkserver"],
)
def test_subprocesses_after_the_parent_has_used_sumo(tmp_path: Path, start_method: str, makes: str) -> None:
    """Only multiprocessing's own start methods need a guard and a file; a notebook has none. No file is left."""
    text = SCRIPT.replace("    ENVIRONMENTS\n", makes).replace("START_METHOD", start_method)
    file = tmp_path / "script.py"
    file.write_text(text)
    program, stdin = ("-", text) if start_method == "fork" else (file, "")
    done = ended("-W", "ignore::UserWarning", program, cwd=tmp_path, stdin=stdin, TMPDIR=str(tmp_path))
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith("sumo_env-")] == []
    assert done.stdout.splitlines()[-1] == "True True"
