"""Contacts against shapely's polygons and highway-env's own test."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from highway_env import utils
from numba import njit

from sumo_env.collision import (
    contact,
    contacts,
    distance,
    meeting,
    meetings,
    scene_between,
    separation,
)
from sumo_env.scene import Scene

LENGTH, WIDTH = 5.0, 2.0


def rectangles(x, y, heading) -> np.ndarray:
    """Shapely polygons of vehicles; arrays of one shape."""
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [LENGTH / 2, WIDTH / 2]
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    along, across = corners[:, 0], corners[:, 1]
    points = np.stack(
        [x[..., None] + along * cos - across * sin, y[..., None] + along * sin + across * cos], axis=-1
    )
    return shapely.polygons(points)


@njit
def over_pairs(function, first, second):
    result = np.empty(len(first))
    for k in range(len(first)):
        result[k] = function(
            first[k, 0], first[k, 1], first[k, 2], second[k, 0], second[k, 1], second[k, 2], 5.0, 2.0
        )
    return result


@pytest.fixture(scope="module")
def pairs() -> tuple[np.ndarray, np.ndarray]:
    """10^5 pairs of poses (x, y, heading); a fifth of them with equal or perpendicular headings."""
    rng = np.random.default_rng(7)
    n = 100_000
    first = np.column_stack([rng.uniform(-50, 50, (n, 2)), rng.uniform(-7, 7, n)])
    turn = rng.uniform(-math.pi, math.pi, n)
    aligned = rng.random(n) < 0.2
    turn[aligned] = rng.integers(-2, 3, aligned.sum()) * math.pi / 2
    offset = rng.uniform(-7, 7, (n, 2))
    return first, np.column_stack([first[:, :2] + offset, first[:, 2] + turn])


def test_contact_and_distance_equal_shapely(pairs) -> None:
    first, second = pairs
    one, two = rectangles(*first.T), rectangles(*second.T)
    expected = shapely.distance(one, two)
    ours = over_pairs(distance, first, second)
    apart = expected > 1e-9
    assert 0.3 < apart.mean() < 0.8
    np.testing.assert_allclose(ours[apart], expected[apart], atol=1e-9)
    assert (ours[~apart] <= 1e-9).all()
    inside = shapely.area(shapely.intersection(one, two)) > 1e-9
    assert over_pairs(contact, first, second)[inside].all()


def test_separation_never_exceeds_the_distance(pairs) -> None:
    first, second = pairs
    assert (over_pairs(separation, first, second) <= over_pairs(distance, first, second) + 1e-12).all()


def test_penetration_is_the_shortest_way_out(pairs) -> None:
    first, second = (poses[:3000] for poses in pairs)
    depth = -over_pairs(distance, first, second)
    deep = depth > 0.01
    first, second, depth = first[deep], second[deep], depth[deep]
    freed = np.zeros(len(depth), dtype=bool)
    for axis in range(4):
        heading = (first if axis < 2 else second)[:, 2] + (axis % 2) * math.pi / 2
        direction = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(depth))])
        for sign in (-1, 1):
            less = second + sign * (depth - 1e-6)[:, None] * direction
            assert over_pairs(contact, first, less).all()  # no side of either offers a shorter way
            more = second + sign * (depth + 1e-6)[:, None] * direction
            freed |= over_pairs(contact, first, more) == 0
    assert freed.all()


def test_contact_equals_highway_env(pairs) -> None:
    first, second = (poses[:4000] for poses in pairs)
    ours = over_pairs(contact, first, second) > 0
    for k in range(len(first)):
        a, b = (
            np.vstack([corners := utils.rect_corners(pose[:2], LENGTH, WIDTH, pose[2]), corners[:1]])
            for pose in (first[k], second[k])
        )
        assert utils.are_polygons_intersecting(a, b, np.zeros(2), np.zeros(2))[0] == ours[k]


def test_touching_is_contact() -> None:
    assert contact(0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 5.0, 2.0)
    assert contact(0.0, 0.0, 0.0, 0.0, 2.0, math.pi, 5.0, 2.0)
    assert not contact(0.0, 0.0, 0.0, 5.0 + 1e-9, 0.0, 0.0, 5.0, 2.0)


def test_contacts_lists_every_pair_of_a_pile_up() -> None:
    rng = np.random.default_rng(3)
    x, y, heading = rng.uniform(0, 12, 30), rng.uniform(0, 12, 30), rng.uniform(-4, 4, 30)
    shapes = rectangles(x, y, heading)
    i, j = np.triu_indices(30, 1)
    expected = np.column_stack([i, j])[shapely.intersects(shapes[i], shapes[j])]
    assert len(expected) > 60  # more than there are vehicles
    np.testing.assert_array_equal(contacts(x, y, heading, np.ones(30, dtype=bool)), expected)
    active = rng.random(30) < 0.5
    among = expected[active[expected].any(axis=1)]
    np.testing.assert_array_equal(contacts(x, y, heading, active), among)


def test_an_empty_road_has_no_contacts() -> None:
    none = np.empty(0)
    assert contacts(none, none, none, np.empty(0, dtype=bool)).shape == (0, 2)


@pytest.fixture(scope="module")
def ways() -> tuple[np.ndarray, np.ndarray]:
    """Poses of 4000 pairs of vehicles before and after a sub-step, shape (2, 3, n) each."""
    rng = np.random.default_rng(11)
    n = 4000
    before = np.stack(
        [rng.uniform(-6, 6, (2, n)), rng.uniform(-6, 6, (2, n)), rng.uniform(-7, 7, (2, n))], axis=1
    )
    move = np.stack(
        [rng.uniform(-4, 4, (2, n)), rng.uniform(-4, 4, (2, n)), rng.uniform(-0.5, 0.5, (2, n))], axis=1
    )
    return before, before + move


def test_meetings_equal_shapely_on_the_way(ways) -> None:
    before, after = ways
    looks = 400
    ours = np.array(
        [meeting(0, 1, before[:, :, k].T.copy(), *after[:, :, k].T) for k in range(before.shape[2])]
    )
    gaps = np.array(
        [
            shapely.distance(*(rectangles(*pose) for pose in before + look / looks * (after - before)))
            for look in range(looks + 1)
        ]
    )
    met = gaps.min(axis=0) == 0.0
    grazed = met & (gaps[0] > 0.0) & (gaps[-1] > 0.0)
    assert 0.3 < met.mean() < 0.9 and grazed.sum() > 20  # contacts between two looks are among them
    shorter = (gaps == 0.0).sum(axis=0) / looks < 0.01  # may be missed: see FINEST
    assert np.isfinite(ours[met & ~shorter]).all()
    assert (gaps.min(axis=0)[np.isfinite(ours)] < 0.03).all()  # none where shapely sees a gap all the way
    both = met & np.isfinite(ours)
    assert np.abs(ours[both] - (gaps[:, both] == 0.0).argmax(axis=0) / looks).max() <= 0.0101


def test_a_contact_between_two_looks_is_found() -> None:
    # the ego stands, the other's corner passes by the ego's within the step
    before = np.array([[0.0, 2.4], [0.0, -4.2], [0.0, -math.pi / 4]])
    x, y, heading = np.array([0.0, 6.0]), np.array([0.0, -0.6]), np.array([0.0, -math.pi / 4])
    everybody = np.ones(2, dtype=bool)
    assert len(contacts(*before, everybody)) == 0 and len(contacts(x, y, heading, everybody)) == 0
    pairs, [moment] = meetings(before, x, y, heading, everybody)
    assert pairs.tolist() == [[0, 1]] and 0.0 < moment < 1.0
    half = before + moment * (np.array([x, y, heading]) - before)
    assert contacts(*half, everybody).tolist() == [[0, 1]]


def test_cars_that_exchange_their_places_within_a_step_meet() -> None:
    before = np.array([[0.0, 8.0], [0.0, 0.0], [0.0, math.pi]])
    [moment] = meetings(before, np.array([8.0, 0.0]), np.zeros(2), before[2], np.ones(2, dtype=bool))[1]
    assert moment == pytest.approx(3.0 / 16.0, abs=1e-9)  # 3 m between the bumpers, 16 m travelled


def test_cars_side_by_side_do_not_meet() -> None:
    before = np.array([[0.0, 1.0], [0.0, 2.001], [0.0, 0.0]])
    assert len(meetings(before, np.array([3.0, 4.5]), before[1], before[2], np.ones(2, dtype=bool))[0]) == 0


def test_wrecks_do_not_meet_again() -> None:
    before = np.array([[0.0, 6.0, 6.5], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    active = np.array([True, False, False])
    pairs, _ = meetings(before, np.array([2.0, 6.0, 6.5]), before[1], before[2], active)
    assert pairs.tolist() == [[0, 1], [0, 2]]


def test_turning_the_short_way_through_the_half_turn() -> None:
    # nobody turns: 2 pi apart is the same heading, and a car that spun round would touch
    before = np.array([[0.0, 0.0], [0.0, 2.2], [math.pi - 0.01, 0.0]])
    after = np.array([-math.pi - 0.01, 0.0])
    everybody = np.ones(2, dtype=bool)
    assert len(meetings(before, before[0], before[1], after, everybody)[0]) == 0


def test_the_scene_between_is_that_of_the_moment() -> None:
    scene = Scene(
        ids=("ego", "v0"),
        x=np.array([2.0, 10.0]),
        y=np.array([0.0, 1.0]),
        speed=np.array([20.0, 0.0]),
        heading=np.array([-3.1, 0.0]),
        crashed=np.zeros(2, dtype=bool),
        time=1.1,
    )
    before = np.array([[0.0, 10.0], [0.0, 1.0], [3.1, 0.0]])
    moment = scene_between(before, scene, 0.25, 0.1)
    assert moment.x.tolist() == [0.5, 10.0] and moment.time == pytest.approx(1.025)
    assert moment.heading[0] == pytest.approx(3.1 + 0.25 * (2 * math.pi - 6.2))  # the short way
    assert scene_between(before, scene, 1.0, 0.1).time == 1.1
