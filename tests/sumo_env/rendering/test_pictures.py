"""Pictures: what stands where, in which colour."""

import math
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

import sumo_env
from sumo_env import rendering
from sumo_env.config import COMMON
from sumo_env.env import DrivingEnv
from sumo_env.networks.roads import highway, intersection, roundabout, two_way, u_turn
from sumo_env.rendering import draw
from sumo_env.rendering.labels import Box, beside
from sumo_env.rendering.notes import CRASH, EVENT, NEAR_MISS, Mark, Notes, notes
from sumo_env.rendering.pictures import RING
from sumo_env.rendering.scenery import FILM, HIGHWAY_ENVS, _colour
from sumo_env.replica.env import ReplicaEnv
from sumo_env.scene import OBSTACLE as PREFIX
from sumo_env.scene import OBSTACLE_SIZE, Scene
from sumo_env.simulator import EgoStep
from tests.sumo_env.rollout import drive

GROUND, ASPHALT, WHITE, _, EGO, FURTHER, OTHER, CRASHED, OBSTACLE, _, IN_EVENT = FILM
EGO_AT = {"centering_position": [0.25, 0.5]}  # of the picture
VIEW = {**COMMON, **EGO_AT, "screen_width": 400, "screen_height": 200, "scaling": 10.0}


def scene(*vehicles: tuple[float, float, float], crashed: tuple[int, ...] = ()) -> Scene:
    """Vehicles at (x, y, heading), the ego first."""
    x, y, heading = np.array(vehicles, dtype=float).T
    has_crashed = np.isin(np.arange(len(vehicles)), crashed)
    ids = ("ego", *(f"v{k}" for k in range(1, len(vehicles))))
    return Scene(ids, x, y, np.full(len(vehicles), 20.0), heading, has_crashed, 0.0)


def pixel(picture: np.ndarray, x: float, y: float, ego=(100.0, 4.0)) -> tuple[int, ...]:
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


@pytest.mark.parametrize(("x", "is_named"), [(127.0, True), (128.0, False)])
def test_a_car_that_the_picture_cuts_off_has_a_ring_and_no_word(x: float, is_named: bool) -> None:
    """The picture ends at x = 130 m: the word would stand beside another car."""
    now = scene((100, 4, 0), (x, 4, 0))
    word, ring = (draw(now, highway(4), VIEW, marked(Mark(EVENT, "v1", text))) for text in ("surge", ""))
    assert (word != ring).any() == is_named and pixel(ring, x - RING + 0.2, 4) == IN_EVENT


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


def test_learning_cars_and_obstacles_have_a_colour_and_size_of_their_own() -> None:
    box = f"{PREFIX}0"
    now = replace(scene((100, 4, 0), (115, 4, 0), (110, 8, 0), crashed=(1,)), cars=2)
    picture = draw(replace(now, ids=("ego", "v1", box), sizes={box: OBSTACLE_SIZE}), highway(4), VIEW)
    assert [pixel(picture, x, y) for x, y in ((99.5, 4), (114.5, 4), (109.3, 8))] == [EGO, FURTHER, OBSTACLE]
    assert pixel(picture, 108.7, 8) == ASPHALT
    assert _colour(scene((100, 4, 0), crashed=(0,)), 0, HIGHWAY_ENVS) == HIGHWAY_ENVS.crashed


@pytest.mark.parametrize(("gap", "text"), [(5.0, "0.3 s"), (22.49, "1.4 s"), (30.0, None)])
def test_who_would_be_hit_first_is_marked_with_the_time_of_this_moment(gap: float, text: str | None) -> None:
    """Whatever the policy step has met; what is less than 1.5 s never reads as 1.5 s."""
    near = replace(scene((100, 4, 0), (105 + gap, 4, 0), (140, 4, 0)), speed=np.array([20.0, 5.0, 5.0]))
    scenario, step = cast(Any, SimpleNamespace(events=())), EgoStep(("a", "b", 0), None, 0.1, 9.0)
    said = notes(near, scenario, step, "", 40.0)
    assert said.marks == (() if text is None else (Mark(NEAR_MISS, "v1", text),))
    assert said.lines[1:] == (() if text is None else ((NEAR_MISS, f"near miss: {text}"),))


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


