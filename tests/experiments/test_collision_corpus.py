"""The truth that detectors are held against, and a small corpus."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import shapely

from experiments.collision_corpus import PARTS, Options, between, polygons, run, summarise
from sumo_env.collision import SUMO_TOLERANCE
from sumo_env.env import DrivingEnv
from sumo_env.world import World


def test_a_polygon_is_a_car() -> None:
    [car] = polygons(np.array([[3.0, -2.0, math.pi / 2]]))
    assert car.area == pytest.approx(10.0)
    assert car.bounds == pytest.approx((2.0, -4.5, 4.0, 0.5))  # 5 m long, turned to +y


def test_the_way_between_two_poses_turns_the_short_way_and_ends_at_the_second() -> None:
    way = between((0.0, 0.0, 3.0), (2.0, 0.0, -3.0))
    assert way.shape == (PARTS, 3)
    assert np.abs(np.diff(way[:, 2])).max() < 0.1
    assert way[-1, 0] == pytest.approx(2.0)
    assert math.cos(way[-1, 2]) == pytest.approx(math.cos(-3.0))


def test_a_curved_way_follows_the_bend() -> None:
    turn = 0.2
    end = [20.0 * math.cos(turn), 20.0 * math.sin(turn), math.pi / 2 + turn]
    straight, curved = (
        between([20.0, 0.0, math.pi / 2], end, curved=curved)[:, :2] for curved in (False, True)
    )
    assert np.hypot(*straight.T).min() == pytest.approx(20.0 * math.cos(turn / 2), abs=0.001)
    np.testing.assert_allclose(np.hypot(*curved.T), 20.0, atol=0.002)
    assert curved[-1] == pytest.approx(straight[-1])


def test_a_contact_between_two_sub_steps_is_part_of_the_truth() -> None:
    car = np.tile([0.0, 0.0, 0.0], (PARTS, 1))
    crossing = between((2.4, -3.6, -math.pi / 4), (5.2, -1.0, -math.pi / 4))
    gaps = shapely.distance(polygons(car), polygons(crossing))
    assert gaps.min() < gaps[-1]


def test_recall_and_precision() -> None:
    corpus = pd.DataFrame(
        {
            "task": "u-turn",
            "who": "ego",
            "contact": [True, True, False, False],
            "type": ["side", "rear-end", "none", "none"],
            "closest": [0.0, 0.0, 0.4, 0.1],
            "curved_contact": [True, False, False, False],
            "sumo": [True, False, True, False],
            "steps": [True, False, False, False],
            "geometry": [True, True, False, False],
            "sumo_gap": [0.0, math.nan, 0.4, math.nan],
        }
    )
    table = summarise(corpus).set_index(["type", "detector"])
    assert table.loc[("all", "SUMO"), ["recall", "precision", "false"]].tolist() == [0.5, 0.5, 1]
    assert table.loc[("all", "SUMO"), "worst_false_distance"] == 0.4
    assert table.loc[("rear-end", "geometry every 0.1 s"), "recall"] == 0.0
    assert table.loc[("all", "together"), ["recall", "precision"]].tolist() == [1.0, 1.0]
    assert table.loc[("all", "together"), "false"] == 0  # SUMO's report from 0.4 m does not count
    assert table.loc[("all", "SUMO"), "curved_recall"] == 1.0


def _corners(poses: np.ndarray) -> np.ndarray:
    return shapely.get_coordinates(polygons(poses)).reshape(len(poses), 5, 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "actions"),
    [("highway", (1, 2, 1, 0)), ("roundabout", (3, 1, 1, 1, 1)), ("u-turn", (3, 1, 2, 1, 0, 1, 1))],
)
def test_the_straight_way_is_close_to_that_of_a_finer_simulation(
    task: str, actions: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    env = DrivingEnv(task, {"simulation_frequency": 100})
    draw = env.task.scenario
    env.task = type(env.task)()
    env.task.scenario = lambda config, seed: replace(  # type: ignore[method-assign]
        draw(config, seed), vehicles=(), spawns=(), events=()
    )
    poses: list[tuple[float, float, float]] = []
    look = World._look_for_contacts

    def record(world: World, touching: int, ttc: float) -> None:
        look(world, touching, ttc)
        poses.append((world.x[0], world.y[0], world.heading[0]))

    monkeypatch.setattr(World, "_look_for_contacts", record)
    monkeypatch.setattr(World, "_undisturbed", lambda world, most: 0)
    env.reset(seed=1)
    for action in actions:
        env.step(action)
    env.close()
    driven = np.array(poses)
    assert len(driven) == 100 * len(actions)
    off = []
    for start in range(len(driven) - 10):
        way = between(driven[start], driven[start + 10])[1::2]  # every 0.01 s
        off.append(np.linalg.norm(_corners(way) - _corners(driven[start + 1 : start + 11]), axis=-1).max())
    # [m] docs/collisions.md; most where a lane change begins, and the car turns within a twentieth of a second
    assert max(off) < 0.36 and np.quantile(off, 0.95) < 0.05


@pytest.mark.slow
def test_together_the_detectors_notice_every_contact_and_no_other(tmp_path: Path) -> None:
    assert run(Options(tmp_path, tasks=("roundabout", "intersection"), cases=80)) == 0
    table = pd.read_csv(tmp_path / "detection.csv")
    mine = table[(table["type"] == "all") & (table["who"] == "ego")].set_index(["task", "detector"])
    for task in ("roundabout", "intersection"):
        together = mine.loc[(task, "together")]
        assert together["contacts"] > 30
        assert together["recall"] == 1.0
        assert not together["worst_false_distance"] > SUMO_TOLERANCE
        assert mine.loc[(task, "SUMO"), "recall"] > 0.8  # it is asked, and answers
    assert (tmp_path / "detection.png").stat().st_size > 0
