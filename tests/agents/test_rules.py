"""Drivers that do not learn: what they choose, and how the careful one fares on highway-env's own tasks."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents.rules import CAUTIONS, make_policy
from agents.rules.careful import FUTURE, _as_if_turning, _drive
from agents.rules.perception import Perception
from experiments.backends import make_env
from experiments.study.compute.evaluate import evaluate

FIVE = {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT", 3: "FASTER", 4: "SLOWER"}
THREE = {0: "SLOWER", 1: "IDLE", 2: "FASTER"}
RANGES = {"x": (-200.0, 200.0), "y": (-16.0, 16.0), "vx": (-80.0, 80.0), "vy": (-80.0, 80.0)}


def road(
    actions: dict[int, str] = FIVE, features: tuple[str, ...] = ("presence", "x", "y", "vx", "vy")
) -> Any:
    """What the rules see of an environment."""
    kind = SimpleNamespace(features=features, ranges=RANGES, absolute=False)
    inner = SimpleNamespace(actions=actions, target_speeds=(20.0, 25.0, 30.0), observation_type=kind)
    return SimpleNamespace(unwrapped=inner)


def scene(*others: tuple[float, float, float], speed: float = 25.0) -> np.ndarray:
    """An observation: the ego eastbound at y = 4; others (x ahead [m], y to the right [m], speed [m/s])."""
    rows = [(0.0, 4.0, speed, 0.0)] + [(x, y, v - speed, 0.0) for x, y, v in others]
    table = np.zeros((5, 5), np.float32)
    for row, values in zip(table, rows, strict=False):
        row[0] = 1
        row[1:] = [value / RANGES[name][1] for value, name in zip(values, RANGES, strict=True)]
    return table


def last_choice(*scenes: np.ndarray, name: str = "careful") -> str:
    """What a driver does at the last of some observations, one a second."""
    policy = make_policy(name, road())
    return FIVE[[policy.act(each) for each in scenes][-1]]


@pytest.mark.parametrize("actions", [FIVE, THREE])
@pytest.mark.parametrize("name", ["idle", "faster", "slower"])
def test_constant_policies_find_their_action_by_name(actions: dict[int, str], name: str) -> None:
    policy = make_policy(name, road(actions))
    assert actions[policy.act(scene())] == name.upper()


def test_the_random_policy_is_uniform_and_repeats_with_its_seed() -> None:
    policy = make_policy("random", road())
    policy.reset(7)
    first = [policy.act(scene()) for _ in range(2000)]
    policy.reset(7)
    assert [policy.act(scene()) for _ in range(2000)] == first
    assert np.abs(np.bincount(first, minlength=5) - 400).max() < 90


NEARER, SLOW, FAR, BESIDE = (35, 0, 20), (30, 0, 20), (90, -4, 25), (2, -4, 25)


@pytest.mark.parametrize(
    ("scenes", "expected"),
    [
        ([scene(), scene()], {"FASTER"}),
        ([scene(), scene(speed=30.0)], {"IDLE"}),
        ([scene((48, 0, 20)), scene((43, 0, 20))], {"SLOWER", "IDLE"}),
        ([scene((25, 0, 20)), scene((20, 0, 20))], {"SLOWER"}),
        # somebody far ahead shows that there is a lane
        ([scene(NEARER, FAR), scene(SLOW, FAR)], {"LANE_LEFT"}),
        ([scene(NEARER, BESIDE), scene(SLOW, BESIDE)], {*FIVE.values()} - {"LANE_LEFT"}),
        # y has not changed after LANE_LEFT: there was no lane, and none is known on the right
        ([scene(NEARER, FAR), scene(SLOW, FAR), scene((25, 0, 20))], {"IDLE", "SLOWER", "FASTER"}),
    ],
)
def test_careful_speeds_up_brakes_and_overtakes(scenes: list[np.ndarray], expected: set[str]) -> None:
    assert last_choice(*scenes) in expected


def test_more_caution_slows_down_farther_behind_a_leader() -> None:
    def braking_distance(name: str) -> float:
        gaps = np.arange(10.0, 120.0, 2.0)
        slows = [last_choice(*[scene((gap, 0.0, 15.0))] * 2, name=name) == "SLOWER" for gap in gaps]
        return float(gaps[slows].max())

    distances = [braking_distance(name) for name in CAUTIONS]
    assert distances == sorted(distances) and distances[0] < distances[2] < distances[-1]


def test_oncoming_cars_on_the_left_count_as_nearer_to_an_ego_that_may_turn() -> None:
    places = np.array([[10.0, -4.0], [10.0, -1.0], [40.0, -4.0]])
    view: Any = SimpleNamespace(positions=places, headings=np.full(3, np.pi))
    assert _as_if_turning(view).tolist() == [[10.0, -2.0], [10.0, 0.0], [40.0, -4.0]]


def test_who_brakes_is_thought_to_brake_for_two_seconds_or_to_a_standstill() -> None:
    """And no harder than by 6 m/s2."""
    view: Any = SimpleNamespace(speeds=np.array([10.0, 10.0, 4.0]), acceleration=np.array([1.0, -4.0, -9.0]))
    ways = _drive(view)[:, np.isin(FUTURE, (1.0, 2.0, 4.0))]
    assert ways == pytest.approx(np.array([[10, 20, 40], [8, 12, 16], [4 / 3] * 3]), abs=1e-4)


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        (scene(), "FASTER"),
        (scene(speed=30.0), "IDLE"),
        (scene((25, 0, 20)), "SLOWER"),
        (scene((25, 4, 20)), "FASTER"),  # on the next lane
        (scene((-25, 0, 20)), "FASTER"),
        (scene(SLOW, FAR), "LANE_LEFT"),
        (scene(SLOW), "SLOWER"),  # no lane is known
        (scene(SLOW, FAR, (-8, -4, 30)), "SLOWER"),  # the new follower would brake hard
        (scene(FAR), "FASTER"),  # nothing to gain
        (scene((100, 0, -20)), "SLOWER"),  # oncoming
    ],
)
def test_idm_keeps_its_distance_and_changes_lane_by_mobil(seen: np.ndarray, expected: str) -> None:
    assert last_choice(seen, name="idm") == expected


def test_idm_follows_a_leader_round_a_bend() -> None:
    """On a bend to the right the leader is to the right of straight ahead, and a vehicle straight ahead is not one."""
    radius, speed = 20.0, 8.0

    def on_arc(ahead: float) -> tuple[float, float, float]:
        angle = ahead / radius
        return radius * np.sin(angle), radius * (1 - np.cos(angle)), angle

    def row(x: float, y: float, angle: float, v: float) -> np.ndarray:
        return np.array([x / 200, y / 16, v * np.cos(angle) / 80, v * np.sin(angle) / 80])

    def seen(time: float, others: list[tuple[float, float, float]]) -> np.ndarray:
        table = np.zeros((5, 5), np.float32)
        ego = row(*on_arc(speed * time), speed)
        for own, values in zip(
            table, [ego, *(row(*other, 2.0 + time / 10) - ego for other in others)], strict=False
        ):
            own[:] = (1, *values)
        return table

    def choice(*others: tuple[float, float, float]) -> str:
        return last_choice(*(seen(time, list(others)) for time in (0.0, 1.0)), name="idm")

    straight = on_arc(speed)
    tangent = (straight[0] + 15 * np.cos(straight[2]), straight[1] + 15 * np.sin(straight[2]), straight[2])
    assert choice(on_arc(speed + 15.0)) == "SLOWER"
    assert choice(tangent) != "SLOWER"
    perception = Perception(road())  # an ego on the bend keeps its lane
    *_, sideways = (perception.look(seen(time, [])).sideways for time in (0.0, 1.0, 2.0))
    assert sideways == pytest.approx(0.0, abs=0.1)
    *_, other = (perception.look(seen(time, [(30 + 2 * time, 0, 0)])) for time in (3.0, 4.0))
    assert other.turning.tolist() == [0.0]  # it goes straight, while the ego turns
    assert other.acceleration.tolist() == pytest.approx([0.1], abs=1e-3)


def test_a_vehicle_is_followed_wherever_its_row_stands() -> None:
    perception = Perception(road())
    perception.look(scene((30, 0, 20), (50, 4, 24)))
    seen = perception.look(scene((49, 4, 25), (25, 0, 18), (90, -4, 30)))
    assert seen.acceleration.tolist() == pytest.approx([1.0, -2.0, 0.0], abs=1e-3)  # the last one is new


@pytest.mark.slow
@pytest.mark.parametrize("task", ["highway", "roundabout", "intersection", "u-turn"])
def test_careful_on_highway_env(task: str) -> None:
    """On its physics, by the replica. At the intersection the return pays for crossing blindly."""
    env = make_env("replica", task)
    careful, idle = (
        evaluate(env, make_policy(name, env), task, 1, range(30), ("regular",))
        for name in ("careful", "idle")
    )
    assert careful["crashed"].mean() <= 0.1 < 0.3 <= idle["crashed"].mean()
    assert task == "intersection" or careful["return"].mean() > idle["return"].mean()


def test_careful_forgets_on_reset() -> None:
    policy = make_policy("careful", road())
    scenes = [scene((40, 0, 20), (90, -4, 25)), scene((35, 0, 20)), scene((30, 0, 20))]
    first = [policy.act(each) for each in scenes]
    policy.reset(0)
    assert [policy.act(each) for each in scenes] == first
