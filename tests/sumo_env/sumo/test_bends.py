"""In bends SUMO's lanes are longer or shorter than the road: the ego covers on the road what it commands."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import pytest

from sumo_env.replica.env import ReplicaEnv

IDLE, FASTER = 1, 3


@pytest.mark.parametrize(("task", "tolerance"), [("u-turn", 1.0), ("roundabout", 2.0)])
@pytest.mark.parametrize("action", [IDLE, FASTER])
def test_alone_in_a_bend_the_ego_drives_as_in_highway_env(task: str, tolerance: float, action: int) -> None:
    """tolerance [m]: SUMO lays a vehicle on a chord, and a change of the ring's lanes takes its own time."""
    config = {"vehicles_count": 0}
    ours: Any = gym.make(f"sumo/{task}-v0", config=config)
    reference: Any = ReplicaEnv(task, config, scenarios="seeded")
    for env in (ours, reference):
        env.reset(seed=0)
    ended, way = False, 0.0
    while not ended:
        *_, ended, cut, info = ours.step(action)
        *_, ends, cuts, _ = reference.step(action)
        ended = ended or cut or ends or cuts
        way += info["distance"]
        if not ended:
            one, other = ours.unwrapped.scene, reference.unwrapped.scene
            apart = math.hypot(one.x[0] - other.x[0], one.y[0] - other.y[0])
            assert apart < tolerance, (
                f"after {way:.0f} m the ego is {apart:.2f} m from where it is in highway-env"
            )
    assert way > 60.0
    ours.close()
