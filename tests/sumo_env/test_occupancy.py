"""highway-env's OccupancyGrid: the original on the same traffic, and on SUMO."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers its environments)
import numpy as np
import pytest

import sumo_env  # noqa: F401  (likewise)
from tests.sumo_env.replica.pairs import EQUAL, SLOW, SLOW_EQUAL

GRID: dict[str, Any] = {"type": "OccupancyGrid"}
FEATURES = ["on_road", "presence", "x", "vx", "vy", "cos_h", "sin_h", "heading", "cos_d", "sin_d", "lat_off"]
GRIDS: list[dict[str, Any]] = [
    GRID,
    {
        **GRID, "features": FEATURES, "align_to_vehicle_axes": True, "grid_size": [[-40, 60], [-21, 20]],
        "grid_step": [3, 2], "features_range": {"vx": [-30, 30], "x": [-60, 60]},
    },
    {**GRID, "as_image": True, "features": ["presence", "on_road", "vx"]},
    {**GRID, "clip": False, "features_range": {"vy": [-2, 3]}},
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("grid", GRIDS, ids=range(len(GRIDS)))
@pytest.mark.parametrize("id", ["highway-fast-v0", "roundabout-v1", "intersection-v2", "u-turn-v1"])
def test_it_is_highway_env_s(id: str, grid: dict[str, Any]) -> None:
    """Every layer in every step of an episode, with its space, also in a bend and where cars come and go."""
    seen = np.zeros(len(grid.get("features", range(4))), bool)
    made: list[Any] = [
        gym.make(gym.spec(room + id), config={"observation": grid}) for room in ("", "replica/")
    ]
    theirs, ours = made
    assert theirs.observation_space == ours.observation_space
    for seed in range(2):
        rng, over, equal = np.random.default_rng(seed), False, EQUAL
        pair = theirs.reset(seed=seed)[0], ours.reset(seed=seed)[0]
        while not over:
            if min(abs(vehicle.speed) for vehicle in theirs.unwrapped.road.vehicles) < SLOW:
                equal = 1.0 if grid.get("as_image") else SLOW_EQUAL
            assert pair[0].dtype == pair[1].dtype
            np.testing.assert_allclose(pair[1].astype(float), pair[0].astype(float), rtol=1e-5, atol=equal)
            seen |= pair[1].reshape(len(seen), -1).any(axis=1)
            action = int(rng.integers(theirs.action_space.n))
            results = theirs.step(action), ours.step(action)
            pair, over = (results[0][0], results[1][0]), results[0][2] or results[0][3]
    names = grid.get("features", ["presence", "vx", "vy", "on_road"])
    nowhere = [name in ("cos_d", "sin_d") and "highway" in id for name in names]  # no destinations there
    assert (seen | nowhere).all()


def test_on_sumo_it_says_where_cars_are_and_how_fast() -> None:
    env: Any = gym.make("sumo/highway-v0", config={"observation": GRID, "vehicles_count": 20}).unwrapped
    grid, _ = env.reset(seed=2)
    for _ in range(6):
        grid = env.step(3)[0]
        assert env.observation_space.contains(grid) and grid.shape == (4, 11, 11)
        scene, cells = env.scene, np.zeros((11, 11))
        for x, y in zip(scene.x - scene.x[0], scene.y - scene.y[0], strict=True):
            if abs(x) < 27.5 and abs(y) < 27.5:
                cells[int((x + 27.5) // 5), int((y + 27.5) // 5)] = 1.0
        np.testing.assert_array_equal(grid[0], cells)
        assert grid[3].any(axis=0).sum() >= 3  # the road's lanes, two of which may share a row of cells
        assert (grid[1:3][:, cells == 0.0] == 0.0).all()