@pytest.mark.parametrize("action", [3, np.int64(3), np.array(3)], ids=repr)
def test_the_action_is_named(action: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """In any form that an agent may give it."""
    env = ReplicaEnv("highway", {"vehicles_count": 1}, render_mode="rgb_array")
    env.reset(seed=0)
    said: list[str] = []
    monkeypatch.setattr(rendering, "draw", lambda *arguments: said.append(arguments[3].lines[0][1]))
    env.render()
    env.step(action)
    env.render()
    assert [line.split()[-1] for line in said] == ["m/s", "FASTER"]


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
            assert all(mark.text for mark in drawn[-1].marks if mark.kind == EVENT)
            assert (NEAR_MISS in kinds) <= info["near_miss"] and (CRASH in kinds) == info["crashed"]
            found |= {*kinds}
            if info["crashed"]:
                other = info["crash"]["other"]
                assert other in drawn[-1].lines[-1][1] and Mark(CRASH, other, other) in drawn[-1].marks
    assert {"", NEAR_MISS, CRASH} <= found


@pytest.mark.parametrize("id", sumo_env.IDS)
def test_every_task_renders_in_its_size(id: str) -> None:
    env = gym.make(id, render_mode="rgb_array")
    env.reset(seed=0)
    env.step(1)
    picture = np.asarray(env.render())
    config = env.get_wrapper_attr("config")
    assert picture.shape == (config["screen_height"], config["screen_width"], 3)
    colours = {tuple(colour) for colour in picture.reshape(-1, 3).tolist()}
    assert {FILM.ground, FILM.asphalt, FILM.line, FILM.ego, FILM.other} <= colours


def filmed(mode: str | None) -> Any:
    return gym.make("sumo/highway-v0", render_mode=mode, config={"vehicles_count": 5})


def test_without_a_render_mode_there_is_a_warning_and_no_picture() -> None:
    env = filmed(None)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="rgb_array"):
        assert env.unwrapped.render() is None


@pytest.mark.parametrize("by_substep", [False, True])
def test_films(tmp_path: Path, by_substep: bool) -> None:
    env = RecordVideo(filmed("rgb_array"), str(tmp_path / "films"), episode_trigger=lambda episode: True)
    unwrapped: Any = env.unwrapped
    if by_substep:
        unwrapped.set_record_video_wrapper(env)
        unwrapped.configure({"simulation_frequency": 20})
    env.reset(seed=0)
    env.step(1)
    env.step(1)
    assert len(env.recorded_frames) == (1 + 2 * 20 if by_substep else 1 + 2)
    assert env.frames_per_sec == (20 if by_substep else 5)
    frames = np.array(env.recorded_frames)
    assert all((a != b).any() for a, b in pairwise(frames))
    env.close()
    assert (tmp_path / "films" / "rl-video-episode-0.mp4").stat().st_size > 1000
    assert sumo_env.env.DrivingEnv.metadata["render_fps"] == 5  # of the class: untouched


@pytest.mark.parametrize("make", [DrivingEnv, partial(ReplicaEnv, scenarios="seeded")])
def test_a_film_stops_at_the_contact_and_the_next_episode_goes_on(make: Any) -> None:
    """The step goes on in the simulation, to its end, where cars have passed through each other."""
    env = make("u-turn", {"risk": 1.0, "simulation_frequency": 10}, render_mode="rgb_array")
    shown: list[Scene] = []
    film = SimpleNamespace(recording=True, _capture_frame=lambda: shown.append(env.pictured))
    env.set_record_video_wrapper(film)
    *_, (*_, info) = drive(env, 1, seed=0)
    assert info["crashed"] and not any(each.crashed[0] for each in shown)
    assert env.pictured.crashed[0] and not env.scene.time % 1.0
    assert info["crash"]["time"] <= env.pictured.time < info["crash"]["time"] + 0.101 < env.scene.time
    env.reset(seed=1)
    assert env.pictured is env.scene


# -- words beside cars -------------------------------------------------------------------------------------------------

PICTURE = Box(0.0, 0.0, 280.0, 200.0)
SIZE = 60.0, 20.0  # [px] of a word
CAR = 24.0, 10.0  # [px]
CORNER = Box(0.0, 0.0, 180.0, 26.0)  # where the time and the speed stand
REACH = 18.0  # [px] of a ring


@pytest.mark.parametrize("seed", range(40))
def test_words_cover_neither_the_ego_nor_each_other_and_are_not_cut_off(seed: int) -> None:
    """Of cars in a jam around the ego, which is where they would."""
    rng = np.random.default_rng(seed)
    others = rng.uniform((80.0, 50.0), (200.0, 150.0), (rng.integers(1, 6), 2)).tolist()
    middles = [(140.0, 100.0), *((x, y) for x, y in others)]
    cars = [Box.around(x, y, *CAR) for x, y in middles]
    words = [CORNER]
    for middle in middles[1:]:
        words.append(beside(middle, REACH, SIZE, PICTURE, words, cars))
    for one, other in combinations((cars[0], *words), 2):
        assert one.common(other) == 0.0
    for word in words:
        assert word.common(PICTURE) == pytest.approx((word.right - word.left) * (word.bottom - word.top))


def test_a_word_stands_above_its_car_where_there_is_room_else_below_else_beside() -> None:
    ego, alone = Box.around(20.0, 100.0, *CAR), (140.0, 100.0)
    above = Box.around(140.0, 100.0 - REACH - 10.0, *SIZE)
    below = Box.around(140.0, 100.0 + REACH + 10.0, *SIZE)
    right = Box.around(140.0 + REACH + 30.0, 100.0, *SIZE)
    for number, place in enumerate((above, below, right)):
        assert beside(alone, REACH, SIZE, PICTURE, (above, below)[:number], [ego]) == place
