"""The driver who knows the future is at least as good as those who do not."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.backends import make_env
from experiments.study.clairvoyant import best_drive

pytest.importorskip("numba")


@pytest.mark.slow
def test_it_beats_every_constant_policy_and_leaves_the_environment_as_it_was() -> None:
    env = make_env("replica", "two-way", {"duration": 5})
    env.reset(seed=4)
    before = env.unwrapped.scene
    found, crashed = best_drive(env.unwrapped, 8, np.random.default_rng(0))
    assert env.unwrapped.scene is before
    constant = []
    for action in range(env.action_space.n):
        env.reset(seed=4)
        rewards, ended = 0.0, False
        while not ended:
            _, reward, terminated, truncated, _ = env.step(action)
            rewards, ended = rewards + float(reward), terminated or truncated
        constant.append(rewards)
    assert found >= max(constant)
    assert not crashed
