"""Vector environments: equal to single ones, and steadfast when workers die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from sumo_env import vector
from sumo_env.config import ConfigError
from sumo_env.env import DrivingEnv
from sumo_env.simulation import SimulationTaken
from sumo_env.vector import SumoVectorEnv

CONFIG = {"initial_vehicle_count": 20, "spawn_probability": 1.0}


@pytest.fixture(scope="module")
def shared() -> Iterator[SumoVectorEnv]:
    """Two intersections; starting processes is slow, so tests share them and reset first."""
    envs = gym.make_vec("sumo/intersection-v0", num_envs=2, config=CONFIG)
    assert isinstance(envs, SumoVectorEnv)
    yield envs
    envs.close()


@pytest.fixture
def envs(shared: SumoVectorEnv) -> SumoVectorEnv:
    shared.reset(seed=0, options={"config": {**CONFIG, "risk": 0.0}})
    return shared


def kill(envs: SumoVectorEnv, index: int) -> None:
    process = envs._workers[index][0]
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    process.join(10)


def test_spaces_and_metadata(envs: SumoVectorEnv) -> None:
    single = DrivingEnv("intersection", CONFIG)
    assert envs.num_envs == 2
    assert envs.single_observation_space == single.observation_space
    assert envs.single_action_space == single.action_space
    assert envs.observation_space.shape == (2, 15, 7)
    assert envs.action_space == gym.spaces.MultiDiscrete([3, 3])
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert envs.spec is not None
    assert envs.spec.id == "sumo/intersection-v0"
    assert "intersection" in repr(envs)


def test_equal_to_single_environments(envs: SumoVectorEnv) -> None:
    """Observations, rewards, endings and infos, through two episodes and more."""
    singles = [DrivingEnv("intersection", CONFIG) for _ in range(2)]
    steps = 30
    expected = []
    for index, env in enumerate(singles):  # one after the other: they share this process's SUMO
        observation, info = env.reset(seed=40 + index)
        rows = [(observation, 0.0, False, False, info, None)]
        for _ in range(steps):
            observation, reward, terminated, truncated, info = env.step(2)
            final = None
            if terminated or truncated:
                final = (observation, info)
                observation, info = env.reset()
            rows.append((observation, reward, terminated, truncated, info, final))
        expected.append(rows)
    observations, infos = envs.reset(seed=40)
    rewards, terminated, truncated = np.zeros(2), np.zeros(2, bool), np.zeros(2, bool)
    endings = 0
    for step in range(steps + 1):
        for index in range(2):
            observation, reward, ended, cut, info, final = expected[index][step]
            np.testing.assert_array_equal(observations[index], observation)
            assert (rewards[index], terminated[index], truncated[index]) == (reward, ended, cut)
            for key in ("speed", "density", "crashed", "min_ttc"):
                assert infos[key][index] == info[key]
                assert infos[f"_{key}"][index]
            if final is not None:
                endings += 1
                np.testing.assert_array_equal(infos["final_obs"][index], final[0])
                assert infos["final_info"]["speed"][index] == final[1]["speed"]
                assert infos["final_info"]["crash"].get("time", np.zeros(2))[index] == final[1]["crash"].get(
                    "time", 0.0
                )
        if step < steps:
            observations, rewards, terminated, truncated, infos = envs.step(np.array([2, 2]))
    assert endings >= 4


def test_returned_arrays_stay_as_they_are(envs: SumoVectorEnv) -> None:
    first, _ = envs.reset(seed=1)
    kept = first.copy()
    envs.step([1, 1])
    np.testing.assert_array_equal(first, kept)
    assert first.dtype == np.float32


def test_seeds(envs: SumoVectorEnv) -> None:
    both, _ = envs.reset(seed=5)
    listed, _ = envs.reset(seed=[5, 6])
    turned, _ = envs.reset(seed=[6, 5])
    np.testing.assert_array_equal(both, listed)
    np.testing.assert_array_equal(both, turned[::-1])
    with pytest.raises(ValueError, match="3 seeds for 2"):
        envs.reset(seed=[1, 2, 3])


def test_configuration_at_reset(envs: SumoVectorEnv) -> None:
    envs.reset(seed=0, options={"config": {"risk": 1.0}})
    assert [config["risk"] for config in envs.get_attr("config")] == [1.0, 1.0]
    with pytest.raises(ConfigError, match="did you mean 'risk'"):
        envs.reset(options={"config": {"rysk": 1.0}})
    with pytest.raises(ValueError, match="make a new vector environment"):
        envs.reset(options={"config": {"observation": {"type": "Kinematics", "vehicles_count": 3}}})
    envs.step([0, 0])  # unharmed


@pytest.mark.parametrize("actions", [[0], [0, 3], [0, -1], [[0, 0]], [0.5, 0.5], None])
def test_wrong_actions_are_refused(envs: SumoVectorEnv, actions: Any) -> None:
    with pytest.raises(ValueError, match="2 elements of Discrete"):
        envs.step(actions)


def test_attributes_and_errors_of_workers(envs: SumoVectorEnv) -> None:
    assert envs.call("configure", {"screen_width": 300}) == (None, None)
    assert [config["screen_width"] for config in envs.get_attr("config")] == [300, 300]
    envs.set_attr("remark", ["a", "b"])
    assert envs.get_attr("remark") == ("a", "b")
    with pytest.raises(ValueError, match="3 values"):
        envs.set_attr("remark", [1, 2, 3])
    with pytest.raises(AttributeError) as caught:
        envs.get_attr("no_such_thing")
    assert "In worker 0" in caught.value.__notes__[0]
    with pytest.raises((TypeError, AttributeError, RuntimeError), match="pickle"):
        envs.get_attr("_world")  # cannot travel between processes
    envs.step([1, 1])  # unharmed


def test_a_killed_worker_is_replaced(envs: SumoVectorEnv) -> None:
    envs.reset(seed=3)
    before, *_ = envs.step([1, 1])
    pids = [process.pid for process, _ in envs._workers]
    kill(envs, 1)
    with pytest.warns(UserWarning, match=r"worker 1 died \(exit code -9\)"):
        observations, rewards, terminated, truncated, infos = envs.step([1, 1])
    assert not terminated.any()
    assert truncated.tolist() == [False, True]
    assert rewards[1] == 0.0
    assert infos["worker_died"].tolist() == [False, True]
    assert infos["_worker_died"].tolist() == [False, True]
    assert infos["final_info"]["worker_died"].tolist() == [False, True]
    np.testing.assert_array_equal(infos["final_obs"][1], before[1])
    assert envs.observation_space.contains(observations)
    assert observations[1, 0, 0] == 1.0  # the first of a new episode
    assert infos["density"][1] >= 0
    assert envs._workers[0][0].pid == pids[0]
    assert envs._workers[1][0].pid != pids[1]
    *_, truncated, infos = envs.step([1, 1])
    assert not truncated.any()
    assert "worker_died" not in infos


def test_what_follows_a_death_is_reproducible(envs: SumoVectorEnv) -> None:
    after = []
    for _ in range(2):
        envs.reset(seed=3)
        kill(envs, 0)
        with pytest.warns(UserWarning, match="worker 0 died"):
            after.append(envs.step([1, 1])[0])
    np.testing.assert_array_equal(after[0], after[1])
    assert not np.array_equal(after[0][0], envs.reset(seed=3)[0][0])


def test_a_new_worker_has_the_configuration_of_the_last_reset(envs: SumoVectorEnv) -> None:
    envs.reset(seed=0, options={"config": {"risk": 0.5}})
    kill(envs, 0)
    with pytest.warns(UserWarning, match="worker 0 died"):
        assert [config["risk"] for config in envs.get_attr("config")] == [0.5, 0.5]
    *_, truncated, infos = envs.step([1, 1])  # the loss is told with the next step
    assert truncated.tolist() == [True, False]
    assert infos["worker_died"].tolist() == [True, False]


def test_a_worker_that_died_before_a_reset_loses_nothing(envs: SumoVectorEnv) -> None:
    expected, _ = envs.reset(seed=9)
    kill(envs, 1)
    observations, infos = envs.reset(seed=9)
    np.testing.assert_array_equal(observations, expected)
    assert "worker_died" not in infos
    assert not envs.step([1, 1])[3].any()


@pytest.mark.slow
def test_a_silent_worker_is_replaced(envs: SumoVectorEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    process = envs._workers[0][0]
    assert process.pid is not None
    os.kill(process.pid, signal.SIGSTOP)
    monkeypatch.setattr(envs, "timeout", 2.0)
    time.sleep(0.1)
    start = vector.SumoVectorEnv._start

    def patiently(self: SumoVectorEnv, index: int) -> Any:
        monkeypatch.setattr(envs, "timeout", 300.0)
        return start(self, index)

    monkeypatch.setattr(vector.SumoVectorEnv, "_start", patiently)
    with pytest.warns(UserWarning, match="no answer for 2 s"):
        *_, truncated, _ = envs.step([1, 1])
    assert truncated[0]


def test_statistics_wrapper(envs: SumoVectorEnv) -> None:
    wrapped = RecordEpisodeStatistics(envs)
    wrapped.reset(seed=0)
    for _ in range(14):
        *_, infos = wrapped.step(np.array([1, 1]))
        if "final_info" in infos:
            break
    assert infos["episode"]["l"].max() > 0


# -- making and closing ------------------------------------------------------------------------------------


@pytest.mark.parametrize("num_envs", [0, -2])
def test_at_least_one_environment(num_envs: int) -> None:
    with pytest.raises(ValueError, match="num_envs must be at least 1"):
        gym.make_vec("sumo/highway-v0", num_envs=num_envs)


def test_wrong_configurations_are_told_before_any_process_starts() -> None:
    with pytest.raises(ConfigError, match="did you mean"):
        gym.make_vec("sumo/highway-v0", num_envs=2, config={"vehicle_count": 3})


def test_one_process_cannot_hold_two() -> None:
    envs = gym.make_vec("sumo/highway-v0", num_envs=2, vectorization_mode="sync")
    envs.reset(seed=0)
    with pytest.raises(SimulationTaken, match="without vectorization_mode='sync'"):
        envs.step(np.array([1, 1]))
    envs.close()


def test_closing_ends_the_processes_and_may_be_repeated() -> None:
    envs = SumoVectorEnv(1, "u-turn")
    process = envs._workers[0][0]
    envs.reset(seed=0)
    envs.close()
    envs.close()
    assert not process.is_alive()
    with pytest.raises(gym.error.ClosedEnvironmentError):
        envs.step([1])


SCRIPT = """
import os, sys
import gymnasium as gym, numpy as np
import sumo_env
{guard}
    envs = gym.make_vec("sumo/u-turn-v0", num_envs=2, render_mode="rgb_array")
    envs.reset(seed=0)
    envs.step(np.array([1, 1]))
    print([picture.shape for picture in envs.render()])
    print("libsumo" in sys.modules)
    print(envs._workers[0][0].pid, envs._workers[1][0].pid, flush=True)
    os.kill(os.getpid(), 9)
