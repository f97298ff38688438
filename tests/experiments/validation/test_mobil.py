"""MOBIL's criteria on scenes made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.validation.mobil import criteria, judge, neighbours
from sumo_env.scene import Scene
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import ego_driver, make_on_lane

ROAD = TASKS["highway"].road({"lanes_count": 4})
TARGET = 25.0  # [m/s]


def scene(*vehicles: tuple[float, float, float], time: float = 0.0) -> Scene:
    """Vehicles by x [m], y [m] and speed [m/s]; the ego is far behind."""
    rows = np.array([(0.0, 0.0, 20.0), *vehicles])
    ids = ("ego", *(f"v{k}" for k in range(len(vehicles))))
    zeros = np.zeros(len(rows))
    return Scene(ids, rows[:, 0], rows[:, 1], rows[:, 2], zeros, zeros.astype(bool), time)


def specs(of: Scene):
    driver = ego_driver(TASKS["highway"])
    return {name: make_on_lane(ROAD, name, ("0", "1", 0), 50.0, TARGET, driver) for name in of.ids}


def verdict(of: Scene) -> tuple[bool, bool]:
    return criteria(of, "v0", 1, specs(of))


def test_a_free_lane_beside_a_slow_leader_is_safe_and_worth_it() -> None:
    assert verdict(scene((100, 0, 20), (120, 0, 10))) == (True, True)


def test_a_change_without_a_leader_is_not_worth_it() -> None:
    assert verdict(scene((100, 0, 20))) == (True, False)


def test_a_fast_follower_close_behind_makes_it_unsafe() -> None:
    assert verdict(scene((100, 0, 15), (120, 0, 10), (90, 4, 25))) == (False, True)


def test_neighbours_are_the_nearest_on_the_lane() -> None:
    of = scene((100, 0, 20), (130, 4, 20), (150, 4, 20), (80, 4, 20), (60, 4, 20), (95, 8, 20))
    assert neighbours(of, 1, 1) == (2, 4)
    assert neighbours(of, 1, 3) == (None, None)


@pytest.mark.parametrize(("leader", "valid"), [(125.0, 1), (900.0, 0)])
def test_a_change_is_judged_when_it_begins(leader: float, valid: int) -> None:
    ys = [0.0, 0.0, 0.0, 0.5, 1.5, 2.5, 3.5, 4.0]
    frames = [scene((100 + 2 * k, y, 20), (leader + k, 0, 10), time=k / 10) for k, y in enumerate(ys)]
    tally = judge(frames, specs(frames[0]), 10)
    assert (tally["changes"], tally["valid"]) == (1, valid)
    near = 1 + (leader < 200.0)  # vehicles within the ego's reach
    assert tally["vehicle_minutes"] == pytest.approx(near * len(ys) / 600)
