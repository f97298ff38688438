"""Our roads, rewards and endings against highway-env's own, on states of highway-env; and the exit on SUMO."""

from contextlib import closing
from dataclasses import replace
from itertools import product
from random import Random
from typing import Any

import numpy as np
import pytest

from experiments.backends.highway_env import ScenarioEnv
from sumo_env.env import DrivingEnv
from sumo_env.traffic.risk import RiskEvent
from tests.sumo_env import situations
from tests.sumo_env.parity import ego_state, make, scatter
from tests.sumo_env.rollout import drive
from tests.tasks import OF_HIGHWAY_ENV, every_task, highway_env_task

OFF = {"offroad_terminal": True}
WEIGHTS: dict[str, dict[str, Any]] = {
    "highway": {"right_lane_reward": 0.3, "reward_speed_range": [15, 28], "lanes_count": 3, **OFF},
    "two-way": {"left_lane_reward": 0.5, "high_speed_reward": 0.3},
    "roundabout": {"lane_change_reward": -0.2, "high_speed_reward": 0.5},
    "intersection": {"collision_reward": -2, "arrived_reward": 3, **OFF},
    "u-turn": {"left_lane_reward": 0.4, "collision_reward": -3},
    "merge": {"merging_speed_reward": -0.7, "reward_speed_range": [18, 27]},
    "exit": {"goal_reward": 0.6, "right_lane_reward": 0.2, "collision_reward": -2, "lanes_count": 4},
}


def assert_same_judgement(env: ScenarioEnv, action: int) -> dict[str, bool]:
    """Of the present state, as at the end of a step; returns what highway-env says of it."""
    env.steps, env.scene = 1, env._scene()  # at a reset there is no action
    info, state, task = env._info(np.empty(0), action), ego_state(env, action), env.task
    rewards = task.rewards(state, env.config)
    assert rewards == pytest.approx({k: float(v) for k, v in env._rewards(action).items()}, abs=1e-9)
    assert task.reward(rewards, env.config) == pytest.approx(float(env._reward(action)), abs=1e-9)
    assert task.terminated(state, env.config) == bool(env._is_terminated())
    assert task.arrived(state) == info["arrived"]
    assert state.on_road == info["on_road"]
    return {name: info[name] for name in ("on_road", "crashed", "arrived")}


@pytest.mark.parametrize("changed", ["nothing", "weights", "ladder"])
@highway_env_task
def test_equal_in_random_states(task: str, changed: str) -> None:
    weights = WEIGHTS[task]
    ladder = {"type": "DiscreteMetaAction", "target_speeds": [5, 10, 15, 20, 25]}
    chosen = {
        "nothing": {},
        "weights": {**weights, "normalize_reward": True},
        "ladder": {**weights, "normalize_reward": False, "action": ladder},
    }
    env = make(task, **chosen[changed])
    env.reset(seed=1)
    env.road.vehicles = [env.vehicle]
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(100):
        scatter(env, rng)
        if task == "two-way" and env.vehicle.lane_index[0] == "b":
            continue  # highway-env divides by zero when the ego has turned round
        if env.vehicle.lane_index == ("b", "c", 2):
            continue  # nobody may change to it, and the ego does not begin there
        seen |= {*assert_same_judgement(env, int(rng.integers(env.action_space.n))).items()}
    assert len(seen) == (6 if task in ("intersection", "exit", "merge") else 5)  # where one arrives


COUNTS = "vehicles_count", "initial_vehicle_count", "oncoming_vehicles_count", "spawn_probability"


def configuration(task: str, rng: Random) -> dict[str, Any]:
    """A random one, without traffic."""
    policy = rng.choice([1, 2, 5])
    config: dict[str, Any] = {
        "policy_frequency": policy,
        "simulation_frequency": policy * rng.choice([5, 10]) if policy < 5 else rng.choice([5, 10, 15, 20]),
        "duration": rng.uniform(5.0, 40.0),
        "risk": rng.choice([0.0, 1.0]),
    }
    if task == "highway":
        config |= {"lanes_count": rng.randint(1, 6)}
    if task == "two-way":
        config |= {"road_length": rng.uniform(100.0, 1500.0)}
    known = DrivingEnv(task).config
    return config | {key: 0 for key in COUNTS if key in known}


@every_task
def test_the_lateral_coordinate_stays(task: str) -> None:
    for seed in range(8):
        config = configuration(task, Random(seed))
        with closing(DrivingEnv(task, config)) as env:
            env.reset(seed=seed)
            (start, end, place), y = env.ego_state.target_lane, env.scene.y[0]
            for *_, terminated, _, info in drive(env, 1):
                where = config, env.scene.time
                if terminated:
                    # at the intersection one car always crosses; a task of our own may have others
                    own = task == "intersection" or task not in OF_HIGHWAY_ENV
                    assert not info["crashed"] or own, where
                    break
                assert abs(env.sumo.vehicle.getLateralLanePosition("ego")) < 0.1, where
                if task in ("highway", "two-way"):  # in and after bends its middle is beside the lane
                    assert env.scene.y[0] == pytest.approx(y, abs=0.1), where
                target = env.ego_state.target_lane
                assert target[:2] != (start, end) or target[2] == place, where
                start, end, place = target


