"""Pictures: what stands where, in which colour."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from sumo_env import rendering
from sumo_env.config import COMMON
from sumo_env.driving import DrivingEnv
from sumo_env.networks.roads import highway, intersection, roundabout, two_way, u_turn
from sumo_env.rendering import draw
from sumo_env.rendering.notes import CRASH, EVENT, Mark, Notes
from sumo_env.rendering.pictures import RING
from sumo_env.rendering.scenery import FILM
from sumo_env.replica.env import ReplicaEnv
from sumo_env.scene import OBSTACLE as PREFIX
from sumo_env.scene import OBSTACLE_SIZE, Scene
from tests.sumo_env.rollout import drive

GROUND, ASPHALT, WHITE, _, EGO, FURTHER, OTHER, CRASHED, OBSTACLE, _, IN_EVENT = FILM
VIEW = {
    **COMMON,
    "screen_width": 400,
    "screen_height": 200,
    "scaling": 10.0,
    "centering_position": [0.25, 0.5],
}


def scene(*vehicles: tuple[float, float, float], crashed: tuple[int, ...] = (), time: float = 0.0) -> Scene:
    """Vehicles at (x, y, heading), the ego first."""
    x, y, heading = np.array(vehicles, dtype=float).T
    has_crashed = np.isin(np.arange(len(vehicles)), crashed)
    ids = ("ego", *(f"v{k}" for k in range(1, len(vehicles))))
    return Scene(ids, x, y, np.full(len(vehicles), 20.0), heading, has_crashed, time)


def pixel(
    picture: np.ndarray, x: float, y: float, ego: tuple[float, float] = (100.0, 4.0)
) -> tuple[int, ...]:
    """Colour at the world position (x, y) [m] of a `VIEW` around the ego."""
    column, row = 100 + 10.0 * (x - ego[0]), 100 + 10.0 * (y - ego[1])
    return tuple(picture[round(row), round(column)].tolist())


def test_the_road_its_edges_and_its_lines() -> None:
    picture = draw(scene((100, 4, 0)), highway(4), VIEW)
    assert picture.shape == (200, 400, 3)
    assert picture.dtype == np.uint8
    assert pixel(picture, 120, 4) == ASPHALT
    assert pixel(picture, 120, 12) == ASPHALT
    assert pixel(picture, 120, -3) == GROUND
    assert pixel(picture, 120, -2.15) == WHITE  # the left edge, unbroken
    edge = picture[round(100 + 10 * (-2.15 - 4))]
    assert (edge == WHITE).all()
    divider = picture[100 + 10 * (2 - 4)]
    assert 0.6 < (divider == WHITE).all(axis=1).mean() < 0.8  # 3 of 4.33 m


def marked(*marks: Mark) -> Notes:
    return Notes(marks)


def test_a_vehicle_is_marked_while_a_risk_event_acts_on_it() -> None:
    now = scene((100, 4, 0), (115, 4, 0))
    during = replace(now, in_event=frozenset({"v1"}))
    picture = draw(during, highway(4), VIEW, marked(Mark(EVENT, "v1", "")))
    assert pixel(picture, 114.5, 4) == pixel(picture, 115 + RING - 0.2, 4) == IN_EVENT
    after = draw(now, highway(4), VIEW)
    assert pixel(after, 114.5, 4) == OTHER
    assert pixel(after, 115 + RING - 0.2, 4) == ASPHALT


def test_the_ego_stands_where_it_is_centred_and_others_beside_it() -> None:
    picture = draw(scene((100, 4, 0), (115, 0, 0), (110, 8, 0), crashed=(2,)), highway(4), VIEW)
    assert pixel(picture, 99.5, 4) == EGO
    assert pixel(picture, 114.5, 0) == OTHER
    assert pixel(picture, 109.5, 8) == CRASHED
    # 5 m long, 2 m wide
    for dx, dy in ((2.3, 0.0), (-2.3, 0.0), (0.0, 0.9), (0.0, -0.9)):
        assert pixel(picture, 115 + dx, dy) != ASPHALT
    for dx, dy in ((2.8, 0.0), (-2.8, 0.0), (0.0, 1.3), (0.0, -1.3)):
        assert pixel(picture, 115 + dx, dy) == ASPHALT


def test_learning_cars_have_the_colour_of_the_ego_in_a_lighter_shade() -> None:
    now = replace(scene((100, 4, 0), (115, 4, 0), (110, 8, 0), crashed=(1,)), cars=2)
    picture = draw(now, highway(4), VIEW)
    assert [pixel(picture, x, y) for x, y in ((99.5, 4), (114.5, 4), (109.5, 8))] == [EGO, FURTHER, OTHER]


def test_an_obstacle_is_no_car() -> None:
    now = replace(
        scene((100, 4, 0), (115, 4, 0)), ids=("ego", f"{PREFIX}0"), sizes={f"{PREFIX}0": OBSTACLE_SIZE}
    )
    picture = draw(now, highway(4), VIEW)
    assert all(pixel(picture, 115 + dx, 4 + dy) == OBSTACLE for dx in (-0.7, 0.7) for dy in (-0.7, 0.7))
    assert pixel(picture, 116.3, 4) == ASPHALT


def test_headings_turn_clockwise_on_the_screen() -> None:
    """y points down: heading pi / 2 looks to the lower edge of the picture, where the headlights are."""
    picture = draw(scene((100, 4, 0), (120, 4, math.pi / 2)), highway(4), VIEW)
    assert pixel(picture, 120, 4 + 2.2) != ASPHALT
    assert pixel(picture, 122.2, 4) == ASPHALT
    front = picture[122, 290:310].astype(int).sum()
    back = picture[78, 290:310].astype(int).sum()
    assert front != back


@pytest.mark.parametrize("road", [highway(4), two_way(), roundabout(), intersection(), u_turn()], ids=repr)
def test_lanes_are_surfaced_from_end_to_end(road: Any) -> None:
    for lane in road.lanes.values():
        for s in (0.5, lane.length / 2, lane.length - 0.5):
            x, y = lane.position(s, 1.0)
            aside = (x - 20, y)
            picture = draw(scene((*aside, 0)), road, VIEW)
            assert pixel(picture, x, y, ego=aside) in (ASPHALT, WHITE)


def test_gaps_between_lanes_are_bridged() -> None:
    """highway-env's entries end 5.6 m short of the ring; cars are not to cross a meadow there."""
    road = roundabout()
    entry, ring = road.lane(("ses", "se", 0)), road.lane(("se", "ex", 1))
    (x0, y0), (x1, y1) = entry.position(entry.length, 0.0), ring.position(0.0, 0.0)
    assert math.hypot(x1 - x0, y1 - y0) > 5
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    picture = draw(scene((x - 8, y, 0)), road, VIEW)
    assert pixel(picture, x, y, ego=(x - 8, y)) == ASPHALT


