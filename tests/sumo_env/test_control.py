"""What the agent controls on SUMO, and what SUMO drives in its place."""

from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from sumo_env.env import DrivingEnv
from sumo_env.scenarios import HandOver, SumoDrivingEnv
from sumo_env.scene import MAX_SPEED
from tests.sumo_env.plans import QUIET, SUMO_DRIVES, build
from tests.sumo_env.rollout import drive
from tests.tasks import every_task

TYPES = ("DiscreteMetaAction", "ContinuousAction", "DiscreteAction")
AXES = (True, False, "sumo")
WAYS = [way for way in product(AXES, AXES) if any(way)]
COMMANDED, SUMO_S = 32, 31  # SUMO's speed modes; likewise 0 and 1621 for lane changes
LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)
# 300 m with two lanes, of which the left one alone leads on to 300 m more
NODES, EDGES = "a 0 0, b 300 0, c 600 0, d 500 -200", "ab a b 2 20, bc b c 1 20, bd b d 1 10"
STRAIGHT = NODES, EDGES, "ab 1 bc 0, ab 0 bd 0"


@pytest.fixture(scope="module")
def net(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("straight"), STRAIGHT)


def straight(net: Path, seed: int = 0, **config: Any) -> SumoDrivingEnv:
    env = SumoDrivingEnv(net, [["ab", "bd"]], ["ab", "bc"], {**QUIET, "duration": 90, **config})
    env.reset(seed=seed)
    return env


def size(way: tuple[Any, Any]) -> int:
    return sum(axis is True for axis in way)


# -- who drives ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", TYPES)
def test_what_the_agent_does_not_control_sumo_drives_in_all_combinations(kind: str) -> None:
    env = DrivingEnv("highway", {"vehicles_count": 5, "duration": 3})
    for way in WAYS:
        action = {"type": kind, "longitudinal": way[0], "lateral": way[1]}
        env.reset(seed=1, options={"config": {"action": action}})
        space = env.action_space
        if size(way) == 0:
            assert space == gym.spaces.Discrete(1)
        elif kind == "ContinuousAction":
            assert space.shape == (size(way),)
        else:
            meta = 5 if size(way) == 2 else 3
            assert space == gym.spaces.Discrete(meta if kind == "DiscreteMetaAction" else 3 ** size(way))
        lane = env.ego_state.target_lane
        for _ in range(3):
            env.step(space.sample())
            assert env.observation_space.contains(env._observe())
        modes = env.sumo.vehicle.getSpeedMode("ego"), env.sumo.vehicle.getLaneChangeMode("ego")
        assert modes == (SUMO_S if way[0] == "sumo" else COMMANDED, 1621 if way[1] == "sumo" else 0)
        if way[1] is False:
            assert env.ego_state.target_lane == lane
        if way[0] is False and kind != "DiscreteMetaAction":
            assert env.scene.speed[0] == 25.0


@pytest.mark.parametrize("risk", [0.0, 1.0])
@every_task
def test_on_the_five_tasks_sumo_s_driver_is_the_regular_one_whatever_the_risk(task: str, risk: float) -> None:
    env = DrivingEnv(task, {"action": SUMO_DRIVES, "risk": risk})
    env.reset(seed=3)
    regular, vehicle = env.task.car_following, env.sumo.vehicle
    seen = vehicle.getAccel("ego"), vehicle.getDecel("ego"), vehicle.getTau("ego"), vehicle.getMinGap("ego")
    expected = regular.accel, regular.decel, regular.tau * env.task.calibration.tau, regular.min_gap
    assert seen == pytest.approx(expected, abs=1e-5)
    before = env.scene.speed[0]
    *_, info = env.step(0)
    assert info["distance"] == pytest.approx((before + info["speed"]) / 2, abs=1.5)


