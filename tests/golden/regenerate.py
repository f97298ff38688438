"""Write the golden trajectories anew: python tests/golden/regenerate.py, then look at the diff before committing it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium as gym

import sumo_env  # noqa: F401  (registers the environments)
from sumo_env.tasks import TASKS

FOLDER = Path(__file__).resolve().parent
TRAFFICS = {"regular": 0.0, "risky": 1.0}
SEED = 7
STEPS = 5
# Left, faster, idle, right, slower; the intersection's three actions in turn.
ACTIONS = {"intersection": (2, 0, 1, 2, 1)}
DEFAULT_ACTIONS = (0, 3, 1, 2, 4)


def trajectory(task: str, traffic: str) -> dict[str, Any]:
    """A few seconds of the lowest level: every vehicle's place and speed, and the ego's reward, after each step."""
    level = next(iter(TASKS[task].levels.values()))
    env = gym.make(f"sumo/{task}-v0", config={**level, "risk": TRAFFICS[traffic]})
    inner: Any = env.unwrapped
    env.reset(seed=SEED)
    steps = [_frame(inner.scene, None)]
    for action in ACTIONS.get(task, DEFAULT_ACTIONS)[:STEPS]:
        _, reward, terminated, _, _ = env.step(action)
        steps.append(_frame(inner.scene, float(reward)))
        if terminated:
            break
    env.close()
    return {"task": task, "traffic": traffic, "seed": SEED, "steps": steps}


def _frame(scene: Any, reward: float | None) -> dict[str, Any]:
    columns = zip(scene.ids, scene.x, scene.y, scene.speed, scene.heading, strict=True)
    return {
        "time": scene.time,
        "reward": None if reward is None else round(reward, 6),
        "vehicles": {name: [round(float(value), 6) + 0.0 for value in values] for name, *values in columns},
    }


def main() -> None:
    """Write one file a task and traffic."""
    for task in TASKS:
        for traffic in TRAFFICS:
            text = json.dumps(trajectory(task, traffic), indent=0)
            (FOLDER / f"{task}-{traffic}.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
