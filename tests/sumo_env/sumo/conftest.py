"""SUMO in this process, given back after every test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from sumo_env.env import DrivingEnv
from sumo_env.sumo.world import SumoSimulator
from sumo_env.traffic.scenario import Scenario

Change = Callable[[Scenario], Scenario]


@pytest.fixture
def simulator() -> Iterator[SumoSimulator]:
    """SUMO without an environment."""
    made = SumoSimulator()
    yield made
    made.close()


@pytest.fixture
def start() -> Iterator[Callable[..., DrivingEnv]]:
    """Makes an environment at the start of a scenario that a function has changed; the one before is closed."""
    open_ones: list[DrivingEnv] = []

    def begin(
        task: str, change: Change = lambda scenario: scenario, seed: int = 0, **config: Any
    ) -> DrivingEnv:
        while open_ones:
            open_ones.pop().close()
        env = DrivingEnv(task, config, simulator=SumoSimulator())
        open_ones.append(env)
        env.reset(seed=seed, options={"scenario": change(env.task.scenario(env.config, seed))})
        return env

    yield begin
    while open_ones:
        open_ones.pop().close()