def test_sumo_changes_lanes_for_an_agent_that_has_the_pedals(net: Path) -> None:
    """Only the left lane leads on: SUMO finds it, and an agent that keeps to the right misses the turn."""
    pedals = {"type": "ContinuousAction"}
    for lateral, numbers, ended in (("sumo", [0.2], "arrived"), (True, [0.2, 1.0], "missed turn")):
        env = straight(net, action={**pedals, "lateral": lateral}, initial_speed=5)
        env.sumo.vehicle.moveTo("ego", "ab_0", 20.0)
        while not env.step(np.array(numbers, np.float32))[2]:
            pass
        assert env.scene.place.ended == ended
        env.close()


def test_sumo_has_the_pedals_for_an_agent_that_changes_lanes() -> None:
    """It keeps its distance, where an ego that holds its speed runs into the next car."""
    crashed = []
    for longitudinal in ("sumo", False):
        action = {**SUMO_DRIVES, "longitudinal": longitudinal, "lateral": True}
        env = DrivingEnv("highway", {"action": action})
        *_, (*_, info) = drive(env, IDLE, seed=1)
        crashed.append(info["crashed"])
        env.close()
    assert crashed == [False, True]


# -- a commanded acceleration --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("policy", "simulation"), [(1, 10), (2, 10), (3, 15), (5, 10), (10, 10), (15, 15)])
@pytest.mark.parametrize("kind", ["highway", "network"])
def test_a_commanded_acceleration_is_reached(net: Path, kind: str, policy: int, simulation: int) -> None:
    """On average over each policy step, within 5 %; on a network within the limits of the type, here 3 and 5."""
    config: dict[str, Any] = {
        "action": {"type": "ContinuousAction", "lateral": "sumo", "acceleration_range": [-10, 10]},
        **{"policy_frequency": policy, "simulation_frequency": simulation, "vehicles_count": 0},
    }
    env = straight(net, initial_speed=10, **config) if kind == "network" else DrivingEnv("highway", config)
    _, info = env.reset(seed=0)
    top = 40.0 if kind == "highway" else 20.0
    tried = 0
    for wanted in (0.5, 2.5, -1.0, -3.0, 2.0, 0.0, -4.4, 9.0, -9.0):
        if not 0.0 < info["speed"] + wanted / policy < top:
            continue
        before = info["speed"]
        *_, info = env.step(np.array([wanted / 10], np.float32))
        possible = wanted if kind == "highway" else min(max(wanted, -5.0), 3.0)
        assert (info["speed"] - before) * policy == pytest.approx(possible, rel=0.05, abs=1e-6)
        tried += 1
    assert tried >= 6


def test_speeds_end_at_the_range_s_ends_and_never_below_zero() -> None:
    config = {"action": {"type": "ContinuousAction", "speed_range": [-5, 30]}, "vehicles_count": 0}
    env = DrivingEnv("highway", config)
    env.reset(seed=0)
    speeds = [env.step(np.array([a, 0.0], np.float32))[4]["speed"] for a in (1.0,) * 3 + (-1.0,) * 8]
    assert speeds[:3] == [30.0, 30.0, 30.0] and speeds[-1] == 0.0 and min(speeds) == 0.0
    env.reset(seed=0, options={"config": {"action": {"type": "ContinuousAction"}}})
    assert [env.step(np.array([1.0, 0.0], np.float32))[4]["speed"] for _ in range(4)][-1] == MAX_SPEED


def test_the_lateral_number_changes_lanes() -> None:
    env = DrivingEnv("highway", {"action": {"type": "ContinuousAction"}, "vehicles_count": 0})
    env.reset(seed=0)
    lanes = [env.ego_state.lane[2]]
    for turn in (0.3, 0.5, 1.0, -0.3, -0.4, -1.0):
        env.step(np.array([0.0, turn], np.float32))
        lanes.append(env.ego_state.lane[2])
    assert np.diff(np.clip(lanes, 0, 3)).tolist() == [0, 1, 1, 0, -1, -1] or lanes[0] > 1
    assert env.ego_state.action == (0.0, -1.0)
    grid = DrivingEnv("highway", {"action": {"type": "DiscreteAction"}, "vehicles_count": 0})
    grid.reset(seed=0)
    for number, change, rise in ((2, 1, -5), (0, -1, -5), (7, 0, 5)):
        before = grid.ego_state
        grid.step(number)
        assert grid.ego_state.lane[2] - before.lane[2] == change
        assert grid.ego_state.speed - before.speed == pytest.approx(rise)


