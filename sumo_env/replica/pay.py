"""Rewards and endings of the five tasks, compiled: `Task.reward` and `Task.terminated`, to the bit."""

from __future__ import annotations

from typing import Any, NamedTuple

from sumo_env.config import Config
from sumo_env.replica.compiled import borrowing
from sumo_env.tasks import TASKS, base
from sumo_env.tasks.base import Task, lmap
from sumo_env.tasks.intersection import ARRIVAL

HIGHWAY, TWO_WAY, ROUNDABOUT, INTERSECTION, U_TURN = range(5)  # places in TASKS
LANE_REWARDS = {"highway": "right_lane_reward", "two-way": "left_lane_reward", "u-turn": "left_lane_reward"}

_speed_term = borrowing(base.speed_term)


class Pay(NamedTuple):
    """What a configuration pays: the weights of the terms of `Task.rewards`, 0 where a task has none."""

    task: int  # place in TASKS
    collision: float
    lane: float
    speed: float
    lane_change: float
    arrived: float
    limits: tuple[float, float]  # rewards that become 0 and 1; (0, 1) where rewards are not normalised
    speed_range: tuple[float, float]  # ``reward_speed_range`` [m/s]
    offroad_terminal: bool


def pay_of(task: Task, config: Config) -> Pay:
    """The rewards of one of the five tasks under a resolved configuration."""

    def weight(key: str) -> float:
        return float(config.get(key, 0.0))

    limits = task.reward_limits(config) if config.get("normalize_reward") else None
    low, high = limits or (0.0, 1.0)
    slow, fast = config.get("reward_speed_range", (0.0, 1.0))
    return Pay(
        task=list(TASKS).index(task.name),
        collision=weight("collision_reward"),
        lane=weight(LANE_REWARDS.get(task.name, "")),
        speed=weight("high_speed_reward"),
        lane_change=weight("lane_change_reward"),
        arrived=weight("arrived_reward"),
        limits=(float(low), float(high)),
        speed_range=(float(slow), float(fast)),
        offroad_terminal=task.name != "u-turn" and bool(config.get("offroad_terminal", False)),
    )


@borrowing
def has_arrived(lanes: Any, ego: Any, s: float) -> bool:
    """`Intersection.arrived`; s: of the ego on its lane [m]."""
    return lanes[ego.lane].is_exit and s >= ARRIVAL


@borrowing
def reward(
    pay: Any, lanes: Any, ego: Any, action: int, speed_index: int, speeds: int, on_road: bool, arrived: bool
) -> float:
    """`Task.reward` after a policy step; speeds: number of target speeds."""
    here, target = ego.lane - lanes[ego.lane].road, ego.target - lanes[ego.target].road
    total = pay.collision * ego.crashed
    if pay.task == HIGHWAY:
        total += pay.lane * (target / max(lanes[ego.target].abreast - 1, 1))
        total += pay.speed * _speed_term(ego.speed * ego.cos, pay.speed_range)
    elif pay.task == TWO_WAY:
        return pay.speed * (speed_index / (speeds - 1)) + pay.lane * (1 - target)
    elif pay.task == ROUNDABOUT:
        total += pay.speed * (speed_index / 2)
        total += pay.lane_change * (action == 0 or action == 2)
    elif pay.task == INTERSECTION:
        total = pay.arrived if arrived else total + pay.speed * _speed_term(ego.speed, pay.speed_range)
        return lmap(total * on_road, pay.limits, (0.0, 1.0))
    else:
        total += pay.lane * here
        total += pay.speed * _speed_term(ego.speed, pay.speed_range)
    return lmap(total, pay.limits, (0.0, 1.0)) * on_road
