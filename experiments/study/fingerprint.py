"""What a simulator does, as eight digits: results of other dynamics must never be mixed or believed to be of these.

Behaviour is taken, not source code: the first policy steps of a few episodes, rounded far above what processors
differ by.
"""

from __future__ import annotations

import importlib.metadata
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from experiments.backends import make_env
from experiments.study.seeds import scenario_seed
from experiments.support.files import canonical_json, sha256_bytes
from sumo_env.config import resolve
from sumo_env.tasks import TASKS, get_task
from sumo_env.traffic.scenario import Scenario

SCENARIOS, STEPS = 2, 4
DECIMALS = 2  # of metres and metres per second
BACKENDS = Path(__file__).resolve().parents[1] / "backends"


def fingerprint(backend: str, task: str, config: dict[str, Any] | None = None) -> str:
    """Eight digits that change with the dynamics of a task: of its roads, drivers, risk and simulator.

    Args:
        backend: of `experiments.backends.make_env`. highway-env is too slow to be driven for this; its version, the
            scenarios, and the sources of its backend stand for it.
        config: changes of the task's configuration.
    """
    if backend == "highway-env":
        values: Any = [
            _scenarios(task),
            [path.read_text() for path in sorted(BACKENDS.glob("highway_env*.py"))],
        ]
        values.append(importlib.metadata.version("highway-env"))
    else:
        levels = list(TASKS[task].levels.values())
        values = [
            _rollout(backend, task, {**levels[level - 1], **(config or {})}, level, risk)
            for level in dict.fromkeys((1, len(levels)))
            for risk in (0.0, 1.0)
        ]
    return sha256_bytes(canonical_json([values, config or {}]).encode())[:8]


@cache
def dynamics(backend: str, task: str) -> str:
    """The fingerprint of a task as it is, taken once in a process."""
    return fingerprint(backend, task)


def checksum(scenario: Scenario) -> int:
    """A number that tells scenarios apart by what is driven: places, speeds, drivers, later arrivals and events.

    Of the vehicles only the first five count: some simulators leave out those that the ego cannot reach.
    """
    specs = (scenario.ego, *scenario.vehicles[:5], *(spawn.vehicle for spawn in scenario.spawns))
    drawn = [
        (v.id, v.lane, round(v.s, 6), round(v.speed, 6), round(v.target_speed, 6), v.destination,
         *(round(value, 6) for value in (v.driver.delta, v.driver.accel, v.driver.tau, v.driver.min_gap)))
        for v in specs
    ]  # fmt: skip
    events = [(round(event.time, 6), event.vehicle, event.kind) for event in scenario.events]
    return zlib.crc32(repr((drawn, events)).encode())


def _scenarios(task: str) -> list[int]:
    config = resolve(task, TASKS[task].defaults, {"risk": 1.0})
    return [checksum(get_task(task).scenario(config, seed)) for seed in range(SCENARIOS)]


def _rollout(backend: str, task: str, config: dict[str, Any], level: int, risk: float) -> list[Any]:
    """Places and speeds after each step of some episodes with seeded random actions."""
    env: Any = make_env(backend, task, {**config, "risk": risk})
    seen: list[Any] = []
    try:
        for scenario in range(SCENARIOS):
            rng = np.random.default_rng(scenario)
            env.reset(seed=scenario_seed(task, level, scenario))
            for _ in range(STEPS):
                _, reward, terminated, truncated, _ = env.step(int(rng.integers(env.action_space.n)))
                scene = env.unwrapped.scene
                numbers = np.concatenate([scene.x, scene.y, scene.speed, [reward]]).round(DECIMALS) + 0.0
                seen.append([list(scene.ids), scene.crashed.tolist(), numbers.tolist()])
                if terminated or truncated:
                    break
    finally:
        env.close()
    return seen
