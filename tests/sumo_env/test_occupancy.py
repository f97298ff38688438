"""highway-env's OccupancyGrid: the original on the same traffic, and on SUMO."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers its environments)
import numpy as np
import pytest
from highway_env.envs.common.observation import observation_factory

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
    {  # so coarse that cars share cells
        **GRID, "clip": False, "features_range": {"vy": [-2, 3]}, "grid_size": [[-61, 59], [-21.3, 18.7]],
        "grid_step": [40, 10],
    },
]  # fmt: skip


class All:
    """Looks at highway-env's environment as all of GRIDS do, at the moment when it looks itself."""

    def __init__(self, env: Any) -> None:
        self.kinds = [observation_factory(env, grid) for grid in GRIDS]

    def observe(self) -> list[np.ndarray]:
        return [kind.observe() for kind in self.kinds]


@pytest.mark.slow
@pytest.mark.parametrize("id", ["highway-fast-v0", "roundabout-v1", "intersection-v2", "u-turn-v1"])
def test_it_is_highway_env_s(id: str) -> None:
    """Every layer in every step of an episode, with its space, also in a bend and where cars come and go."""
    theirs: Any = gym.make(gym.spec(id), disable_env_checker=True).unwrapped
    ours: list[Any] = [gym.make(gym.spec(f"replica/{id}"), config={"observation": grid}) for grid in GRIDS]
    names = [grid.get("features", ["presence", "vx", "vy", "on_road"]) for grid in GRIDS]
    filled = [np.zeros(len(layers), bool) for layers in names]
    for seed in range(2):
        theirs.reset(seed=seed)
        theirs.observation_type = All(theirs)
        for kind, env in zip(theirs.observation_type.kinds, ours, strict=True):
            assert kind.space() == env.observation_space
        rng, over, equal = np.random.default_rng(seed), False, EQUAL
        expected, found = theirs.observation_type.observe(), [env.reset(seed=seed)[0] for env in ours]
        while not over:
            if min(abs(vehicle.speed) for vehicle in theirs.road.vehicles) < SLOW:
                equal = SLOW_EQUAL
            for grid, one, other, layers in zip(GRIDS, expected, found, filled, strict=True):
                assert one.dtype == other.dtype
                within = 1.0 if equal == SLOW_EQUAL and grid.get("as_image") else equal
                np.testing.assert_allclose(other.astype(float), one.astype(float), rtol=1e-5, atol=within)
                layers |= other.reshape(len(layers), -1).any(axis=1)
            action = int(rng.integers(theirs.action_space.n))
            expected, _, terminated, truncated, _ = theirs.step(action)
            found, over = [env.step(action)[0] for env in ours], terminated or truncated
    for layers, name in zip(filled, names, strict=True):
        nowhere = [each in ("cos_d", "sin_d") and "highway" in id for each in name]  # no destinations there
        assert (layers | nowhere).all()


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
