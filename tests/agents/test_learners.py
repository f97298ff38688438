"""Every learner keeps the contract: the same training again, a policy in a file, progress in environment steps."""

import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3
import torch

from agents.dqn import DQNConfig
from agents.learners import LEARNERS
from agents.sb3 import Attention
from agents.streams import episode_seed
from tests.agents import networks
from tests.experiments.fake_env import FakeEnv

SHORT: dict[str, Any] = {"updates": 60, "steps_per_update": 2, "warm_up": 80, "batch_size": 8}
# The learner and more words: settings of a short training, and those that differ in an agent whose weights another one
# cannot take, if any.
SMALL: dict[str, tuple[Any, dict[str, Any]]] = {
    "dqn": (DQNConfig("dueling", **SHORT), {"network": "attention"}),
    "dqn by hand": (DQNConfig(**SHORT, replay_capacity=100), {}),  # its replay memory wraps
    "dqn that draws": (DQNConfig(f"{networks.__file__}:Noisy", **SHORT), {}),
    "dqn on CUDA": (DQNConfig(f"{networks.__file__}:Small", **SHORT, device="cuda"), {}),
    "sb3-dqn": (LEARNERS["sb3-dqn"].Settings(steps=200, learning_starts=40, hidden=16), {"hidden": 8}),
    "sb3-ppo": (
        LEARNERS["sb3-ppo"].Settings(steps=200, n_steps=40, batch_size=20, n_epochs=2, hidden=16),
        {"hidden": 8},
    ),
}


def of(name: str) -> Any:
    """The learner of an entry of `SMALL`."""
    return LEARNERS[name.split()[0]]


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
    return of(name).train(make_env, SMALL[name][0], 7, progress=progress)


def stored(policy: Any, path: Path) -> list[bytes]:
    """What a policy's file holds."""
    policy.save(path)
    with zipfile.ZipFile(path) as archive:
        return [archive.read(name) for name in sorted(archive.namelist())]


@pytest.mark.parametrize("name", sorted({*SMALL, *LEARNERS}))
def test_a_training_is_stored_and_begun_again_to_the_same_bits(name: str, tmp_path: Path) -> None:
    seen: list[int] = []
    if "CUDA" in name and not torch.cuda.is_available():
        pytest.skip("needs a CUDA device")
    (small, others), whole = SMALL[name], train(name, seen.append)
    assert seen == sorted(seen) and seen and 0 < seen[-1] <= whole.record["steps"]
    assert whole.record["steps"] >= small.steps and hasattr(small, "updates")
    assert whole.episodes["length"].sum() == whole.episodes["step"][-1] <= whole.record["steps"]
    assert set(whole.episodes) >= {"episode", "step", "return", "length", "crashed"}

    def killed(steps: int) -> None:
        if steps >= 160:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        train(name, killed)
    again = train(name)
    path = tmp_path / "weights.npz"
    assert stored(again.policy, path) == stored(whole.policy, path)
    assert again.record == whole.record
    for column, values in whole.episodes.items():
        np.testing.assert_array_equal(again.episodes[column], values, err_msg=column)

    loaded = of(name).load(path, small, make_env())
    for observation in np.random.default_rng(0).uniform(-1, 1, (20, 2, 5)).astype(np.float32):
        assert loaded.act(observation) == whole.policy.act(observation)
    if others:
        with pytest.raises(ValueError, match="another network"):
            of(name).load(path, replace(small, **others), make_env())


def test_attention_for_stable_baselines3_learns_is_stored_and_does_not_see_the_order(tmp_path: Path) -> None:
    layers, env = {"features_extractor_class": Attention}, FakeEnv("u-turn", {"duration": 10})
    model = stable_baselines3.DQN("MlpPolicy", env, seed=0, learning_starts=20, policy_kwargs=layers)
    seen = torch.rand(9, 6, 5, generator=torch.Generator().manual_seed(0))
    before = model.q_net(seen)
    model.learn(60).save(tmp_path / "model")
    after = stable_baselines3.DQN.load(tmp_path / "model").q_net(seen)
    torch.testing.assert_close(model.q_net(seen), after)
    assert (after - before).abs().min() > 0
    torch.testing.assert_close(model.q_net(seen[:, [0, 3, 1, 4, 2, 5]]), after)


def test_a_learner_names_the_packages_that_decide_its_bits() -> None:
    assert DQNConfig().packages == ("numba",)
    assert DQNConfig(by_hand=False).packages == () == DQNConfig("dueling").packages
