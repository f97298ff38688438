"""highway-env's GrayscaleObservation: the original on the same traffic, on SUMO, and its most copied example."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers its environments)
import numpy as np
import pytest

import sumo_env  # noqa: F401  (likewise)
from sumo_env.config import ConfigError
from sumo_env.rendering.scenery import HIGHWAY_ENVS
from tests.sumo_env.rollout import drive

PICTURES: dict[str, Any] = {
    "type": "GrayscaleObservation",
    "observation_shape": (128, 64),
    "stack_size": 4,
    "weights": [0.2989, 0.5870, 0.1140],
    "scaling": 1.75,
}
EDGE = 4  # [px] at the edge of a picture, where one car may be in it and the other one not yet
NEAR = 3  # [px] between the same car in both: one rounds where the other one cuts off and turns a picture of the car


GREYS = HIGHWAY_ENVS.in_grey(np.array(PICTURES["weights"]))


def cars(picture: np.ndarray) -> np.ndarray:
    """Where there is neither ground nor a line, as rows of column and row."""
    return np.argwhere((picture != 0) & (picture != GREYS.ground) & (picture != GREYS.line))


@pytest.mark.slow
@pytest.mark.parametrize("id", ["highway-fast-v0", "roundabout-v1", "u-turn-v1"])
def test_it_is_highway_env_s(id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Space, type and order of the pictures are the same, and cars are at the same pixels."""
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)  # highway-env draws nothing for "dummy"
    config = {"observation": {**PICTURES, "observation_shape": (160, 96), "scaling": 4.0}}
    theirs: Any = gym.make(gym.spec(id), config=config, disable_env_checker=True)
    ours: Any = gym.make(gym.spec(f"replica/{id}"), config=config)
    assert theirs.observation_space == ours.observation_space
    seen = theirs.reset(seed=1)[0], ours.reset(seed=1)[0]
    for _ in range(6):
        assert seen[0].dtype == seen[1].dtype and seen[0].shape == seen[1].shape
        for pair in zip(*seen, strict=True):
            for one, other in (pair, pair[::-1]):
                here, there = cars(one), cars(other)
                here = here[((here >= EDGE) & (here < np.array(one.shape) - EDGE)).all(axis=1)]
                apart = np.abs(here[:, None] - there).max(axis=2).min(axis=1, initial=99)
                assert one.any() == other.any() and (apart <= NEAR).all()
        middle = [{*pictures[-1][20:-20, 20:-20].ravel().tolist()} for pictures in seen]
        assert {GREYS.ego, GREYS.crashed} & middle[0] == {GREYS.ego, GREYS.crashed} & middle[1] != set()
        seen = theirs.step(1)[0], ours.step(1)[0]
    for env in (theirs, ours):
        env.close()


@pytest.mark.parametrize("id", ["sumo/u-turn-v0", "replica/u-turn-v0"])
def test_the_newest_picture_is_the_last_and_pictures_change_nothing(id: str) -> None:
    env, plain = (gym.make(id, config={"observation": kind}) for kind in (PICTURES, {"type": "Kinematics"}))
    for seed in range(2):
        before, _ = env.reset(seed=seed)
        plain.reset(seed=seed)
        assert not before[:-1].any() and before[-1].any()
        for (seen, *result), (_, *expected) in zip(drive(env, 0), drive(plain, 0), strict=True):
            assert env.observation_space.contains(seen) and result[:3] == expected[:3]
            assert np.array_equal(seen[:-1], before[1:]) and not np.array_equal(seen[-1], before[-1])
            before = seen
    env.reset(seed=3)
    env.step(1)
    twin = copy.deepcopy(env)
    assert np.array_equal(twin.step(1)[0], env.step(1)[0])
    for one in (env, plain, twin):
        one.close()


def test_an_agent_does_not_see_who_is_in_an_event() -> None:
    """In films such cars are yellow."""
    env: Any = gym.make("sumo/u-turn-v0", config={"risk": 1.0, "observation": PICTURES}).unwrapped
    env.reset(seed=0)
    seen = env.observation_type.observe()[-1]
    object.__setattr__(env.scene, "in_event", frozenset(env.scene.ids))
    assert np.array_equal(env.observation_type.observe()[-1], seen)
    env.close()


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"stack_size": 0}, "stack_size"),
        ({"observation_shape": [128.5, 64]}, "observation_shape"),
        ({"observation_shape": [128]}, "observation_shape"),
        ({"weights": [1.0]}, "weights"),
        ({"scaling": -1}, "scaling"),
        ({"centering_position": [0.5]}, "centering_position"),
    ],
    ids=str,
)
def test_errors_name_the_key(wrong: dict[str, Any], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        gym.make("sumo/highway-v0", config={"observation": {**PICTURES, **wrong}})


@pytest.mark.slow
@pytest.mark.parametrize("of", ["sumo", "replica"])
def test_highway_env_s_example_of_pictures_trains(of: str) -> None:
    """Its sb3_highway_dqn_cnn.py with the id changed, and fewer steps."""
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import DummyVecEnv

    def train_env() -> Any:
        config = {"offscreen_rendering": True, "observation": PICTURES, "policy_frequency": 2}
        env = gym.make(f"{of}/highway-fast-v0", config=config)
        env.reset()
        return env

    settings = {
        "learning_rate": 5e-4,
        "buffer_size": 200,
        "learning_starts": 8,
        "batch_size": 4,
        "gamma": 0.8,
    }
    settings |= {
        "train_freq": 1,
        "gradient_steps": 1,
        "target_update_interval": 50,
        "exploration_fraction": 0.7,
    }
    model = stable_baselines3.DQN("CnnPolicy", DummyVecEnv([train_env]), device="cpu", **settings)
    model.learn(total_timesteps=12)
    env = train_env()
    action, _ = model.predict(env.reset()[0])
    assert env.action_space.contains(int(action))
    env.close()
