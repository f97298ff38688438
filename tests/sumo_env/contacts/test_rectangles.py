"""Contacts against shapely's polygons, time to collision against stepping through time; headway, density by hand."""

import math

import numpy as np
import pytest
import shapely

from sumo_env.contacts.measures import density, ego_ttc, headways
from sumo_env.contacts.rectangles import (
    FINEST,
    Half,
    State,
    distance,
    first_touch,
    separation,
    state_between,
    touch_moment,
)

from .shapes import CAR, polygons, rows, state


@pytest.fixture(scope="module")
def pairs() -> tuple[np.ndarray, np.ndarray]:
    """8,000 pairs of poses (x, y, heading) near each other; a fifth with equal or perpendicular headings."""
    rng = np.random.default_rng(7)
    n = 8_000
    first = np.column_stack([rng.uniform(-50, 50, (n, 2)), rng.uniform(-7, 7, n)])
    turn = rng.uniform(-math.pi, math.pi, n)
    aligned = rng.random(n) < 0.2
    turn[aligned] = rng.integers(-2, 3, aligned.sum()) * math.pi / 2
    offset = rng.uniform(-5.2, 5.2, (n, 2))
    return first, np.column_stack([first[:, :2] + offset, first[:, 2] + turn])


def over(function, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.array([function(a, b) for a, b in zip(rows(first), rows(second), strict=True)])


def test_distance_equals_shapely(pairs) -> None:
    first, second = pairs
    one, two = polygons(*first.T), polygons(*second.T)
    expected = shapely.distance(one, two)
    ours = over(distance, first, second)
    apart = expected > 1e-9
    assert 0.3 < apart.mean() < 0.8
    np.testing.assert_allclose(ours[apart], expected[apart], atol=1e-9)
    assert (ours[~apart] <= 1e-9).all()
    inside = shapely.area(shapely.intersection(one, two)) > 1e-9
    assert (over(separation, first, second)[inside] <= 0.0).all()


def test_penetration_is_the_shortest_way_out(pairs) -> None:
    first, second = (poses[:1700] for poses in pairs)
    depth = -over(distance, first, second)
    deep = depth > 0.01
    first, second, depth = first[deep], second[deep], depth[deep]
    freed = np.zeros(len(depth), dtype=bool)
    for axis in range(4):
        heading = (first if axis < 2 else second)[:, 2] + (axis % 2) * math.pi / 2
        direction = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(depth))])
        for sign in (-1, 1):
            less = second + sign * (depth - 1e-6)[:, None] * direction
            assert (over(separation, first, less) <= 0.0).all()  # no side of either offers a shorter way
            more = second + sign * (depth + 1e-6)[:, None] * direction
            freed |= over(separation, first, more) > 0.0
    assert freed.all()


@pytest.fixture(scope="module")
def ways() -> tuple[np.ndarray, np.ndarray]:
    """Poses of 1500 pairs of vehicles near each other before and after a sub-step, shape (2, 3, n) each."""
    rng = np.random.default_rng(11)
    ranges = np.array([3.5, 3.5, 7.0])[:, None], np.array([4.0, 4.0, 0.5])[:, None]
    before, move = (rng.uniform(-most, most, (2, 3, 1500)) for most in ranges)
    return before, before + move


@pytest.mark.parametrize(("own", "other"), [(CAR, CAR), ((8.0, 1.25), (0.8, 0.3))])
def test_touches_on_the_way_equal_shapely_with_a_recall_of_999(ways, own: Half, other: Half) -> None:
    """Of two cars, and of a truck and a bicycle."""
    before, after = (poses[:, :, None] for poses in ways)
    looks = 200
    states = [rows(poses[i].T) for i in (0, 1) for poses in ways]
    every = list(zip(*states, strict=True))
    ours = np.array([touch_moment(a, b, c, d, other=other, own=own) for a, b, c, d in every])
    again = [touch_moment(c, d, a, b, other=own, own=other) for a, b, c, d in every]
    np.testing.assert_allclose(again, ours, atol=1e-9)

    def gaps_at(share: np.ndarray) -> np.ndarray:
        """Between the two of each pair on a share of the way, shape (looks, pairs)."""
        one, two = before + share * (after - before)
        found = np.hypot(*(two[:2] - one[:2])) - math.hypot(*own) - math.hypot(*other)  # at least
        near = found < 0.1
        (x, y, h), (a, b, g) = one[:, near], two[:, near]
        found[near] = shapely.distance(polygons(x, y, h, own), polygons(a, b, g, other))
        return found

    gaps = gaps_at(np.linspace(0.0, 1.0, looks + 1)[:, None])
    met, told = gaps.min(axis=0) == 0.0, np.isfinite(ours)
    grazed = met & (gaps[0] > 0.0) & (gaps[-1] > 0.0)
    assert 0.3 < met.mean() < 0.95 and grazed.sum() > 20  # contacts between two looks are among them
    assert met.sum() > 1000
    assert told[met].mean() >= 0.999
    longer = (gaps == 0.0).sum(axis=0) / looks >= FINEST
    assert told[met & longer].all()
    assert gaps_at(np.where(told, ours, 0.0)[None])[0, told].max() < 1e-6
    both = met & told
    assert np.abs(ours[both] - (gaps[:, both] == 0.0).argmax(axis=0) / looks).max() <= FINEST + 1e-4


def test_turning_the_short_way_through_the_half_turn() -> None:
    # Nobody turns: 2 pi apart is the same heading. A vehicle that spun round would touch.
    before, after = state(0.0, 0.0, math.pi - 0.01), state(0.0, 0.0, -math.pi - 0.01)
    assert touch_moment(before, after, state(0.0, 2.2), state(0.0, 2.2)) == math.inf


def test_who_stands_is_touched_by_the_end_of_a_long_vehicle_that_turns() -> None:
    stands, lorry = state(8.0, 3.15), (9.0, 1.25)  # 0.9 m beside it, of which its front comes 1.35 m aside
    assert 0.5 < touch_moment(state(0.0, 0.0), state(0.0, 0.0, 0.15), stands, stands, own=lorry) < 1.0


def test_the_first_touch_is_that_of_the_vehicle_that_is_met_first() -> None:
    ego, ego_after = state(0.0, 0.0), state(4.0, 0.0)
    others = [state(50.0, 0.0), state(8.0, 0.0), state(7.0, 1.0), state(0.0, 4.0)]
    assert first_touch(ego, ego_after, others, others, [CAR] * 4, CAR) == (2, pytest.approx(0.5))
    assert first_touch(ego, ego_after, others[:1], others[:1], [CAR], CAR) is None
    assert first_touch(ego, ego_after, [], [], [], CAR) is None


def test_the_state_between_is_that_of_the_moment() -> None:
    before, after = state(0.0, 0.0, 3.1, 19.0), state(2.0, 1.0, -3.1, 20.0)
    x, y, speed, heading = state_between(before, after, 0.25)
    assert (x, y, speed) == (0.5, 0.25, 20.0)
    assert heading == pytest.approx(3.1 + 0.25 * (2 * math.pi - 6.2))  # the short way


# -- time to collision, headway and density --------------------------------------------------------------------------

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
