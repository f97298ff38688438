"""Time to collision against stepping through time with shapely; headway and density by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from sumo_env.contacts.measures import density, ego_ttc, headways
from sumo_env.contacts.rectangles import Half, State

from .shapes import CAR, polygons

HORIZON = 4.0
STEP = 0.02


@pytest.fixture(scope="module")
def traffic() -> np.ndarray:
    """States of an ego and 1500 others; some are parallel to it, touch it or stand still, two thirds meet it."""
    rng = np.random.default_rng(11)
    n = 1501
    heading = rng.uniform(-math.pi, math.pi, n)
    heading[: n // 5] = heading[0]
    speed = rng.uniform(-3, 25, n)
    speed[n // 2 : n // 2 + 100] = 0.0
    x, y = rng.uniform(-50, 50, (2, n))
    x[0], y[0], speed[0] = 1.0, -2.0, 14.0
    vx, vy = speed * np.cos(heading), speed * np.sin(heading)
    near = slice(n // 3, n)  # their centres pass within 5 m or so of the ego's
    when = rng.uniform(0.3, HORIZON, n)[near]
    x[near] = x[0] + (vx[0] - vx[near]) * when + rng.uniform(-4, 4, len(when))
    y[near] = y[0] + (vy[0] - vy[near]) * when + rng.uniform(-4, 4, len(when))
    return np.column_stack([x, y, speed, heading])


def states_of(traffic: np.ndarray) -> list[State]:
    return [tuple(row) for row in traffic.tolist()]


def ttc(traffic: np.ndarray, **sizes: Half) -> np.ndarray:
    """Of the first row with each of the others."""
    ego, *others = states_of(traffic)
    return np.array([ego_ttc(ego, [other], HORIZON, **sizes) for other in others])


def moved(traffic: np.ndarray, times: np.ndarray, half: Half) -> np.ndarray:
    """Polygons after `times` [s], one for each row of `traffic` or broadcast to them."""
    x, y, speed, heading = traffic.T
    x, y = x + speed * np.cos(heading) * times, y + speed * np.sin(heading) * times
    return polygons(x, y, np.broadcast_to(heading, x.shape), half)


@pytest.mark.parametrize(("own", "half"), [(CAR, CAR), ((8.0, 1.25), (9.0, 1.3)), ((8.0, 1.25), CAR)])
def test_at_that_time_they_touch_and_before_they_do_not(traffic, own: Half, half: Half) -> None:
    """Nor do they at any time where there is none: all steps are looked at."""
    ours = ttc(traffic, own=own, half=half)
    ego, *others = states_of(traffic)
    np.testing.assert_allclose([ego_ttc(other, [ego], HORIZON, half=own, own=half) for other in others], ours)
    assert (ours <= ttc(traffic)).all()

    def gaps(those: np.ndarray, times: np.ndarray) -> np.ndarray:
        return shapely.distance(moved(traffic[1:][those], times, half), moved(traffic[:1], times, own))

    hits = np.flatnonzero(np.isfinite(ours))
    later = hits[ours[hits] > 0.0]
    assert 200 < len(later) < len(hits) < 0.9 * len(ours)
    assert (gaps(hits, ours[hits]) < 1e-8).all() and (gaps(later, 0.999 * ours[later]) > 0.0).all()
    times = np.arange(0.0, HORIZON, STEP)
    those, steps = np.nonzero(times < ours[:, None] - 1e-9)
    assert (gaps(those, times[steps]) > 0.0).all()


def test_the_time_of_the_ego_is_the_least_of_all(traffic) -> None:
    ego, *others = states_of(traffic)
    everybody = ttc(traffic)
    for start in range(0, 1500, 50):
        assert ego_ttc(ego, others[start : start + 50], HORIZON) == everybody[start : start + 50].min()
    assert ego_ttc(ego, []) == math.inf


def test_headway_is_to_the_nearest_in_the_corridor() -> None:
    x = np.array([0.0, 30.0, 20.0, 25.0, -10.0, 95.0])
    y = np.array([0.0, 0.5, 2.5, -1.9, 0.0, 0.0])
    speed = np.array([10.0, 20.0, 0.05, 10.0, 10.0, 10.0])
    # the third is beside the corridor of the first and hardly moves; 95 is more than 60 m ahead of 30
    expected = [2.0, math.inf, math.inf, math.inf, 0.5, math.inf]
    assert headways(x, y, speed, np.zeros(6)) == pytest.approx(expected)


def test_headway_follows_the_heading() -> None:
    x, y = np.array([0.0, 0.0, 0.0]), np.array([0.0, -15.0, 15.0])
    ours = headways(x, y, np.full(3, 5.0), np.full(3, -math.pi / 2))  # all drive north, y is down
    assert ours == pytest.approx([2.0, math.inf, 2.0])


def test_density_counts_the_others_within_the_radius() -> None:
    x, y = np.array([0.0, 199.9, -150.0, 150.0]), np.array([0.0, 0.0, 150.0, 100.0])
    assert density(x, y) == 2
    assert density(x[:1], y[:1]) == 0
