"""SUMO in this process, given back after every test."""

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
def start(simulator: SumoSimulator) -> Callable[..., DrivingEnv]:
    """Makes an environment at the start of a scenario that a function has changed."""

    def begin(
        task: str, change: Change = lambda scenario: scenario, seed: int = 0, **config: Any
    ) -> DrivingEnv:
        env = DrivingEnv(task, config, simulator=simulator)
        env.reset(seed=seed, options={"scenario": change(env.task.scenario(env.config, seed))})
        return env

    return begin
