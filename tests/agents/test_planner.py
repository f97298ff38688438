"""The planner, on a road without SUMO: a car that waits somewhere ahead and may be there or not."""

import copy
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest

from agents.rules import make_policy
from agents.rules.planner import Planner

NAMES = {0: "SLOWER", 1: "IDLE", 2: "FASTER"}


class Road(gym.Env[np.ndarray, int]):
    """Each step covers the action's number of metres and pays them; whoever is at `hidden` when it strikes crashes."""

    action_space: gym.spaces.Space[Any] = gym.spaces.Discrete(3)
    observation_space = gym.spaces.Box(-np.inf, np.inf, (1,))
    actions: ClassVar[dict[int, str]] = NAMES
    open_copies: ClassVar[set[int]] = set()

    def __init__(self, strikes_at: int | None = 2, places: tuple[int, ...] = (2, 3, 4)) -> None:
        self.strikes_at, self.places = strikes_at, places
        self.place, self.steps, self.is_over = 0, 0, False

    def get_available_actions(self) -> list[int]:
        return [0, 1, 2]

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self.place, self.steps, self.is_over = 0, 0, False
        return np.zeros(1), {}

    def step(self, action: int) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        assert not self.is_over
        self.place += action
        self.steps += 1
        crashed = self.steps == self.strikes_at and self.place in self.places
        self.is_over = crashed or self.steps >= 6
        return np.array([self.place]), float(action), crashed, self.steps >= 6, {"crashed": crashed}

    def __deepcopy__(self, memo: dict[Any, Any]) -> "Road":
        twin = copy.copy(self)
        self.open_copies.add(id(twin))
        memo["kept", id(twin)] = twin
        return twin

    def imagine(self, seed: int) -> "Road":
        twin = copy.deepcopy(self)
        twin.strikes_at = None if seed % 2 else twin.strikes_at and 2
        twin.places = (4,)
        return twin

    def close(self) -> None:
        self.open_copies.discard(id(self))


def drive(env: gym.Env[Any, Any], name: str, seed: int = 0) -> tuple[float, bool]:
    """The return of an episode, and whether it ends in a crash."""
    policy = make_policy(name, env)
    observation, _ = env.reset(seed=seed)
    policy.reset(seed)
    total, over = 0.0, False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        total, over = total + float(reward), terminated or truncated
    return total, bool(info["crashed"])


@pytest.mark.parametrize(("places", "best"), [((4,), 11.0), ((3, 4), 10.0), ((2, 3, 4), 9.0), ((), 12.0)])
def test_who_knows_the_future_finds_the_best_way_around(places: tuple[int, ...], best: float) -> None:
    """A crash is avoided by as little as it takes."""
    assert drive(Road(places=places), "clairvoyant") == (best, False)


def test_who_imagines_does_not_know_the_future() -> None:
    """The same is imagined, whatever is going to happen."""
    for seed in range(5):
        chosen = set()
        for places in ((4,), (3, 4), ()):
            env = Road(places=places)
            policy = Planner(env, foresees=False)
            policy.reset(seed)
            chosen.add(policy.act(np.zeros(1)))
        assert len(chosen) == 1


def test_planning_leaves_the_environment_as_it_was_and_closes_its_copies() -> None:
    env = Road()
    Road.open_copies.clear()
    for foresees in (False, True):
        Planner(env, foresees).act(np.zeros(1))
    assert (env.place, env.steps) == (0, 0)
    assert not Road.open_copies


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planner", "clairvoyant"])
def test_it_plans_on_sumo(name: str) -> None:
    env = gym.make("sumo_env:sumo/u-turn-v0", config={"risk": 1.0, "vehicles_count": 3, "duration": 5})
    assert not drive(env, name, seed=1)[1]
    env.close()