def test_an_environment_that_has_drawn_a_picture_can_be_copied() -> None:
    env = ReplicaEnv("u-turn", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert (copy.deepcopy(env).render() == picture).all()


@pytest.mark.parametrize("action", [3, np.int64(3), np.array(3)], ids=repr)
def test_the_action_is_named(action: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """In any form that an agent may give it."""
    env = ReplicaEnv("highway", {"vehicles_count": 1}, render_mode="rgb_array")
    env.reset(seed=0)
    said: list[str] = []
    monkeypatch.setattr(
        rendering, "draw", lambda *arguments: said.append(arguments[3].lines[0][1].split()[-1])
    )
    env.render()
    env.step(action)
    env.render()
    assert said == ["m/s", "FASTER"]


def test_words_stand_above_their_ring_and_lines_in_the_corner() -> None:
    now = scene((100, 4, 0), (115, 4, 0))
    ring = draw(now, highway(4), VIEW, marked(Mark(EVENT, "v1", "")))
    named = draw(now, highway(4), VIEW, marked(Mark(EVENT, "v1", "brake")))
    rows, columns = np.nonzero((ring != named).any(axis=2))
    assert rows.size and rows.max() <= 103 - 10 * RING and 200 < columns.min() < 250 < columns.max() < 300
    told = draw(now, highway(4), VIEW, Notes(lines=(("", "1.0 s"), (CRASH, "crash with v1"))))
    rows, columns = np.nonzero((draw(now, highway(4), VIEW) != told).any(axis=2))
    assert rows.min() == columns.min() == 0 and 30 < rows.max() < 70 and columns.max() < 150


def test_the_bar_shows_how_much_of_the_time_is_over() -> None:
    for share in (0.0, 0.25, 1.0):
        bar = draw(scene((100, 4, 0)), highway(4), VIEW, Notes(share=share))[-1]
        assert (bar == WHITE).all(axis=1).mean() == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize("make", [DrivingEnv, partial(ReplicaEnv, scenarios="seeded")])
def test_notes_say_what_info_says(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Near misses, and with whom the ego crashes, in the last picture of each policy step."""
    config = {"risk": 1.0, "policy_frequency": 5, "simulation_frequency": 10}
    env = make("u-turn", config, render_mode="rgb_array")
    drawn: list[Any] = []
    monkeypatch.setattr(rendering, "draw", lambda *arguments: drawn.append(arguments[3]))
    found = set()
    for seed in range(4):
        for *_, info in drive(env, 1, seed=seed):
            env.render()
            kinds = [kind for kind, _ in drawn[-1].lines]
            assert ("near miss" in kinds) == info["near_miss"] and (CRASH in kinds) == info["crashed"]
            found |= {*kinds}
            if info["crashed"]:
                other = info["crash"]["other"]
                assert other in drawn[-1].lines[-1][1] and Mark(CRASH, other, other) in drawn[-1].marks
    assert {"", "near miss", CRASH} <= found
    env.close()
