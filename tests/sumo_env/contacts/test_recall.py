"""Are the crashes of an episode the contacts that there really were? The truth is measured with shapely, every 5 ms.

An ego that acts at random drives through regular and risky traffic. What the simulator says about it (`Step.crash`, the
crashed vehicles of the scene) is compared with the distance of polygons along the trajectories between two sub-steps.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import compress, pairwise
from typing import Any

import numpy as np
import pytest
import shapely

from sumo_env.env import DrivingEnv
from sumo_env.scene import Scene
from sumo_env.sumo.world import SumoSimulator
from sumo_env.tasks import TASKS
from tests.sumo_env.rollout import drive

from .shapes import polygons

PARTS = 20  # of a sub-step of 0.1 s
REACH = 12.0  # [m] between centres, beyond which two vehicles cannot touch within a sub-step
TOUCHING = 0.1  # [m] SUMO's own reports count within it


def way(before: Scene, after: Scene, name: str) -> np.ndarray:
    """Poses of a vehicle in a sub-step, evenly from the first to the last, shape (PARTS, 3)."""
    rows = [(scene, scene.ids.index(name)) for scene in (before, after)]
    first, last = (np.array([scene.x[row], scene.y[row], scene.heading[row]]) for scene, row in rows)
    last[2] = first[2] + (last[2] - first[2] + math.pi) % (2 * math.pi) - math.pi
    return first + np.linspace(1 / PARTS, 1, PARTS)[:, None] * (last - first)


@dataclass
class Truth:
    """Contacts of an episode: vehicle (of the ego) or pair (of others) -> time of the first one [s]."""

    ego: dict[str, float] = field(default_factory=dict)
    others: dict[tuple[str, str], float] = field(default_factory=dict)
    nearest: float = math.inf  # [m] that any vehicle ever came to the ego

    def see(self, before: Scene, after: Scene) -> None:
        """Measure one sub-step."""
        apart = np.hypot(after.x[:, None] - after.x, after.y[:, None] - after.y)
        for i, j in np.argwhere(np.triu(apart <= REACH, 1)):
            first, second = after.ids[i], after.ids[j]
            if not {first, second} <= set(before.ids):
                continue
            gaps = shapely.distance(*(polygons(*way(before, after, name).T) for name in (first, second)))
            if i == 0:
                self.nearest = min(self.nearest, float(gaps.min()))
            if gaps.min() == 0.0:
                if i == 0:
                    self.ego.setdefault(second, after.time)
                else:
                    self.others.setdefault((first, second), after.time)


def episodes(task: str, number: int) -> Iterator[tuple[Truth, DrivingEnv, list[Scene]]]:
    """Episodes of an ego that acts at random, half of them risky; the truth, the environment, and every sub-step."""
    simulator: Any = SumoSimulator()
    env = DrivingEnv(task, simulator=simulator)
    simulate = simulator.step
    trace: list[Scene] = []

    def recorded(command, trace_wanted=False, **_):
        step = simulate(command, True)
        trace.extend(step.trace)
        return step

    simulator.step = recorded
    rng = np.random.default_rng(0)
    for seed in range(number):
        env.reset(seed=seed, options={"config": {"risk": float(seed % 2)}})
        trace[:] = [env.scene]
        list(drive(env, rng.integers(len(env.actions), size=100).tolist()))
        truth = Truth()
        for before, after in pairwise(trace):
            truth.see(before, after)
            if truth.ego:  # what follows is decided by what became of the two
                break
        yield truth, env, trace


# 300 episodes of each task bring a thousand contacts.
MANY = pytest.param(300, marks=pytest.mark.long)


@pytest.mark.slow
@pytest.mark.parametrize("number", [10, MANY])
def test_the_ego_crashes_when_it_touches_another_vehicle(number: int) -> None:
    contacts = pairs = flagged = 0
    missed, wrong = [], []
    for task in TASKS:
        for truth, env, trace in episodes(task, number):
            crash = env.ego_state.crashed
            contacts += bool(truth.ego)
            if truth.ego and not crash:
                missed.append((task, env.scenario.seed))
            if crash and truth.nearest > TOUCHING:
                wrong.append((task, env.scenario.seed, truth.nearest))
            wrecks = {name for scene in trace for name in compress(scene.ids, scene.crashed)}
            pairs += len(truth.others)
            flagged += sum(set(pair) <= wrecks for pair in truth.others)
    print(f"{contacts} contacts of the ego, {len(missed)} missed; {pairs} of others, {flagged} noticed")
    assert contacts > 2 * number
    assert len(missed) <= 0.001 * contacts, missed
    assert wrong == []
    assert flagged >= 0.8 * pairs
