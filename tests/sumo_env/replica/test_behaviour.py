"""What highway-env's own tests ask of its types of action, of its vehicle and of several learning cars.

Asked of `replica/*` by the ids alone (highway-env's tests/envs/test_actions.py, test_env_preprocessors.py, test_gym.py,
test_observations.py, test_pettingzoo.py, tests/vehicle/test_dynamics.py and tests/graphics/test_render.py).
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import sumo_env

pytest.importorskip("pettingzoo")
from pettingzoo.test import parallel_api_test

ACTIONS: list[Any] = [{"type": kind} for kind in ("ContinuousAction", "DiscreteAction", "DiscreteMetaAction")]
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


@pytest.mark.parametrize("action", ACTIONS, ids=str)
def test_every_type_of_action_can_be_configured_after_the_environment_was_made(action: Any) -> None:
    env = made("replica/highway-v0", render_mode="rgb_array").unwrapped
    env.configure({"offscreen_rendering": True, "action": action})
    env.reset(seed=0)
    chosen = env.action_space.sample()
    observed, reward, *_ = env.step(chosen)
    assert env.observation_space.contains(observed) and np.isfinite(reward)
    assert env.render().shape == (env.config["screen_height"], env.config["screen_width"], 3)


def test_a_grid_may_have_more_than_255_cells_along_an_axis() -> None:
    grid = {"type": "OccupancyGrid", "grid_size": [[-300, 300], [-10, 10]], "grid_step": [2, 2]}
    env = made("replica/highway-v0", config={"observation": grid})
    assert env.reset(seed=0)[0].shape == env.observation_space.shape == (4, 300, 10)


# -- the vehicle ---------------------------------------------------------------------------------------------------


def alone(**action: Any) -> Any:
    """A steered car on a road of its own, at 15 Hz and one action a second."""
    config = {"vehicles_count": 0, "action": {"type": "ContinuousAction", **action}, "duration": 100}
    env = made("replica/highway-v0", config=config).unwrapped
    env.reset(seed=0)
    return env


@pytest.mark.parametrize("dynamical", [False, True])
def test_without_pedals_and_wheel_it_goes_straight_on(dynamical: bool) -> None:
    env = alone(dynamical=dynamical)
    x, y = env.vehicle.position
    env.step([0.0, 0.0])
    env.step([0.0, 0.0])
    assert env.vehicle.position == pytest.approx([x + 2 * 25.0, y])
    assert (env.vehicle.speed, env.vehicle.heading) == pytest.approx((25.0, 0.0))


def test_a_car_brakes_until_it_stands() -> None:
    env = alone(acceleration_range=[-6, 6], speed_range=[0, 30])
    for _ in range(15):
        env.step([max(-1.0, -env.vehicle.speed / 6), 0.0])
    assert env.vehicle.speed == pytest.approx(0.0, abs=0.01)


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
