"""Many episodes in one call: actions, sub-steps, observations, rewards and endings, without Python in between.

An episode here is one row of each table of `Batch`; what happens in it is computed by the kernels that drive a single
environment too. Rows have room for more cars than there are.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from sumo_env.config import Config, ConfigError
from sumo_env.contacts.measures import DENSITY_RADIUS
from sumo_env.replica import tables
from sumo_env.replica.compiled import compiled, inlined, record_type
from sumo_env.replica.driving import follow_road, is_reachable
from sumo_env.replica.geometry import local_coordinates
from sumo_env.replica.observation import ego_place, observe
from sumo_env.replica.step import Rules, hold, policy_step, staying
from sumo_env.spaces.observation import TableForm
from sumo_env.tasks import TASKS, base
from sumo_env.tasks.base import Task, lmap
from sumo_env.tasks.exit import BESIDE
from sumo_env.tasks.exit import EXIT as LEAVING
from sumo_env.tasks.intersection import ARRIVAL
from sumo_env.tasks.merge import PASSED, RAMP_END

# In place of an action. AFRESH: only observe the start of an episode. NOTHING: skip this row.
AFRESH, NOTHING = -1, -2
OTHER = 1  # the number of an action of which rewards take no notice
SPEEDS = {"FASTER": 1, "SLOWER": -1}  # change of the target speed's index
PAID = tuple(name for name, task in TASKS.items() if task.versions)  # tasks whose rewards `reward` has
HIGHWAY, TWO_WAY, ROUNDABOUT, INTERSECTION, U_TURN, MERGE, EXIT = range(len(PAID))

OUTCOME = record_type(  # of a policy step, see `DrivingEnv.step`
    [
        ("reward", "f8"),
        ("terminated", "?"),
        ("truncated", "?"),
        ("speed", "f8"),
        ("crashed", "?"),
        ("arrived", "?"),
        ("on_road", "?"),
        ("density", "i8"),
        ("min_ttc", "f8"),
        ("distance", "f8"),
    ]
)

_nearest_index, _speed_term = inlined(base.nearest_index), inlined(base.speed_term)


class Start(NamedTuple):
    """An episode before its first step."""

    rules: Rules
    cars: tables.Records  # the ego first
    arrivals: tables.Records  # by `comes_after`
    first_arrival: int  # see EPISODE
    events: tables.Records


class RewardWeights(NamedTuple):
    """What a configuration pays: the weights of the terms of `Task.rewards`, 0 where a task has none."""

    task: int  # place in PAID
    collision: float
    lane: float
    speed: float
    lane_change: float
    arrived: float
    held_up: float
    # lanes that count: where somebody may be held up, or the two that are the goal; or NONE
    places: tuple[int, int]
    is_normalized: bool
    limits: tuple[float, float]  # rewards that become 0 and 1; (0, 1) where rewards are not normalised
    speed_range: tuple[float, float]  # ``reward_speed_range`` [m/s]
    offroad_terminal: bool


def reward_weights(task: Task, config: Config) -> RewardWeights:
    """The rewards of a task of PAID under a resolved configuration.

    Raises:
        ConfigError: another task.
    """
    if task.name not in PAID:
        raise ConfigError(f"batches have no reward of the task {task.name!r}, only of {', '.join(PAID)}")

    config = {key: value for key, value in config.items() if key in task.defaults}  # others have no effect

    def weight(key: str) -> float:
        return float(config.get(key, 0.0))

    limits = task.scale(config)
    low, high = limits or (0.0, 1.0)
    slow, fast = config.get("reward_speed_range", (0.0, 1.0))
    return RewardWeights(
        task=PAID.index(task.name),
        collision=weight("collision_reward"),
        lane=weight("left_lane_reward") + weight("right_lane_reward"),  # no task has both
        speed=weight("high_speed_reward"),
        lane_change=weight("lane_change_reward"),
        arrived=weight("arrived_reward") + weight("goal_reward"),  # likewise
        held_up=weight("merging_speed_reward"),
        places=_places(task, config),
        is_normalized=limits is not None,
        limits=(float(low), float(high)),
        speed_range=(float(slow), float(fast)),
        offroad_terminal=task.name not in ("u-turn", "exit") and bool(config.get("offroad_terminal", False)),
    )


def _places(task: Task, config: Config) -> tuple[int, int]:
    """See `RewardWeights`."""
    road = task.road(config)
    numbers = tables.lanes_of(road, False).numbers
    if task.name == "merge":
        return numbers[RAMP_END], tables.NONE
    if task.name == "exit":
        return numbers[*BESIDE, road.count(*BESIDE) - 1], numbers[LEAVING]
    return tables.NONE, tables.NONE


class EnvParams(NamedTuple):
    """What all episodes of a batch have in common."""

    lanes: tables.Records
    seen_lanes: tables.Records  # that the ego sees
    rules: Rules
    form: TableForm
    weights: RewardWeights
    speeds: np.ndarray  # that the ego can be commanded [m/s]
    speed_changes: np.ndarray  # by action: +1, 0 or -1
    sides: np.ndarray  # likewise
    time_limit: int  # policy steps of the longest episode


class Batch(NamedTuple):
    """The state of n episodes, and what their last step gave."""

    episodes: tables.Records  # shape (n,)
    outcomes: tables.Records
    cars: tables.Records  # shape (n, room), the ego first; there is room for the arrivals
    arrivals: tables.Records
    events: tables.Records
    observations: np.ndarray  # float32 of shape (n, rows, features)


def no_episodes(count: int, rows: int = 0, features: int = 0) -> Batch:
    """Room for this many episodes, of which none has begun; rows, features: of an observation."""
    return Batch(
        np.zeros(count, tables.EPISODE),
        np.zeros(count, OUTCOME),
        np.zeros((count, 1), tables.CAR),
        np.zeros((count, 1), tables.CAR),
        np.zeros((count, 1), tables.EVENT),
        np.zeros((count, rows, features), np.float32),
    )


def begun(batch: Batch, row: int, start: Start, speed_index: int = 0) -> Batch:
    """The batch in which this episode begins; the same one, or a larger one if there is not enough room."""
    cars, later, events = len(start.cars), len(start.arrivals), len(start.events)
    for name, size in {"cars": cars + later, "arrivals": later, "events": events}.items():
        if size == 0:
            continue
        table, rows = getattr(batch, name), getattr(start, name)
        if table.shape[1] < size:
            table = np.concatenate((table, np.zeros((len(table), size), table.dtype)), axis=1)
            batch = batch._replace(**{name: table})
        tables.as_bytes(table)[row, : len(rows)] = tables.as_bytes(rows)
    batch.episodes[row] = (cars, later, 0, start.first_arrival, events, 0, 0, speed_index)
    return batch


def expecting(batch: Batch, row: int, car: tables.Records) -> Batch:
    """The batch in which a car arrives in the next step of an episode, and nobody else does; see `begun`."""
    episode = batch.episodes[row]
    if batch.cars.shape[1] == episode["cars"]:
        batch = batch._replace(cars=np.concatenate((batch.cars, np.zeros_like(batch.cars)), axis=1))
    batch.arrivals[row, 0] = car[0]
    batch.arrivals["comes_after"][row, 0] = episode["steps"]
    episode["arrivals"], episode["next_arrival"] = 1, 0
    return batch


def copied(batch: Batch, rows: Any) -> Batch:
    """These episodes, which go on by themselves; one that is named several times becomes several.

    rows: their numbers, a sequence or an array.
    """
    *records, observations = batch
    return Batch._make([*(tables.chosen(table, rows) for table in records), observations[rows]])


def remaining(batch: Batch, row: int, lanes: tables.Records) -> list[tuple[float, float]]:
    """Centres of the cars of an episode that will be there in the next step [m]."""
    cars = batch.cars[row, : batch.episodes["cars"][row]]
    there = cars[staying(lanes, cars)]
    return list(zip(there["x"].tolist(), there["y"].tolist(), strict=True))


# -- kernels ------------------------------------------------------------------------------------------------------


@inlined
def command(params: Any, ego: Any, episode: Any, action: int) -> None:
    """``MDPVehicle.act``: what a meta-action changes, see `sumo_env.spaces.actions`."""
    if params.speed_changes[action] != 0:
        wanted = _nearest_index(ego.speed, params.speeds) + params.speed_changes[action]
        episode.speed_index = min(max(wanted, 0), len(params.speeds) - 1)
    ego.target_speed = params.speeds[episode.speed_index]
    follow_road(params.lanes, ego, local_coordinates(params.lanes[ego.target], ego.x, ego.y)[0])
    if params.sides[action] != 0:
        lane = params.lanes[ego.target]
        beside = lane.left if params.sides[action] < 0 else lane.right
        if beside != tables.NONE:
            s, lat = local_coordinates(params.lanes[beside], ego.x, ego.y)
            if is_reachable(params.lanes[beside], s, lat):
                ego.target = beside


@inlined
def density(cars: Any) -> int:
    """`measures.density` around the ego, the first car."""
    count = 0
    for j in range(1, len(cars)):
        dx, dy = cars[j].x - cars[0].x, cars[j].y - cars[0].y
        count += dx * dx + dy * dy <= DENSITY_RADIUS * DENSITY_RADIUS
    return count


@inlined
def has_arrived(w: Any, lanes: Any, ego: Any, s: float) -> bool:
    """`Task.arrived`; s: of the ego on its lane [m]."""
    if w.task == MERGE:
        return lanes[ego.lane].start == lanes[w.places[0]].end and s > PASSED
    if w.task == EXIT:
        return ego.target == w.places[0] or ego.target == w.places[1]
    return lanes[ego.lane].is_exit and s >= ARRIVAL


@inlined
def held_up(cars: Any, ramp: int) -> float:
    """By what shares of their wanted speeds the others in the lane `ramp` are too slow."""
    total = 0.0
    for j in range(1, len(cars)):
        if cars[j].lane == ramp and not cars[j].is_obstacle:
            total += (cars[j].target_speed - cars[j].speed) / cars[j].target_speed
    return total


@inlined
def reward(
    w: Any, lanes: Any, cars: Any, action: int, speed_index: int, speeds: int, on_road: bool, arrived: bool
) -> float:
    """`Task.reward` after a policy step; speeds: number of target speeds."""
    ego = cars[0]
    here, target = ego.lane - lanes[ego.lane].road, ego.target - lanes[ego.target].road
    total = w.collision * ego.crashed
    if w.task == HIGHWAY:
        total += w.lane * (target / max(lanes[ego.target].abreast - 1, 1))
        total += w.speed * _speed_term(ego.speed * ego.cos, w.speed_range)
    elif w.task == TWO_WAY:
        return w.speed * (speed_index / (speeds - 1)) + w.lane * (1 - target)
    elif w.task == ROUNDABOUT:
        total += w.speed * (speed_index / 2)
        total += w.lane_change * (action == 0 or action == 2)
    elif w.task == INTERSECTION:
        total = w.arrived if arrived else total + w.speed * _speed_term(ego.speed, w.speed_range)
        return lmap(total * on_road, w.limits, (0.0, 1.0))
    elif w.task == U_TURN:
        total += w.lane * here
        total += w.speed * _speed_term(ego.speed, w.speed_range)
    elif w.task == MERGE:
        total += w.lane * here
        total += w.speed * lmap(ego.speed, w.speed_range, (0.0, 1.0))
        total += w.lane_change * (action == 0 or action == 2)
        return lmap(total + w.held_up * held_up(cars, w.places[0]), w.limits, (0.0, 1.0))
    elif w.task == EXIT:
        total += w.lane * target + w.arrived * arrived
        total += w.speed * _speed_term(ego.speed, w.speed_range)
        total = lmap(total, w.limits, (0.0, 1.0))
        return min(max(total, 0.0), 1.0) if w.is_normalized else total
    return lmap(total, w.limits, (0.0, 1.0)) * on_road


@compiled
def judge_step(params: Any, cars: Any, episode: Any, outcome: Any, action: int) -> None:
    """Write down how the ego is, and what a step pays and ends; `action` AFRESH: before the first step."""
    ego = cars[0]
    _, s, _, on_road = ego_place(params.seen_lanes, cars)
    arrived = has_arrived(params.weights, params.seen_lanes, ego, s)
    outcome.speed, outcome.crashed = ego.speed, ego.crashed
    outcome.on_road, outcome.arrived = on_road, arrived
    outcome.density = density(cars)
    outcome.reward, outcome.terminated, outcome.truncated = 0.0, False, False
    if params.rules.is_steered:
        episode.speed_index = _nearest_index(ego.speed, params.speeds)
    if action != AFRESH:
        count = len(params.speeds)
        outcome.reward = reward(
            params.weights, params.seen_lanes, cars, action, episode.speed_index, count, on_road, arrived
        )
        ends = arrived and params.weights.task != EXIT
        outcome.terminated = ego.crashed or ends or (params.weights.offroad_terminal and not on_road)
        outcome.truncated = episode.steps >= params.time_limit


@compiled
def drive(params: Any, batch: Any, actions: Any, controls: Any, first: int, end: int) -> None:
    """One policy step of the episodes from row `first` to row `end`.

    Args:
        actions: of all episodes, shape (n,); AFRESH looks at an episode that begins, NOTHING passes one by.
        controls: accelerations [m/s2] and angles [rad] of egos that are steered, shape (n, 2).
    """
    trace = np.empty((0, 6, 0))
    for row in range(first, end):
        action, episode, outcome = actions[row], batch.episodes[row], batch.outcomes[row]
        if action == NOTHING:
            continue
        outcome.min_ttc, outcome.distance = math.inf, 0.0
        if action != AFRESH:
            if params.rules.is_steered:
                hold(batch.cars[row, 0], controls[row, 0], controls[row, 1])
            else:
                command(params, batch.cars[row, 0], episode, action)
            _, outcome.min_ttc, outcome.distance = policy_step(params.lanes, params.rules, batch, row, trace)
        cars = batch.cars[row, : episode.cars]
        judge_step(params, cars, episode, outcome, action)
        observe(params.seen_lanes, cars, params.form, batch.observations[row])