def test_the_two_way_road_goes_on_at_its_end() -> None:
    """Also lane changes there; until then nothing is other than on a longer road."""
    left, idle, right = 0, 1, 2
    driven = []
    for length in (300.0, 800.0):
        config = {"road_length": length, "duration": 30, "vehicles_count": 0, "oncoming_vehicles_count": 0}
        with closing(DrivingEnv("two-way", config)) as env:
            env.reset(seed=0)
            places = [(env.scene.x[0], env.scene.y[0], 0.0)]
            for result in drive(env, [idle] * 12 + [left] + [idle] * 3 + [right] + [idle] * 5):
                places.append((env.scene.x[0], env.scene.y[0], result[1]))
            driven.append(np.array(places))
    assert driven[0][:, 0].max() > 500.0
    np.testing.assert_array_equal(driven[0], driven[1])
    assert driven[0][:13, 1] == pytest.approx(4.0) and driven[0][16, 1] == pytest.approx(0.0, abs=0.1)
    assert driven[0][-1, 1] == pytest.approx(4.0, abs=0.1)


# -- the exit on SUMO ------------------------------------------------------------------------------------------------

LEFT, IDLE, RIGHT = 0, 1, 2
HOURS = 60  # [s] far beyond the exit at any speed


def placed(env: DrivingEnv, number: int, x: float, speed: float) -> Any:
    """A scenario in which the ego alone drives in a lane beside the exit."""
    env.reset(seed=0)
    lane: dict[str, Any] = {"lane": ("1", "2", number), "s": x - 400.0, "x": x, "y": 4.0 * number}
    ego = env.scenario.ego._replace(**lane, speed=speed, target_speed=speed)
    return replace(env.scenario, ego=ego, vehicles=(), events=())


@pytest.mark.parametrize("frequency", [5, 15])
def test_a_change_that_begins_anywhere_leads_where_the_ego_steers_for(frequency: int) -> None:
    """To the exit or past it, and the goal is paid for as it is; SUMO has broken down where lanes parted meanwhile."""
    ways = set()
    with closing(DrivingEnv("exit", {"simulation_frequency": frequency})) as env:
        cases = product(np.arange(476.0, 497.0, 1.0), env.target_speeds, ((5, RIGHT), (6, LEFT)))
        for x, speed, (number, action) in cases:
            env.reset(seed=0, options={"scenario": placed(env, number, float(x), speed)})
            for step in range(2):
                _, _, terminated, _, info = env.step(action if step == 0 else IDLE)
                has_left = env.ego_state.lane == ("2", "exit", 0)
                assert not terminated
                if env.scene.x[0] > 505.0:
                    assert info["is_success"] == info["arrived"] == has_left, (x, speed)
            assert env.scene.x[0] > 505.0
            ways.add((action, has_left))
    assert len(ways) == 4  # begun in time, and too late


@pytest.mark.parametrize("direction", [1, -1])
def test_a_cut_in_goes_to_no_lane_that_leads_elsewhere_and_makes_nobody_faster(direction: int) -> None:
    with closing(DrivingEnv("exit")) as env:
        scenario = placed(env, 0, 402.0, 18.0)
        car = situations.placed(env.scenario, 0, ("1", "2", 5), 20.0, 9.0)
        event = RiskEvent(0.0, car.id, "cut-in", direction=direction)
        env.reset(seed=0, options={"scenario": replace(scenario, vehicles=(car,), events=(event,))})
        for _ in range(4):
            env.step(IDLE)
        assert env.scene.y[1] == pytest.approx(16.0, abs=0.1)
        assert env.scene.speed[1] == pytest.approx(9.0, abs=0.1)  # its lane's limit is 12.4 m/s


def test_the_others_drive_at_the_limits_of_their_lanes_past_the_exit() -> None:
    with closing(DrivingEnv("exit", {"duration": HOURS, "vehicles_count": 12})) as env:
        env.reset(seed=1)
        for _ in range(HOURS):
            env.step(IDLE)
        scene, limits = env.scene, [26.0 - 3.4 * number for number in range(6)]
        assert len(scene) == 13 and (scene.x > 500.0).all()
        for row in range(1, 13):
            number = round(scene.y.item(row) / 4.0)
            assert scene.y[row] == pytest.approx(4.0 * number, abs=0.01)
            assert scene.speed[row] <= limits[number] + 1e-6


def test_lanes_abreast_are_those_of_the_road_that_the_ego_steers_for() -> None:
    with closing(DrivingEnv("exit", {"simulation_frequency": 15, "policy_frequency": 15})) as env:
        env.reset(seed=0, options={"scenario": placed(env, 3, 496.0, 18.0)})
        states = [env.ego_state for _ in drive(env, [IDLE] * 5)]
        counts = [env.task.road(env.config).count(*state.target_lane[:2]) for state in states]
    assert any(state.lane[:2] != state.target_lane[:2] for state in states)
    assert [state.lanes_abreast for state in states] == counts
