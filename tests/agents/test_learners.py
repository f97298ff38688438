"""Every learner keeps the contract: the same training again, a policy in a file, progress in environment steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from agents.dqn import DQNConfig, say_torch
from agents.learner import settings_of
from agents.learners import LEARNERS
from agents.streams import episode_seed
from tests.agents.networks import weights
from tests.experiments.computed import Interrupted, interrupting
from tests.experiments.fake_env import FakeEnv

SMALL: dict[str, Any] = {
    "dqn": DQNConfig("dueling", updates=60, steps_per_update=2, warm_up=80, batch_size=8),
    "sb3-dqn": LEARNERS["sb3-dqn"].Settings(steps=200, learning_starts=40, hidden=16),
    "sb3-ppo": LEARNERS["sb3-ppo"].Settings(steps=200, n_steps=40, batch_size=20, n_epochs=2, hidden=16),
}


class Episodes(gym.Wrapper):
    """The episodes of training 7 in their order."""

    episode = 0

    def reset(self, *, seed: int | None = None, **options: Any) -> Any:
        seed = episode_seed(7, self.episode) if seed is None else seed
        self.episode += 1
        return self.env.reset(seed=seed, **options)


def make_env(n: int | None = None) -> gym.Env:
    return Episodes(FakeEnv("u-turn", {"duration": 10}))


def train(name: str, progress: Callable[[int], None] = lambda _: None) -> Any:
    return LEARNERS[name].train(make_env, SMALL[name], 7, progress=progress)


@pytest.mark.parametrize("name", LEARNERS)
def test_a_training_is_stored_and_begun_again_to_the_same_bits(name: str, tmp_path: Path) -> None:
    seen: list[int] = []
    whole = train(name, seen.append)
    assert seen == sorted(seen) and seen and 0 < seen[-1] <= whole.record["steps"]
    assert whole.record["steps"] >= SMALL[name].steps
    assert whole.episodes["length"].sum() == whole.episodes["step"][-1] <= whole.record["steps"]
    assert set(whole.episodes) >= {"episode", "step", "return", "length", "crashed"}

    with pytest.raises(Interrupted):
        train(name, interrupting(160))
    again = train(name)
    assert weights(again.policy) == weights(whole.policy)
    np.testing.assert_array_equal(again.episodes["return"], whole.episodes["return"])

    whole.policy.save(tmp_path / "weights.npz")
    loaded = LEARNERS[name].load(tmp_path / "weights.npz", SMALL[name], make_env())
    for observation in np.random.default_rng(0).uniform(-1, 1, (20, 2, 5)).astype(np.float32):
        assert loaded.act(observation) == whole.policy.act(observation)
    other = replace(SMALL[name], network="attention") if name == "dqn" else replace(SMALL[name], hidden=8)
    with pytest.raises(ValueError, match="another network"):
        LEARNERS[name].load(tmp_path / "weights.npz", other, make_env())


@pytest.mark.parametrize("name", [name for name in LEARNERS if name != "dqn"])
def test_settings_of_stable_baselines3_are_those_of_highway_envs_examples(name: str) -> None:
    assert (
        asdict(LEARNERS[name].Settings()).items()
        >= {"gamma": 0.8, "learning_rate": 5e-4, "hidden": 256}.items()
    )


@pytest.mark.parametrize("name", LEARNERS)
def test_a_name_that_is_no_setting_is_an_error_with_the_nearest(name: str) -> None:
    cls = LEARNERS[name].Settings
    assert settings_of(cls, {"gamma": 0.9}, name).gamma == 0.9
    with pytest.raises(
        ValueError, match=rf"unknown setting 'gama' of {name}: did you mean 'gamma'\? known are"
    ):
        settings_of(cls, {"gama": 0.9}, name)
    for wrong in ({"batch_size": 0}, {"batch_size": 2.5}, {"learning_rate": -1.0}, {"batch_size": "many"}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            settings_of(cls, wrong, name)
    assert {"steps", "updates"} <= {*dir(cls), *(field.name for field in fields(cls))}


def test_a_learner_names_the_packages_that_decide_its_bits(capfd) -> None:
    assert DQNConfig().packages == ("numba",)
    assert DQNConfig(by_hand=False).packages == () == DQNConfig("dueling").packages
    say_torch.cache_clear()
    train("dqn")
    train("dqn")
    assert capfd.readouterr().err.count("torch makes the updates") == 1