"""


def run_script(tmp_path: Path, guard: str) -> subprocess.CompletedProcess[str]:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(guard=guard))
    return subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False, timeout=120
    )


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except OSError:
        return False


@pytest.mark.slow
def test_workers_alone_load_sumo_and_end_with_their_parent(tmp_path: Path) -> None:
    """Even with a parent that is killed."""
    done = run_script(tmp_path, "if __name__ == '__main__':")
    assert done.returncode == -signal.SIGKILL, done.stderr
    pictures, loaded, pids = done.stdout.splitlines()
    assert pictures == "[(290, 790, 3), (290, 790, 3)]"
    assert loaded == "False"
    deadline = time.monotonic() + 30
    while any(is_running(int(pid)) for pid in pids.split()) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(is_running(int(pid)) for pid in pids.split())


@pytest.mark.slow
def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    done = run_script(tmp_path, "if True:")
    assert done.returncode == 1
    assert "WorkerError" in done.stderr
    assert "if __name__ == '__main__':" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_gymnasiums_own_processes_do_as_well() -> None:
    """Without supervision, for those who want other options of it; infos of crashed and other episodes merge."""
    envs = gym.make_vec(
        "sumo/intersection-v0",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
        config={"initial_vehicle_count": 30, "spawn_probability": 1.0},
    )
    try:
        envs.reset(seed=3)
        crashes = 0
        for _ in range(60):
            *_, infos = envs.step(np.array([2, 1]))
            crashes += infos["crash"].get("_time", np.zeros(2, bool)).sum()
        assert crashes > 0
    finally:
        envs.close()
