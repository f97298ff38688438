"""Systems that lack what Linux has, the fork of a process: workers and copies do as before."""

from __future__ import annotations

import copy
from contextlib import closing
from typing import Any

import gymnasium as gym
import pytest

from sumo_env.sumo import pipe
from tests.sumo_env.rollout import assert_same_bits, drive

ACTIONS = [1, 0, 2, 3, 1, 4]


@pytest.fixture
def no_fork(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows and macOS: a process that has loaded SUMO is not forked."""
    monkeypatch.setattr(pipe, "FORKS", False)
    monkeypatch.setattr("sumo_env.sumo.process._Worker.fork", None)


def test_workers_and_copies_drive_the_same_episode(no_fork: None) -> None:
    ids = ["sumo/roundabout-v0"] * 2
    with closing(gym.make(ids[0])) as here, closing(gym.make(ids[1])) as there:
        for env in (here, there):
            env.reset(seed=3)
        envs: list[Any] = [here, there]
        for first, second in zip(*(drive(env, ACTIONS[:3]) for env in envs), strict=True):
            assert_same_bits(first, second)
        copies = [copy.deepcopy(env) for env in envs]
        copies.append(copy.deepcopy(copies[0]))
        copies += [env.unwrapped.imagine(5) for env in envs]
        for first, *others in zip(*(drive(env, ACTIONS[3:]) for env in (*envs, *copies)), strict=True):
            for other in others[:-2]:
                assert_same_bits(first, other)
            assert_same_bits(*others[-2:])
        for env in copies:
            env.close()
