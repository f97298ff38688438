"""highway-env, as it is installed, and the replica side by side on the same seeds and random actions."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers its environments)
import numpy as np

import sumo_env  # noqa: F401  (registers the environments)

EQUAL = 1e-6  # largest difference of observations and rewards
# highway-env's steering is unstable below this speed: a rounding error, which another processor makes elsewhere, grows
# sevenfold in every sub-step. From the first vehicle that is slower on, headings agree to SLOW_EQUAL.
SLOW, SLOW_EQUAL = 0.7, 1e-3  # [m/s], largest difference


def pair(task: str, config: dict[str, Any]) -> tuple[Any, Any]:
    """The environments; highway-env's with connected lanes is v1 or, of the intersection, v2."""
    return gym.make(f"{task}-v0", config=dict(config)), gym.make(f"replica/{task}-v0", config=dict(config))


def difference(theirs: Any, ours: Any, equal: float) -> str:
    """What `reset` or `step` returned differently, by name; empty if it is the same."""
    if theirs[0].shape != ours[0].shape or theirs[0].dtype != ours[0].dtype:
        return "shape"
    if not np.abs(theirs[0] - ours[0]).max() <= equal:
        return "observation"
    if len(theirs) == 2:
        return ""
    if not abs(theirs[1] - ours[1]) <= equal:
        return "reward"
    return "" if theirs[2:4] == ours[2:4] else "ends"


def episode(stock: Any, replica: Any, seed: int) -> tuple[int, str]:
    """Policy steps, and what differed; every third episode continues the stream of the one before it."""
    reset = {} if seed % 3 == 2 else {"seed": seed}
    theirs, ours = stock.reset(**reset), replica.reset(**reset)
    rng, steps, equal = np.random.default_rng(seed), 0, EQUAL
    while True:
        if min(abs(vehicle.speed) for vehicle in stock.unwrapped.road.vehicles) < SLOW:
            equal = SLOW_EQUAL
        found = difference(theirs, ours, equal)
        if not found and generator(stock) != generator(replica):
            found = "random stream"
        if found or (steps and (theirs[2] or theirs[3])):
            return steps, found
        action = int(rng.integers(stock.action_space.n))
        theirs, ours = stock.step(action), replica.step(action)
        steps += 1


def generator(env: Any) -> Any:
    """The state of the generator that traffic is drawn with."""
    return env.unwrapped.np_random.bit_generator.state


def differences(task: str, first: int, episodes: int, config: dict[str, Any]) -> list[tuple[Any, ...]]:
    """The episodes that differ: seed, step, what, configuration. highway-env's intersection changes its classes."""
    stock, replica = pair(task, config)
    found = [(seed, *episode(stock, replica, seed), config) for seed in range(first, first + episodes)]
    return [entry for entry in found if entry[2]]
