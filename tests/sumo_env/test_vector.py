"""Vector environments: equal to single ones, and steadfast when workers die."""

import os
import signal
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from sumo_env.config import ConfigError
from sumo_env.env import DrivingEnv
from sumo_env.sumo.process import SumoProcess
from sumo_env.vector import SumoVectorEnv
from tests.sumo_env.rollout import assert_same_bits

CONFIG = {"initial_vehicle_count": 20, "spawn_probability": 1.0}


@pytest.fixture(scope="module")
def shared() -> SumoVectorEnv:
    """Two intersections; starting processes is slow, so tests share them and reset first."""
    envs = gym.make_vec("sumo/intersection-v0", num_envs=2, config=CONFIG)
    assert isinstance(envs, SumoVectorEnv)
    return envs


@pytest.fixture
def envs(shared: SumoVectorEnv) -> SumoVectorEnv:
    shared.reset(seed=0, options={"config": {**CONFIG, "risk": 0.0}})
    return shared


def simulator(envs: SumoVectorEnv, index: int) -> SumoProcess:
    return envs.envs[index].get_wrapper_attr("_car").episode.simulator


def kill(envs: SumoVectorEnv, index: int) -> None:
    os.kill(simulator(envs, index).pid, signal.SIGKILL)


@pytest.mark.parametrize("kwargs", [{}, {"autoreset_mode": "SameStep"}], ids=str)
def test_equal_to_gymnasiums_loop_over_single_environments(kwargs: dict[str, Any]) -> None:
    """Observations, rewards, endings and infos, through two episodes and more."""
    ours = gym.make_vec("sumo/intersection-v0", num_envs=2, config=CONFIG, **kwargs)
    mode = ours.metadata["autoreset_mode"]
    theirs = gym.vector.SyncVectorEnv(2 * [lambda: DrivingEnv("intersection", CONFIG)], autoreset_mode=mode)
    for space in ("observation_space", "action_space"):
        assert getattr(ours, space) == getattr(theirs, space)
        assert getattr(ours, f"single_{space}") == getattr(theirs, f"single_{space}")
    assert_same_bits(ours.reset(seed=40), theirs.reset(seed=40))
    endings = 0
    for _ in range(32):
        step = ours.step(np.array([2, 2]))
        assert_same_bits(step, theirs.step(np.array([2, 2])))
        endings += int((step[2] | step[3]).sum())
    assert endings >= 4


def test_some_can_be_reset_alone(envs: SumoVectorEnv) -> None:
    envs.reset(seed=5)
    before, *_ = envs.step([1, 1])
    mask = np.array([False, True])
    after, _ = envs.reset(seed=[7, 8], options={"reset_mask": mask})
    np.testing.assert_array_equal(after[0], before[0])
    np.testing.assert_array_equal(after[1], envs.reset(seed=7)[0][1])


def test_configuration_at_reset(envs: SumoVectorEnv) -> None:
    envs.reset(seed=0, options={"config": {"risk": 1.0}})
    assert [config["risk"] for config in envs.get_attr("config")] == [1.0, 1.0]
    with pytest.raises(ConfigError, match="did you mean 'risk'"):
        envs.reset(options={"config": {"rysk": 1.0}})
    envs.step([0, 0])  # unharmed


def test_spaces_stay_as_they_are(envs: SumoVectorEnv) -> None:
    with pytest.raises(ValueError, match="make a new vector environment"):
        envs.reset(options={"config": {"observation": {"type": "Kinematics", "vehicles_count": 3}}})
    envs.step([1, 1])  # unharmed


def test_a_killed_worker_is_replaced(envs: SumoVectorEnv) -> None:
    envs.reset(seed=3)
    before, *_ = envs.step([1, 1])
    pids = [simulator(envs, index).pid for index in range(2)]
    kill(envs, 1)
    with pytest.warns(UserWarning, match=r"killed by SIGKILL in step 2: an episode of intersection"):
        observations, rewards, terminated, truncated, infos = envs.step([1, 1])
    assert not terminated.any()
    assert truncated.tolist() == [False, True]
    assert rewards[1] == 0.0
    assert infos["worker_died"].tolist() == [False, True]
    assert infos["_worker_died"].tolist() == [False, True]
    np.testing.assert_array_equal(observations[1], before[1])
    observations, rewards, terminated, truncated, infos = envs.step([1, 1])  # the reset
    assert not (terminated | truncated)[1]
    assert "worker_died" not in infos
    assert envs.observation_space.contains(observations)
    assert infos["_speed"].tolist() == [True, True]
    assert simulator(envs, 0).pid == pids[0]
    assert simulator(envs, 1).pid != pids[1]


def test_a_worker_that_died_before_a_reset_loses_nothing(envs: SumoVectorEnv) -> None:
    expected, _ = envs.reset(seed=9)
    kill(envs, 1)
    observations, infos = envs.reset(seed=9)
    np.testing.assert_array_equal(observations, expected)
    assert "worker_died" not in infos
    assert not envs.step([1, 1])[3].any()


def test_an_episode_that_cannot_go_on_ends_alone() -> None:
    """On a roundabout whose time is too long for a fast car: it drives off the end of the road."""
    config, fast, slow = {"vehicles_count": 0, "duration": 60}, 3, 4
    envs = gym.make_vec("sumo/roundabout-v0", num_envs=2, config=config)
    other = DrivingEnv("roundabout", config)
    last, _ = envs.reset(seed=0)[0][1], other.reset(seed=0)
    for _ in range(60):
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            seen, rewards, terminated, truncated, infos = envs.step([slow, fast])
        single = other.step(slow)
        assert_same_bits(seen[0], single[0])
        assert not terminated[0] and not truncated[0]
        if truncated[1]:
            break
        last = seen[1]
    assert "choose a shorter 'duration'" in str(warned[-1].message) and "worker_died" not in infos
    assert (terminated[1], rewards[1], infos["ending"].tolist()) == (False, 0.0, ["", "simulator error"])
    np.testing.assert_array_equal(seen[1], last)
    for _ in range(2):  # its reset, and the next episode's first step
        seen, rewards, terminated, truncated, infos = envs.step([slow, fast])
        assert_same_bits(seen[0], other.step(slow)[0])
        assert not (terminated | truncated).any() and rewards[1] >= 0.0
