"""Time to collision against stepping through time with shapely; headway and density by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from sumo_env.safety import density, ego_ttc, headways, min_ttc, pair_ttc, time_to_collision

HORIZON = 4.0
STEP = 0.02


def rectangles(x, y, heading) -> np.ndarray:
    corners = np.array([[2.5, 1], [2.5, -1], [-2.5, -1], [-2.5, 1]])
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    along, across = corners[:, 0], corners[:, 1]
    points = np.stack(
        [x[..., None] + along * cos - across * sin, y[..., None] + along * sin + across * cos], axis=-1
    )
    return shapely.polygons(points)


@pytest.fixture(scope="module")
def traffic() -> dict[str, np.ndarray]:
    """An ego and 1500 others; some are parallel to it, touch it or stand still, two thirds meet it."""
    rng = np.random.default_rng(11)
    n = 1501
    heading = rng.uniform(-math.pi, math.pi, n)
    heading[: n // 5] = heading[0]
    speed = rng.uniform(0, 25, n)
    speed[n // 2 : n // 2 + 100] = 0.0
    state = {"x": rng.uniform(-50, 50, n), "y": rng.uniform(-50, 50, n), "heading": heading}
    state["x"][0], state["y"][0], speed[0] = 1.0, -2.0, 14.0
    state |= {"vx": speed * np.cos(heading), "vy": speed * np.sin(heading)}
    near = slice(n // 3, n)  # their centres pass within 5 m or so; a heading need not be the way one moves
    when = rng.uniform(0.3, HORIZON, n)[near]
    for at, rate in (("x", "vx"), ("y", "vy")):
        place = state[at][0] + state[rate][0] * when + rng.uniform(-4, 4, len(when))
        state[rate][near] = (place - state[at][near]) / when
    return state


def ttc(state: dict[str, np.ndarray], horizon: float = HORIZON) -> np.ndarray:
    return time_to_collision(*(state[k] for k in ("x", "y", "vx", "vy", "heading")), 0, horizon)


def test_equals_stepping_through_time(traffic) -> None:
    times = np.arange(0.0, HORIZON, STEP)
    x = traffic["x"][:, None] + traffic["vx"][:, None] * times
    y = traffic["y"][:, None] + traffic["vy"][:, None] * times
    shapes = rectangles(x, y, np.broadcast_to(traffic["heading"][:, None], x.shape))
    touching = shapely.intersects(shapes[1:], shapes[:1])
    first = np.where(touching.any(axis=1), times[touching.argmax(axis=1)], np.inf)
    ours = ttc(traffic)[1:]
    assert 0.1 < np.isfinite(first).mean() < 0.9
    assert (ours <= first + 1e-9).all()  # never later than the first sample in contact
    seen = np.isfinite(first)
    # ... and at most one step earlier, except for grazes that begin and end between two samples
    assert (first[seen] - ours[seen] < STEP + 1e-9).mean() > 0.995
    assert np.isfinite(ours[~seen]).mean() < 0.02


def test_at_that_time_they_touch_and_before_they_do_not(traffic) -> None:
    ours = ttc(traffic)
    hits = np.flatnonzero(np.isfinite(ours) & (ours > 0))
    assert len(hits) > 200
    for share, touch in ((1.0, True), (0.999, False), (0.5, False)):
        t = ours[hits] * share

        def at(rows, t=t):
            return rectangles(
                traffic["x"][rows] + traffic["vx"][rows] * t,
                traffic["y"][rows] + traffic["vy"][rows] * t,
                np.broadcast_to(traffic["heading"][rows], t.shape),
            )

        gap = shapely.distance(at(hits), at(np.zeros_like(hits)))
        assert (gap < 1e-8).all() if touch else (gap > 0).all()


def test_contact_is_zero_and_oneself_is_never_met(traffic) -> None:
    ours = ttc(traffic)
    shapes = rectangles(traffic["x"], traffic["y"], traffic["heading"])
    touching = shapely.intersects(shapes[1:], shapes[0])
    assert touching.any()
    np.testing.assert_array_equal(ours[1:] == 0.0, touching)
    assert ours[0] == np.inf


def pair(dx: float, dy: float, v: float, w: float, turn: float = 0.0) -> list[np.ndarray]:
    heading = np.array([0.0, turn])
    speed = np.array([v, w])
    return [
        np.array([0.0, dx]),
        np.array([0.0, dy]),
        speed * np.cos(heading),
        speed * np.sin(heading),
        heading,
    ]


def test_textbook_cases() -> None:
    assert min_ttc(*pair(25.0, 0.0, 20.0, 10.0), 0, 10.0) == pytest.approx(2.0)  # (25 - 5) / (20 - 10)
    assert min_ttc(*pair(25.0, 1.9, 20.0, 10.0), 0, 10.0) == pytest.approx(2.0)  # sides overlap by 0.1 m
    assert min_ttc(*pair(25.0, 2.1, 20.0, 10.0), 0, 10.0) == math.inf  # next to each other
    assert min_ttc(*pair(25.0, 0.0, 10.0, 20.0), 0, 10.0) == math.inf  # the leader is faster
    assert min_ttc(*pair(65.0, 0.0, 20.0, 10.0, math.pi), 0, 10.0) == pytest.approx(2.0)  # head on
    assert min_ttc(*pair(20.0, -20.0, 10.0, 10.0, math.pi / 2), 0, 10.0) == pytest.approx(1.65)  # crossing
    assert min_ttc(*pair(30.0, 0.0, 0.0, 0.0), 0, 10.0) == math.inf


def test_nothing_counts_beyond_the_horizon() -> None:
    assert min_ttc(*pair(25.0, 0.0, 20.0, 10.0), 0, 1.9) == math.inf
    assert time_to_collision(*pair(25.0, 0.0, 20.0, 10.0), 0, 2.1)[1] == pytest.approx(2.0)


def test_pairs_and_minimum_agree_with_the_ego_alone(traffic) -> None:
    some = {name: values[:60] for name, values in traffic.items()}
    arrays = [some[k] for k in ("x", "y", "vx", "vy", "heading")]
    everyone = pair_ttc(*arrays, HORIZON)
    assert np.isinf(everyone[np.tril_indices(60)]).all()
    for ego in range(0, 60, 7):
        alone = time_to_collision(*arrays, ego, HORIZON)
        np.testing.assert_allclose(np.minimum(everyone[ego], everyone[:, ego]), alone, rtol=1e-12)
        assert min_ttc(*arrays, ego, HORIZON) == pytest.approx(alone.min())


def test_time_to_collision_does_not_depend_on_the_frame(traffic) -> None:
    angle, shift, drift = 0.7, (30.0, -4.0), (5.0, 3.0)
    cos, sin = math.cos(angle), math.sin(angle)
    turned = {
        "x": cos * traffic["x"] - sin * traffic["y"] + shift[0],
        "y": sin * traffic["x"] + cos * traffic["y"] + shift[1],
        "vx": cos * traffic["vx"] - sin * traffic["vy"] + drift[0],
        "vy": sin * traffic["vx"] + cos * traffic["vy"] + drift[1],
        "heading": traffic["heading"] + angle,
    }
    np.testing.assert_allclose(ttc(turned), ttc(traffic), atol=1e-6)


def test_headway_is_to_the_nearest_in_the_corridor() -> None:
    x = np.array([0.0, 30.0, 20.0, 25.0, -10.0, 95.0])
    y = np.array([0.0, 0.5, 2.5, -1.9, 0.0, 0.0])
    speed = np.array([10.0, 20.0, 0.0, 10.0, 10.0, 10.0])
    ours = headways(x, y, speed, np.zeros(6))
    # the third is beside the corridor of the first and stands; 95 is more than 60 m ahead of 30
    assert ours == pytest.approx([2.0, math.inf, math.inf, math.inf, 0.5, math.inf])


def test_headway_follows_the_heading() -> None:
    x, y = np.array([0.0, 0.0, 0.0]), np.array([0.0, -15.0, 15.0])
    ours = headways(x, y, np.full(3, 5.0), np.full(3, -math.pi / 2))  # all drive north, y is down
    assert ours == pytest.approx([2.0, math.inf, 2.0])


def test_density_counts_the_others_within_the_radius() -> None:
    x, y = np.array([0.0, 199.9, -150.0, 150.0]), np.array([0.0, 0.0, 150.0, 100.0])
    assert density(x, y, 0, 200.0) == 2
    assert density(x[:1], y[:1], 0, 200.0) == 0


def test_the_time_of_the_ego_is_the_least_of_all_bit_for_bit() -> None:
    rng = np.random.default_rng(5)
    found = 0
    for _ in range(2000):
        n = int(rng.integers(1, 12))
        x, y = rng.uniform(-150, 150, n), rng.uniform(-12, 12, n)
        speed, heading = rng.uniform(-1, 35, n), rng.normal(0, 0.3, n) + rng.choice([0.0, math.pi], n)
        vx, vy = speed * np.cos(heading), speed * np.sin(heading)
        least = min_ttc(x, y, vx, vy, heading, 0, 10.0)
        assert ego_ttc(x, y, speed, heading, 10.0) == least
        found += least < math.inf
    assert 200 < found < 1800
