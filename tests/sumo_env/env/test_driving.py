"""The environments as gymnasium and as users of highway-env know them."""

import copy
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import libsumo
import numpy as np
import pytest
import stable_baselines3.common.env_checker
from gymnasium.utils.env_checker import check_env

import sumo_env
from sumo_env.config import ConfigError, ignore
from sumo_env.env import DrivingEnv
from sumo_env.spaces.info import ending
from sumo_env.tasks import TASKS
from sumo_env.tasks.highway import Highway
from tests.sumo_env.rollout import drive, leaves
from tests.tasks import highway_env_task

# highway-env's observation boxes are unbounded tables as well
EXPECTED_WARNINGS = ("minimum value is -infinity", "maximum value is infinity", "unconventional shape")


@pytest.fixture
def highway() -> Iterator[gym.Env[Any, Any]]:
    with closing(gym.make("sumo/highway-v0", config={"vehicles_count": 10})) as env:
        yield env


@pytest.mark.parametrize("id", [*sumo_env.IDS, *sumo_env.REPLICA_IDS])
def test_gymnasium_and_stable_baselines_have_nothing_to_object_to(id: str) -> None:
    """The first among risky drivers, as it asks whether a seed is one episode; the second among regular ones."""
    kind: dict[str, Any] = {"scenarios": "seeded"} if id.startswith("replica") else {}
    risky, regular = (gym.make(id, config={"risk": r}, disable_env_checker=True, **kind) for r in (1.0, 0.0))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        # pictures of each task: rendering/test_pictures.py
        check_env(risky.unwrapped, skip_render_check=not id.endswith("u-turn-v0"))
        risky.close()
        stable_baselines3.common.env_checker.check_env(regular)
    messages = [str(warning.message) for warning in caught]
    assert [text for text in messages if not any(known in text for known in EXPECTED_WARNINGS)] == []


# -- configuration -----------------------------------------------------------------------------------------


@highway_env_task
def test_sumo_never_drives_backwards(task: str) -> None:
    env = DrivingEnv(task)
    env.reset(seed=0)
    backwards = replace(env.scenario, ego=env.scenario.ego._replace(speed=-3.0))
    with pytest.raises(ConfigError, match=r"the ego at the start.* -3 m/s"):
        env.reset(options={"scenario": backwards})


def test_crowded_two_way_roads_are_filled() -> None:
    """No draw of so many places is free of overlaps by chance; the scenario is drawn all the same."""
    env = DrivingEnv("two-way", {"vehicles_count": 100})
    env.reset(seed=0)
    places = sorted(spec.s for spec in env.scenario.vehicles if spec.lane == ("a", "b", 1))
    assert len(places) == 100
    assert min(np.diff(places)) > 6.0


def test_reset_takes_risk_and_calibration_for_one_episode(highway: gym.Env[Any, Any]) -> None:
    env: Any = highway.unwrapped
    risky = {"config": {"risk": 1.0}}
    highway.reset(seed=0, options=risky)
    before = env.scenario
    rates = {"cut_in": 0.0, "brake": 0.9, "surge": 0.0}
    highway.reset(seed=0, options={**risky, "risk_rates": rates, "calibration": {"tau": 2.0}})
    changed = env.scenario
    assert {event.kind for event in changed.events} == {"brake"} != {event.kind for event in before.events}
    assert changed.specs == before.specs  # the same seed draws the same traffic
    name, driver = changed.vehicles[0].id, changed.vehicles[0].driver
    assert libsumo.vehicle.getTau(name) == pytest.approx(2.0 * driver.tau, abs=1e-6)
    highway.reset(seed=0, options={"risk_ranges": {"tau": np.array([0.1, 0.1])}})
    assert all(spec.driver.tau == pytest.approx(0.15) for spec in env.scenario.vehicles)
    highway.reset(seed=0)  # as it was
    assert env.scenario == before
    assert libsumo.vehicle.getTau(name) == pytest.approx(driver.tau, abs=1e-6)


OTHERS = {"policy_frequency": 5}, {"simulation_frequency": 20}, {"lanes_count": 2}


@pytest.mark.parametrize(("task", "config"), [("u-turn", {}), *(("highway", other) for other in OTHERS)])
def test_a_scenario_of_another_road_or_clock_is_refused(highway, task: str, config: dict[str, Any]) -> None:
    other = DrivingEnv(task, config)
    scenario = other.task.scenario(other.config, 0)
    with pytest.raises(ConfigError, match=r"options\['scenario'\] must be o"):
        highway.reset(options={"scenario": scenario})


@pytest.mark.parametrize("id", ["sumo/u-turn-v0", "replica/u-turn-v0"])
def test_a_step_after_the_end_warns_and_pays_nothing(id: str) -> None:
    env: Any = gym.make(id, config={"duration": 1, "policy_frequency": 2}).unwrapped
    env.reset(seed=0)
    assert [env.step(1)[1] > 0.0 for _ in range(2)] == [True, True]
    with pytest.warns(UserWarning, match="over"):
        _, reward, _, truncated, _ = env.step(1)
    assert reward == 0.0 and truncated
    env.reset(seed=0)
    assert env.step(1)[1] > 0.0


def test_a_frequency_that_nobody_asked_for_goes_back(highway: gym.Env[Any, Any]) -> None:
    env: Any = highway.unwrapped
    seen = []
    for policy in (15, 5, 12, 1):
        env.configure({"policy_frequency": policy})
        seen.append(env.config["simulation_frequency"])
    env.configure({"simulation_frequency": 15})
    env.configure({"policy_frequency": 2})
    assert [*seen, env.config["simulation_frequency"]] == [15, 10, 15, 10, 15]


