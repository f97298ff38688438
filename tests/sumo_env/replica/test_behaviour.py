"""What highway-env's own tests ask of its types of action, of its vehicle and of several learning cars.

Asked of `replica/*` by the ids alone (highway-env's tests/envs/test_actions.py, test_env_preprocessors.py, test_gym.py,
test_observations.py, test_pettingzoo.py, tests/vehicle/test_dynamics.py and tests/graphics/test_render.py).
"""

from __future__ import annotations

import copy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import sumo_env

pytest.importorskip("pettingzoo")
from pettingzoo.test import parallel_api_test

IDS = [*sumo_env.REPLICA_IDS, sumo_env.FAST_ID, *sumo_env.LATER_IDS]
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


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("action", ACTIONS, ids=str)
def test_every_type_of_action_can_be_configured_after_the_environment_was_made(id: str, action: Any) -> None:
    env = made(id).unwrapped
    observation = {"observation": {"type": "Kinematics"}}  # the default of some has target speeds
    env.configure({"action": action, **observation})
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(3):
        chosen = env.action_space.sample()
        observed, reward, *_ = env.step(chosen)
        assert env.action_space.contains(chosen) and env.observation_space.contains(observed)
        assert np.isfinite(reward)


@pytest.mark.parametrize("id", IDS)
def test_an_episode_of_drawn_actions_stays_within_the_spaces(id: str) -> None:
    env = made(id)
    observed, _ = env.reset(seed=0)
    assert env.observation_space.contains(observed)
    env.action_space.seed(0)
    is_over = False
    while not is_over:
        observed, _, terminated, truncated, info = env.step(env.action_space.sample())
        assert env.observation_space.contains(observed)
        assert isinstance(info, dict)
        is_over = terminated or truncated


def test_a_grid_may_have_more_than_255_cells_along_an_axis() -> None:
    grid = {"type": "OccupancyGrid", "grid_size": [[-300, 300], [-10, 10]], "grid_step": [2, 2]}
    env = made("replica/highway-v0", config={"observation": grid})
    assert env.reset(seed=0)[0].shape == env.observation_space.shape == (4, 300, 10)


@pytest.mark.parametrize("action", ACTIONS, ids=str)
def test_a_picture_has_the_size_of_the_configuration(action: Any) -> None:
    env = made("replica/highway-v0", render_mode="rgb_array").unwrapped
    env.configure({"offscreen_rendering": True, "action": action})
    env.reset(seed=0)
    assert env.render().shape == (env.config["screen_height"], env.config["screen_width"], 3)


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


@pytest.mark.parametrize("dynamical", [False, True])
def test_the_pedals_change_the_speed_and_the_wheel_the_way(dynamical: bool) -> None:
    env = alone(dynamical=dynamical, acceleration_range=[-5, 5])
    y = env.vehicle.position[1]
    env.step([0.2, 0.0])
    assert env.vehicle.speed == pytest.approx(26.0) and env.vehicle.position[1] == pytest.approx(y)
    env.step([0.0, 0.1])
    assert env.vehicle.speed == pytest.approx(26.0) and env.vehicle.position[1] > y


def test_a_car_brakes_until_it_stands() -> None:
    env = alone(acceleration_range=[-6, 6], speed_range=[0, 30])
    for _ in range(15):
        env.step([max(-1.0, -env.vehicle.speed / 6), 0.0])
    assert env.vehicle.speed == pytest.approx(0.0, abs=0.01)


# -- several learning cars -----------------------------------------------------------------------------------------


@pytest.fixture(params=["v0", "v1", "v2"])
def crossing(request: Any) -> Any:
    """Of 1.12.1: the intersection, the same with steering, and with connected lanes."""
    config: dict[str, Any] = dict(SHORT)
    return sumo_env.parallel_env(f"replica/intersection-{request.param}", config)


def drawn(env: Any) -> dict[str, Any]:
    return {agent: env.action_space(agent).sample() for agent in env.agents}


def test_petting_zoo_accepts_all_versions_of_the_intersection(crossing: Any) -> None:
    parallel_api_test(crossing, num_cycles=10)


@pytest.mark.parametrize("seed", range(3))
def test_an_episode_of_agents(crossing: Any, seed: int) -> None:
    """Dictionaries by agents, spaces, who leaves, and that all have left at the end."""
    observations, infos = crossing.reset(seed=seed)
    everybody = copy.copy(crossing.possible_agents)
    assert list(observations) == list(infos) == everybody == ["car_0", "car_1"]
    for _ in range(50):
        acting = set(crossing.agents)
        observations, rewards, terminations, truncations, infos = crossing.step(drawn(crossing))
        for answer in (observations, rewards, terminations, truncations, infos):
            assert answer.keys() == acting
        for agent, observed in observations.items():
            assert crossing.observation_space(agent).contains(observed)
        assert set(crossing.agents) == {
            agent for agent in acting if not (terminations[agent] or truncations[agent])
        }
        if not crossing.agents:
            break
    assert crossing.agents == [] and crossing.possible_agents == everybody


def test_agents_of_a_seed_see_the_same_twice(crossing: Any) -> None:
    first, again = crossing.reset(seed=99)[0], crossing.reset(seed=99)[0]
    for agent in first:
        np.testing.assert_array_equal(first[agent], again[agent])


@pytest.mark.parametrize("action", ACTIONS, ids=str)
def test_tuples_of_every_type_of_action(action: Any) -> None:
    config = {**TUPLES, "action": {"type": "MultiAgentAction", "action_config": action}}
    for id in ("replica/highway-v0", "replica/intersection-v0"):
        env = made(id, config=config)
        env.action_space.seed(0)
        observed, _ = env.reset(seed=0)
        for _ in range(2):
            assert env.observation_space.contains(observed)
            observed, reward, *_ = env.step(env.action_space.sample())
            assert np.isfinite(reward)


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
