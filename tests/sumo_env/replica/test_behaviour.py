"""What highway-env's own tests ask of its types of action, of its vehicle and of several learning cars.

Asked of `replica/*` by the ids alone (highway-env's tests/envs/test_actions.py, test_env_preprocessors.py, test_gym.py,
test_observations.py, test_pettingzoo.py, tests/vehicle/test_dynamics.py and tests/graphics/test_render.py).
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import pytest

import sumo_env

pytest.importorskip("pettingzoo")
from pettingzoo.test import parallel_api_test

SHORT = {"controlled_vehicles": 2, "duration": 5}
TUPLES: dict[str, Any] = {
    **SHORT,
    "action": {
        "type": "MultiAgentAction",
        "action_config": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10]},
    },
    "observation": {"type": "MultiAgentObservation", "observation_config": {"type": "Kinematics"}},
}


def made(id: str, **keywords: Any) -> Any:
    return gym.make(gym.spec(id), disable_env_checker=True, **keywords)


# -- types of action -----------------------------------------------------------------------------------------------


# -- the vehicle ---------------------------------------------------------------------------------------------------


# -- several learning cars -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["v0", "v1", "v2"])
def test_petting_zoo_accepts_all_versions_of_the_intersection(version: str) -> None:
    """Of 1.12.1: the intersection, the same with steering, and with connected lanes."""
    parallel_api_test(sumo_env.parallel_env(f"replica/intersection-{version}", dict(SHORT)), num_cycles=10)


@pytest.mark.parametrize("id", ["replica/highway-v0", "replica/intersection-v0"])
def test_available_actions_of_tuples_are_tuples(id: str) -> None:
    """``MultiAgentAction.get_available_actions``: the product of what each car could do now."""
    env = made(id, config=TUPLES)
    theirs = made(id.partition("/")[2], config=TUPLES)
    for seed in range(3):
        env.reset(seed=seed)
        theirs.reset(seed=seed)
        ours, other = (set(one.unwrapped.get_available_actions()) for one in (env, theirs))
        assert ours == other and len(ours) > 1
