"""Pictures and films of an environment."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

import sumo_env
from sumo_env.rendering.scenery import FILM
from tests.sumo_env.rollout import assert_same_bits


@pytest.mark.parametrize("id", sumo_env.IDS)
def test_every_task_renders_in_its_size(id: str) -> None:
    env = gym.make(id, render_mode="rgb_array")
    env.reset(seed=0)
    env.step(1)
    picture = np.asarray(env.render())
    config = env.get_wrapper_attr("config")
    assert picture.shape == (config["screen_height"], config["screen_width"], 3)
    colours = {tuple(colour) for colour in picture.reshape(-1, 3).tolist()}
    assert {FILM.ground, FILM.asphalt, FILM.line, FILM.ego, FILM.other} <= colours


def test_without_a_render_mode_there_is_a_warning_and_no_picture() -> None:
    env = sumo_env_highway(None)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="rgb_array"):
        assert env.unwrapped.render() is None


def sumo_env_highway(render_mode: str | None, **config: Any) -> gym.Env[Any, Any]:
    return gym.make("sumo/highway-v0", render_mode=render_mode, config={"vehicles_count": 5, **config})


def test_watching_changes_nothing() -> None:
    plain, watched = sumo_env_highway(None), sumo_env_highway("rgb_array")
    assert_same_bits(plain.reset(seed=4), watched.reset(seed=4))
    for _ in range(5):
        watched.render()
        assert_same_bits(plain.step(3), watched.step(3))


@pytest.mark.parametrize("by_substep", [False, True])
def test_films(tmp_path: Path, by_substep: bool) -> None:
    env = RecordVideo(
        sumo_env_highway("rgb_array"), str(tmp_path / "films"), episode_trigger=lambda episode: True
    )
    unwrapped: Any = env.unwrapped
    if by_substep:
        unwrapped.set_record_video_wrapper(env)
        unwrapped.configure({"simulation_frequency": 20})
    env.reset(seed=0)
    env.step(1)
    env.step(1)
    assert len(env.recorded_frames) == (1 + 2 * 20 if by_substep else 1 + 2)
    assert env.frames_per_sec == (20 if by_substep else 5)
    frames = np.array(env.recorded_frames)
    assert all((a != b).any() for a, b in pairwise(frames))
    env.close()
    assert (tmp_path / "films" / "rl-video-episode-0.mp4").stat().st_size > 1000
    assert sumo_env.env.DrivingEnv.metadata["render_fps"] == 5  # of the class: untouched
