"""What a simulator does, as eight digits: results of other dynamics must never be mixed or believed to be of these.

Behaviour is taken, not source code: the first policy steps of a few episodes, rounded far above what processors
differ by. `fingerprints.json` has, for each backend and task, the eight digits that cells are named with and those of
the behaviour that they stand for; a sweep checks the simulator against them before it begins. After a change of the
dynamics that is meant,

    python -m experiments.study.design.fingerprint

gives the changed dynamics names of their own.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from experiments.backends import BACKENDS, has, make_env, require
from experiments.study.design.arms import scenario_seed
from experiments.support.errors import UserError
from experiments.support.files import canonical_json, read_json, sha256_bytes, write_json
from sumo_env.tasks import TASKS

SCENARIOS, STEPS = 2, 4
DECIMALS = 2  # of metres and metres per second
LIGHTEST_ALONE = ("highway-env",)  # too slow for the fingerprint to cover the heaviest traffic too
TABLE = Path(__file__).with_name("fingerprints.json")


def fingerprint(backend: str, task: str) -> str:
    """Eight digits that change with the dynamics of a task: of its roads, drivers, risk and simulator."""
    levels = list(TASKS[task].levels.values())
    driven = (1,) if backend in LIGHTEST_ALONE else dict.fromkeys((1, len(levels)))
    values = [
        _rollout(backend, task, levels[level - 1], level, risk) for level in driven for risk in (0.0, 1.0)
    ]
    return sha256_bytes(canonical_json([values, {}]).encode())[:8]


def _table() -> dict[str, dict[str, dict[str, str]]]:
    """`name` and `behaviour` by backend and task."""
    table: dict[str, dict[str, dict[str, str]]] = read_json(TABLE)
    return table


def known_dynamics(backend: str, task: str) -> str:
    """The digits that cells of a task are named with; empty for a task that the table does not have.

    Raises:
        UserError: the backend does not have the task.
    """
    name = _table().get(backend, {}).get(task, {}).get("name", "")
    if not name:
        require(backend, task)
    return name


@cache
def dynamics(backend: str, task: str) -> str:
    """The digits that cells of a task are named with; of a task that the table does not have, its fingerprint.

    Raises:
        UserError: the backend does not have the task.
    """
    return known_dynamics(backend, task) or fingerprint(backend, task)


def check_dynamics(pairs: Iterable[tuple[str, str]]) -> None:
    """Check that simulators do what the names of cells say, for pairs of backend and task.

    Raises:
        UserError: one does not.
    """
    table = _table()
    for backend, task in pairs:
        known = table.get(backend, {}).get(task)
        if known and (found := fingerprint(backend, task)) != known["behaviour"]:
            raise UserError(
                f"the task {task} on the backend {backend} does not behave as the stored results of this name did "
                f"(fingerprint {found}, expected {known['behaviour']}): undo the change of its dynamics, or run "
                "python -m experiments.study.design.fingerprint, which gives the changed dynamics a name of their own"
            )


def main() -> int:
    """Compare all simulators with the table; add tasks, and give new names to those that have changed."""
    table = _table()
    for backend in BACKENDS:
        for task in (task for task in TASKS if has(backend, task)):
            known = table.setdefault(backend, {}).setdefault(task, {"name": "none", "behaviour": ""})
            found = fingerprint(backend, task)
            if found != known["behaviour"]:
                print(f"{backend} {task}: {known['name']} -> {found}")
                known.update(name=found, behaviour=found)
    write_json(TABLE, table)
    return 0


def _rollout(backend: str, task: str, config: Mapping[str, Any], level: int, risk: float) -> list[Any]:
    """Places and speeds after each step of some episodes with seeded random actions."""
    seen: list[Any] = []
    env: Any
    with closing(make_env(backend, task, {**config, "risk": risk})) as env:
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
    return seen


if __name__ == "__main__":
    sys.exit(main())
