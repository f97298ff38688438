"""A seed is the same episode in highway-env, unpatched, and in the environments replica/*."""

import re
import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import sumo_env
from sumo_env.config import ConfigError
from tests.processes import ROOT, ended
from tests.tasks import highway_env_task

from .pairs import Case, cases, compare, different

EACH = 200  # episodes of each task in the long comparison
TABLE = {"type": "Kinematics"}
SHUFFLED, BEHIND = {**TABLE, "order": "shuffled"}, {**TABLE, "see_behind": True}
EXIT = {"type": "ExitObservation", "order": "shuffled", "vehicles_count": 4, "see_behind": True}
LADDER = {"type": "DiscreteMetaAction", "target_speeds": [4, 12, 20]}
CONFIGS: dict[str, list[dict[str, Any]]] = {
    "highway": [
        {"lanes_count": 3, "vehicles_count": 12, "vehicles_density": 2, "initial_lane_id": 1},
        {"vehicles_count": 8, "duration": 2, "policy_frequency": 5, "observation": SHUFFLED},
    ],
    "two-way": [{"observation": TABLE, "neighbour_vehicles_connected_lanes": True}],
    "roundabout": [
        {"neighbour_vehicles_connected_lanes": True, "incoming_vehicle_destination": 1},
        {"simulation_frequency": 10, "policy_frequency": 2, "normalize_reward": False},
    ],
    "intersection": [
        {"neighbour_vehicles_connected_lanes": True, "destination": None},
        {"initial_vehicle_count": 20, "spawn_probability": 1.0, "normalize_reward": True},
        {"observation": {**SHUFFLED, "vehicles_count": 6, "see_behind": True}},
    ],
    "u-turn": [
        {"observation": {**TABLE, "absolute": True, "normalize": False}},
        {"neighbour_vehicles_connected_lanes": True, "action": LADDER},
    ],
    "merge": [
        {"neighbour_vehicles_connected_lanes": True, "action": LADDER, "observation": BEHIND},
        {"observation": {**BEHIND, "include_obstacles": False}, "merging_speed_reward": -2},
    ],
    "exit": [
        {"lanes_count": 3, "neighbour_vehicles_connected_lanes": True, "right_lane_reward": 0.3},
        {"lanes_count": 2, "normalize_reward": False, "duration": 25, "observation": EXIT},
    ],
}


def pair(task: str, config: dict[str, Any]) -> tuple[Any, Any]:
    """highway-env's environment and the replica's; those with connected lanes are v1 or, of the intersection, v2."""
    stock, replica = (gym.make(f"{room}{task}-v0", config=dict(config)) for room in ("", "replica/"))
    return stock, replica


@pytest.mark.slow
@highway_env_task
def test_a_seed_is_the_episode_of_highway_env(task: str) -> None:
    """By default, and under other configurations; every second episode goes on with the stream of the one before."""
    assert different(*pair(task, {}), (1,) if task == "highway" else (1, 2)) == []
    for config in CONFIGS[task]:
        assert different(*pair(task, config), (31,)) == [], config


@pytest.mark.long
@highway_env_task
def test_it_is_in_99_percent_of_two_hundred_episodes(task: str) -> None:
    found = different(*pair(task, {}), range(1000, 1000 + EACH))
    print(f"{task}: {EACH - len(found)} of {EACH} episodes the same", *found, sep="\n")
    assert len(found) <= 0.01 * EACH


# -- the environments -----------------------------------------------------------------------------------------------


def test_the_defaults_are_those_of_highway_env() -> None:
    for id in (*sumo_env.REPLICA_IDS, sumo_env.FAST_ID, *sumo_env.LATER_IDS):
        theirs: Any = gym.make(id.removeprefix("replica/")).unwrapped
        ours: Any = gym.make(id).unwrapped
        meaningless = {"other_vehicles_type", "render_agent", "offscreen_rendering", "manual_control",
                       "real_time_rendering", "controlled_vehicles", "show_trajectories"}  # fmt: skip
        assert theirs.config.keys() - ours.config.keys() <= meaningless
        for key in theirs.config.keys() & ours.config.keys():
            if key in ("observation", "action"):
                shared = theirs.config[key].keys() & ours.config[key].keys()
                assert {k: theirs.config[key][k] for k in shared} == {k: ours.config[key][k] for k in shared}
            # 789 by 289 pixels of the u-turn are odd, which films cannot be
            elif not key.startswith("screen"):
                assert theirs.config[key] == ours.config[key], (id, key)
        assert theirs.observation_space == ours.observation_space
        assert theirs.action_space == ours.action_space
        gym.make(f"sumo_env:{id}", config=theirs.config).reset(seed=0)  # the whole configuration is accepted


