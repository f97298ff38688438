"""The intersection's right of way: examples. Random states are compared in test_motion.py."""

from __future__ import annotations

import numpy as np

from sumo_env.networks.roads import intersection
from sumo_env.replica.geometry import locate, no_places
from sumo_env.replica.give_way import regulate
from sumo_env.replica.numpy_loops import LOOPS
from sumo_env.replica.step import Rules
from sumo_env.replica.tables import cars_of, lanes_of
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import ego_driver, make_on_lane

ROAD = intersection()
LANES = lanes_of(ROAD, connected=True)
RULES = Rules(along_path=False, is_two_way=False, regulation_interval=7, dt=1 / 15)
DRIVER = ego_driver(TASKS["intersection"])


def car(start: int, end: int, s: float = 85.0, speed: float = 9.0) -> np.ndarray:
    """A car on the way from one arm to another, by default 15 m before the square."""
    spec = make_on_lane(
        ROAD, "v", (f"o{start}", f"ir{start}", 0), s, speed, DRIVER, destination=f"o{end}", target_speed=8.0
    )
    return cars_of(ROAD, [spec])


def who_yields(*cars: np.ndarray) -> list[bool]:
    """The cars that stop once the right of way was looked at."""
    after = np.concatenate(cars)
    places = no_places(LANES.table, after)
    locate(LANES.table, after, places, LOOPS)
    regulate(LANES.table, after, places, RULES)
    np.testing.assert_array_equal(after["target_speed"], np.where(after["yields"], 0.0, 8.0))
    return after["yields"].tolist()


def test_the_east_west_road_has_right_of_way() -> None:
    assert who_yields(car(0, 2), car(1, 3)) == [True, False]
    assert who_yields(car(1, 3), car(0, 2)) == [False, True]


def test_nobody_gives_way_instead_of_a_driver_who_does_not() -> None:
    heedless = car(0, 2)
    heedless["gives_way"] = False
    assert who_yields(heedless, car(1, 3)) == [False, False]
    assert who_yields(car(0, 2), car(1, 3)) == [True, False]


def test_on_one_lane_the_car_behind_gives_way() -> None:
    assert who_yields(car(1, 3, s=30.0, speed=10.0), car(1, 3, s=45.0, speed=5.0)) == [True, False]
