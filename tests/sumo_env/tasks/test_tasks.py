"""Our roads, rewards and endings against highway-env's own, on states of highway-env."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from experiments.backends.highway_env import ScenarioEnv
from sumo_env.tasks import TASKS
from sumo_env.tasks.intersection import _two_arms
from tests.sumo_env.parity import Step, ego_state, episodes, make, scatter, stock
from tests.tasks import highway_env_task

# Keys of highway-env whose default we have chosen otherwise (docs/environments).
OWN_CHOICE = {"two-way": {"observation"}, "u-turn": {"observation", "screen_width", "screen_height"}}
WEIGHTS: dict[str, dict[str, Any]] = {
    "highway": {
        "right_lane_reward": 0.3,
        "reward_speed_range": [15, 28],
        "lanes_count": 3,
        "offroad_terminal": True,
    },
    "two-way": {"left_lane_reward": 0.5, "high_speed_reward": 0.3},
    "roundabout": {"lane_change_reward": -0.2, "high_speed_reward": 0.5},
    "intersection": {"collision_reward": -2, "arrived_reward": 3, "offroad_terminal": True},
    "u-turn": {"left_lane_reward": 0.4, "collision_reward": -3},
    "merge": {"merging_speed_reward": -0.7, "reward_speed_range": [18, 27]},
}


LADDER = {"action": {"type": "DiscreteMetaAction", "target_speeds": [5, 10, 15, 20, 25]}}


@highway_env_task
def test_defaults_are_those_of_highway_env(task: str) -> None:
    theirs, own = stock(task).default_config(), TASKS[task].defaults
    for key in (own.keys() & theirs.keys()) - OWN_CHOICE.get(task, set()) - {"action"}:
        assert own[key] == theirs[key], key
    defaults = {"longitudinal": True, "lateral": True}
    assert {**defaults, **own["action"]} == {**defaults, **theirs["action"]}


def assert_same_judgement(step: Step) -> None:
    env, action = step.env, step.action
    state, task = ego_state(env, action), env.task
    rewards = task.rewards(state, env.config)
    assert rewards == pytest.approx({k: float(v) for k, v in env._rewards(action).items()}, abs=1e-9)
    assert task.reward(rewards, env.config) == pytest.approx(step.reward, abs=1e-9)
    assert task.terminated(state, env.config) == step.terminated
    assert task.arrived(state) == step.info["arrived"]
    assert state.on_road == step.info["on_road"]


@pytest.mark.parametrize("risk", [0.0, 1.0])
@highway_env_task
def test_equal_throughout_episodes(task: str, risk: float) -> None:
    ended = False
    env = make(task, risk=risk)
    for step in episodes(env, range(10, 16) if task != "highway" else range(10, 13)):
        if step.action is not None:
            assert_same_judgement(step)
            time = env.steps / env.config["simulation_frequency"]
            assert step.truncated == (time >= env.config["duration"])
            ended |= step.terminated
    assert ended  # at least one of them in a crash or an arrival


def judged(env: ScenarioEnv, action: int) -> Step:
    """The present state as highway-env would judge it at the end of a step."""
    env.steps, env.scene = 1, env._scene()  # at a reset there is no action
    info = env._info(np.empty(0), action)
    return Step(env, action, np.empty(0), float(env._reward(action)), bool(env._is_terminated()), False, info)


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("changed", ["nothing", "weights", "ladder"])
@highway_env_task
def test_equal_in_random_states(task: str, changed: str, normalize: bool) -> None:
    chosen = {"nothing": {}, "weights": dict(WEIGHTS[task]), "ladder": dict(LADDER)}[changed]
    if "normalize_reward" in TASKS[task].defaults:
        chosen["normalize_reward"] = normalize
    elif not normalize:
        pytest.skip("there is no such key")
    env = make(task, **chosen)
    env.reset(seed=1)
    env.road.vehicles = [env.vehicle]
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(400):
        scatter(env, rng)
        if task == "two-way" and env.vehicle.lane_index[0] == "b":
            continue  # highway-env divides by zero when the ego has turned round
        if env.vehicle.lane_index == ("b", "c", 2):
            continue  # nobody may change to it, and the ego does not begin there
        step = judged(env, int(rng.integers(env.action_space.n)))
        assert_same_judgement(step)
        seen |= {("on_road", step.info["on_road"]), ("crashed", step.info["crashed"])}
    assert len(seen) == 4


def test_the_arms_of_the_intersection_are_drawn_as_numpy_s_choice_does() -> None:
    own, numpy_s = np.random.default_rng(5), np.random.default_rng(5)
    for _ in range(1000):
        assert list(_two_arms(own)) == numpy_s.choice(4, size=2, replace=False).tolist()
        assert own.standard_normal() == numpy_s.standard_normal()