# -- hand-over -----------------------------------------------------------------------------------------------------

HOLD = np.array([0.0, 0.0], np.float32)


@every_task
def test_a_hand_over_jumps_neither_in_speed_nor_in_lane(task: str) -> None:
    config = {"action": {"type": "ContinuousAction"}, "policy_frequency": 10}
    env = DrivingEnv(task, config)
    hardest = 1.1 * env.task.car_following.emergency_decel  # in a bend a metre of SUMO's lane is up to 1.1 m
    for seed in range(2):
        env.reset(seed=seed)
        for step in range(40):
            env.hand_over(step % 20 >= 10)
            before = env.scene
            *_, over, late, _ = env.step(HOLD)
            if over or late:
                break
            change = env.scene.speed[0] - before.speed[0]
            assert (-hardest * 0.1 <= change <= 0.66) if step % 20 >= 10 else change == 0.0
            moved = np.hypot(env.scene.x[0] - before.x[0], env.scene.y[0] - before.y[0])
            # no lane is jumped over, and SUMO's end of a lane change is continued: 0.5 m sideways in a step
            assert moved <= np.hypot(before.speed[0] * 0.1 + 0.1, 0.6)


def test_a_lane_change_that_sumo_has_begun_ends_where_sumo_was_going() -> None:
    env = DrivingEnv("highway", {"policy_frequency": 10, "vehicles_count": 20, "vehicles_density": 1.5})
    for seed in (4, 7, 8, 10):
        env.reset(seed=seed)
        env.hand_over()
        y = env.scene.y[0]
        while abs(env.scene.y[0] - y) < 0.4:  # a change has begun, and the index has not flipped
            env.step(IDLE)
        side = np.sign(env.scene.y[0] - y)
        env.hand_over(False)
        for _ in range(12):
            env.step(IDLE)
        assert env.scene.y[0] == pytest.approx(y + 4.0 * side, abs=0.1)


def test_sumo_brings_the_ego_back_from_the_lane_of_oncoming_traffic() -> None:
    """As soon as nobody has to brake hard for it; it drives on without a crash."""
    env = DrivingEnv("two-way", {"duration": 20})
    for seed in range(10):
        env.reset(seed=seed)
        env.step(IDLE)
        env.step(LEFT)
        assert env.scene.y[0] < 1.0
        env.hand_over()
        *_, (*_, info) = drive(env, IDLE)
        assert info["ending"] == "time" and env.scene.y[0] == pytest.approx(4.0, abs=0.1)


def test_a_wrapper_hands_over_by_a_rule_and_reset_takes_back(net: Path) -> None:
    env = HandOver(straight(net), lambda env: env.scene.place.lane[0] == "ab:from")
    inner: Any = env.unwrapped
    env.reset(seed=0)
    driven = {True: 0, False: 0}
    over = False
    while not over:
        is_sumo_s = env.where(inner)
        over = env.step(IDLE)[2]
        if not over:
            assert inner.sumo.vehicle.getSpeedMode("ego") == (SUMO_S if is_sumo_s else COMMANDED)
            driven[is_sumo_s] += 1
    assert min(driven.values()) > 3 and inner.scene.place.ended == "arrived"
    inner.hand_over()
    env.reset(seed=0)
    inner.step(IDLE)
    assert inner.sumo.vehicle.getSpeedMode("ego") == COMMANDED
