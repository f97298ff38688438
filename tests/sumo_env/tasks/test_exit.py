"""The exit on SUMO: who takes it, and what the lanes' limits mean."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from sumo_env.config import ConfigError
from sumo_env.env import DrivingEnv
from sumo_env.traffic.risk import RiskEvent
from tests.sumo_env import situations
from tests.sumo_env.rollout import drive

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


def test_the_ego_s_own_way_is_counted_from_where_the_lane_to_the_exit_begins() -> None:
    given = {"type": "ExitObservation", "normalize": False, "vehicles_count": 3}
    with closing(DrivingEnv("exit", {"observation": given})) as env:
        observation, _ = env.reset(seed=2)
        x, nearest = env.scene.x[0], np.sort(env.scene.x[1:])[:2]
        assert observation[:, 1] == pytest.approx([x - 400.0, *(nearest - x)], abs=1e-3)
    with pytest.raises(ConfigError, match="exit"):
        DrivingEnv("highway", {"observation": given})


def test_lanes_abreast_are_those_of_the_road_that_the_ego_steers_for() -> None:
    with closing(DrivingEnv("exit", {"simulation_frequency": 15, "policy_frequency": 15})) as env:
        env.reset(seed=0, options={"scenario": placed(env, 3, 496.0, 18.0)})
        states = [env.ego_state for _ in drive(env, [IDLE] * 5)]
        counts = [env.task.road(env.config).count(*state.target_lane[:2]) for state in states]
    assert any(state.lane[:2] != state.target_lane[:2] for state in states)
    assert [state.lanes_abreast for state in states] == counts