@pytest.mark.parametrize(("version", "action"), [(0, 0), (1, [0.2, 0.1])])
def test_a_driven_episode_is_a_scenario_that_can_be_driven_again(version: int, action: Any) -> None:
    envs: list[Any] = [gym.make(gym.spec(f"replica/intersection-v{version}")).unwrapped for _ in range(2)]
    env, again = envs
    env.reset(seed=3)
    seen = [env.step(action)[0] for _ in range(8)]
    assert any(spawn.step for spawn in env.scenario.spawns)  # vehicles arrived
    again.reset(seed=0, options={"scenario": env.scenario})
    for observation in seen:
        np.testing.assert_array_equal(again.step(action)[0], observation)


def test_scenarios_with_further_events_are_refused() -> None:
    """Seeded scenarios are those of SUMO: tests/sumo_env/test_determinism.py."""
    config = {"risk": 1.0}
    env: Any = gym.make("replica/u-turn-v0", scenarios="seeded", config=config).unwrapped
    sumo: Any = gym.make("sumo/u-turn-v0", config=config).unwrapped
    tilt = {"event_factor": 9.0, "event_reach": 50.0}
    sumo.reset(seed=1, options={**tilt, "config": {"simulation_frequency": 15}})
    for options in (tilt, {"scenario": sumo.scenario}):
        with pytest.raises(ConfigError, match="the replica"):
            env.reset(seed=1, options=options)


@pytest.mark.long
def test_compilation_is_announced_once_and_kept(tmp_path: Path) -> None:
    package = tmp_path / "sumo_env"
    shutil.copytree(ROOT / "sumo_env", package, ignore=shutil.ignore_patterns("__pycache__", "networks"))
    shutil.copytree(ROOT / "networks", package / "networks", ignore=shutil.ignore_patterns("__pycache__"))
    code = "import gymnasium as gym; gym.make('sumo_env:replica/u-turn-v0').reset(seed=0)"
    said = [ended("-c", code, cwd=tmp_path, PYTHONPATH=str(tmp_path)).stderr for _ in range(2)]
    assert re.search(r"once for this installation.*\nsumo_env: compiled in \d+ s", said[0])
    assert "compile" not in said[1]


def test_without_numba_the_error_says_what_to_install() -> None:
    code = "import sys; sys.modules['numba'] = None; import gymnasium as gym; gym.make('sumo_env:replica/highway-v0')"
    assert "pip install numba" in ended("-c", code).stderr.splitlines()[-1]


def unlike(chosen: list[Case]) -> dict[Case, str]:
    """The episodes that are not those of highway-env, and what differs first.

    Poses and speeds are within 1e-6 after every policy step, observations, rewards, endings and measures the same.
    """
    return {case: found for case in chosen if (found := compare(case))}


@pytest.mark.slow
@highway_env_task
def test_some_episodes_are_those_of_highway_env(task: str) -> None:
    """Also among linear drivers."""
    chosen = cases(task, 2, seed=1)
    if task == "highway":  # the highest levels take highway-env a minute each
        chosen = [case._replace(level="50") for case in chosen]
    else:
        linear = cases(task, 1, seed=2)
        chosen += [case._replace(law="linear", risk=0.5 + 0.5 * case.risk) for case in linear]
    assert unlike(chosen) == {}


@pytest.mark.long
@highway_env_task
def test_99_percent_of_a_thousand_episodes_are_those_of_highway_env(task: str) -> None:
    found = unlike(cases(task, EACH))
    print(f"{task}: {EACH - len(found)} of {EACH} episodes the same", *found.items(), sep="\n")
    assert len(found) <= 0.01 * EACH
