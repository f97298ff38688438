"""The window of render_mode="human", on SDL's display that shows nothing, and without waiting for real time."""

import copy
import sys
from collections.abc import Iterator
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pygame
import pytest

from sumo_env import play
from sumo_env.config import ConfigError
from sumo_env.env import DrivingEnv
from tests.sumo_env.rollout import drive


class Hurried:
    """A clock that does not wait."""

    ticks: ClassVar[list[float]] = []

    def tick(self, frequency: float) -> None:
        self.ticks.append(frequency)


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(pygame.time, "Clock", Hurried)
    Hurried.ticks.clear()
    yield
    pygame.display.quit()


def shown() -> Any:
    return pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)


@pytest.mark.parametrize("id", ["sumo/highway-v0", "sumo/intersection-v0", "replica/u-turn-v0"])
def test_a_window_shows_every_simulation_step_and_changes_nothing(id: str) -> None:
    config = {"risk": 1.0} if id.startswith("sumo") else {"observation": {"type": "Kinematics"}}
    seen, quiet = gym.make(id, config=config, render_mode="human"), gym.make(id, config=config)
    inner: Any = seen.unwrapped
    steps, actions = 0, [0, 1, 2]
    expected = list(drive(quiet, actions, 2))
    quiet.close()
    for ours, theirs in zip(drive(seen, actions, 2), expected, strict=True):
        assert np.array_equal(ours[0], theirs[0]) and ours[1] == theirs[1]
        steps += 1
    assert len(Hurried.ticks) == 1 + steps * inner.config["simulation_frequency"] and steps
    inner.render_mode, picture = "rgb_array", shown()
    assert np.array_equal(picture, inner.render())
    seen.close()
    assert not pygame.display.get_init()


def test_closing_the_window_ends_the_episode_and_the_next_one_has_none() -> None:
    env = DrivingEnv("highway", {"vehicles_count": 3, "manual_control": True}, render_mode="human")
    env.reset(seed=0)
    assert not env.step(1)[3]
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    with pytest.warns(UserWarning, match="the window was closed"):
        *_, terminated, truncated, _ = env.step(1)
    assert truncated and not terminated and env.render_mode is None and not pygame.display.get_init()
    env.reset(seed=1, options={"config": {"vehicles_count": 4}})
    assert not env.step(1)[3] and not pygame.display.get_init()
    env.close()


def test_a_copy_goes_on_without_a_window() -> None:
    env = DrivingEnv("highway", {"vehicles_count": 3}, render_mode="human")
    env.reset(seed=0)
    twin = copy.deepcopy(env)
    before = len(Hurried.ticks)
    twin.step(1)
    assert len(Hurried.ticks) == before
    env.step(1)
    assert len(Hurried.ticks) == before + 10
    for one in (env, twin):
        one.close()


def press(*keys: int) -> None:
    for key in keys:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))


@pytest.mark.parametrize(
    ("action", "key", "expected"),
    [
        ({"type": "DiscreteMetaAction"}, pygame.K_RIGHT, 3),
        ({"type": "DiscreteMetaAction"}, pygame.K_UP, 0),
        ({"type": "DiscreteMetaAction", "lateral": False}, pygame.K_UP, 1),
        ({"type": "ContinuousAction"}, pygame.K_DOWN, [-0.7, 0.0]),
        ({"type": "ContinuousAction", "longitudinal": "sumo"}, pygame.K_RIGHT, [0.7]),
    ],
)
def test_arrow_keys_drive_as_in_highway_env(action: dict[str, Any], key: int, expected: Any) -> None:
    env = DrivingEnv("highway", {"action": action, "manual_control": True}, render_mode="human")
    env.reset(seed=0)
    idle = env.step(env.action_space.sample())[4]["action"]
    assert np.array_equal(idle, np.zeros(len(expected)) if isinstance(expected, list) else 1)
    press(key)
    env.step(env.action_space.sample())  # keys are read while it drives
    assert env.step(env.action_space.sample())[4]["action"] == pytest.approx(expected)
    env.close()


def test_manual_control_needs_actions_that_keys_have() -> None:
    config = {"manual_control": True, "action": {"type": "DiscreteAction"}}
    env = DrivingEnv("highway", config, render_mode="human")
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="'manual_control' needs"):
        env.step(0)
    env.close()


def test_play_says_how_each_episode_has_ended(capsys: pytest.CaptureFixture[str]) -> None:
    play.main(["--task", "u-turn", "--risk", "1", "--episodes", "2", "--seed", "3"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["seed 3", "seed 4"] and "return" in lines[0]
    with pytest.raises(SystemExit):
        play.main(["--risk", "2"])


def test_play_without_pygame_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(SystemExit, match=r"^render_mode='human' needs pygame: pip install pygame-ce$"):
        play.main([])