@pytest.mark.parametrize("id", ["sumo/highway-v0", "replica/highway-v0"])
def test_a_running_episode_keeps_its_configuration(id: str) -> None:
    """Also where several changes are asked for, of which a wrong one changes nothing."""
    with closing(gym.make(id, config={"duration": 4, "vehicles_count": 5})) as env:
        inner: Any = env.unwrapped
        shapes = [env.reset(seed=0)[0].shape]
        inner.configure({"duration": 2, "collision_reward": 9})
        inner.configure({"observation": {"type": "Kinematics", "vehicles_count": 3}})
        wrong = {"duration": -1, "action": {"type": "ContinuousAction"}}
        with pytest.raises(ConfigError):
            inner.configure(wrong)
        driven = [len(list(drive(env)))]
        assert inner.config["duration"] == 4 and inner.observation_space.shape == shapes[0]
        with pytest.raises(ConfigError):
            env.reset(seed=0, options={"config": wrong})
        shapes.append(env.reset(seed=0, options={"config": {"collision_reward": -1}})[0].shape)
        driven.append(len(list(drive(env))))
        assert inner.config["collision_reward"] == -1 and inner.action_space == gym.spaces.Discrete(5)
    assert driven == [4, 2] and shapes == [(5, 5), (3, 5)]


def test_a_task_is_asked_once_a_step() -> None:
    """Beside its own `terminated`, which asks whether the ego has arrived."""
    task = Highway()
    with ExitStack() as stack:
        patches = [patch.object(task, name, wraps=getattr(task, name)) for name in ("rewards", "arrived")]
        asked = [stack.enter_context(one) for one in patches]
        env = stack.enter_context(closing(DrivingEnv(task, {"vehicles_count": 3})))
        env.reset(seed=0)
        list(drive(env, [1, 1, 1]))
    assert [one.call_count for one in asked] == [4, 4 + 3]


def test_the_configuration_may_be_written_to(highway: gym.Env[Any, Any]) -> None:
    """As highway-env's users do; it counts from the next reset."""
    env: Any = highway.unwrapped
    env.config["observation"]["vehicles_count"] = 7
    env.config["vehicles_count"] = 3
    observation, _ = highway.reset(seed=0)
    assert observation.shape == (7, 5)
    assert len(env.scenario.vehicles) == 3


def test_configurations_are_not_shared() -> None:
    mine = {"observation": {"type": "Kinematics", "vehicles_count": 6}}
    kept = copy.deepcopy(mine)
    defaults = copy.deepcopy({name: task.defaults for name, task in TASKS.items()})
    first = DrivingEnv("highway", mine)
    first.config["observation"]["vehicles_count"] = 9
    first.config["action"]["lateral"] = False
    assert mine == kept
    assert {name: task.defaults for name, task in TASKS.items()} == defaults
    assert DrivingEnv("highway").action_space == gym.spaces.Discrete(5)


# -- use ---------------------------------------------------------------------------------------------------


def test_an_episode_may_start_from_a_given_scenario() -> None:
    env = DrivingEnv("highway", {"vehicles_count": 10})
    env.reset(seed=0)
    other = env.task.scenario(env.config, 7)
    assert env.scenario != other
    observation, _ = env.reset(seed=0, options={"scenario": other})
    assert env.scenario is other
    assert env.scene.x[0] == pytest.approx(other.ego.x)
    np.testing.assert_array_equal(env.reset(seed=5, options={"scenario": other})[0], observation)
    env.reset(seed=0)
    assert env.scenario != other


def test_endings_of_other_kinds() -> None:
    env = DrivingEnv("highway", {"vehicles_count": 1})
    env.reset(seed=0)
    ego = env.ego_state
    assert ending(ego._replace(ended="missed turn"), False, True, False) == "missed turn"
    assert ending(ego, False, True, False) == "own rule"
    assert ending(ego._replace(on_road=False), False, True, True) == "off road"


def test_info_holds_plain_values(highway: gym.Env[Any, Any]) -> None:
    """The same keys and types always, at a crash too, so that libraries can merge and store them."""

    infos = []
    for seed in range(3):
        infos.append(highway.reset(seed=seed)[1])
        infos += [result[4] for result in drive(highway, 3)]
    assert all(bool(info["crash"]) == info["crashed"] for info in infos)  # a record, or an empty dictionary
    crashes = [info.pop("crash") for info in infos]
    kinds = [[(where, type(value)) for where, value in leaves(info)] for info in infos]
    assert all(kind == kinds[0] for kind in kinds)
    assert all(value == value for info in infos for _, value in leaves(info))  # which NaN is not
    assert {info["crashed"] for info in infos} == {True, False}
    for info, crash in zip(infos, crashes, strict=True):
        assert info["cost"] == float(info["crashed"])
        assert not crash or (crash["other"] and type(crash["time"]) is float)
        assert info["ending"] == ("crash" if info["crashed"] else "")
        assert not info["crashed"] or info["min_ttc"] == 0.0
    assert infos[0]["action"] == -1
    highway.reset(seed=0)
    *_, info = highway.step(1)
    assert info["distance"] == pytest.approx(info["speed"], rel=0.1)


def test_a_warning_may_have_a_percent_sign() -> None:
    """Gymnasium formats what it is given, and names of keys, vehicles and files may have one."""
    with pytest.warns(UserWarning, match="50%d"):
        ignore("50%d of the cases", "a key", "known: none")
