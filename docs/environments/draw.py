"""Draws the picture of each environment: ``python docs/environments/draw.py`` writes docs/img/environments/*.png."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
from PIL import Image

import sumo_env

FOLDER = Path(__file__).resolve().parents[1] / "img" / "environments"
# task -> seed, steps driven with action IDLE, configuration; chosen to show some traffic
SCENES: dict[str, tuple[int, int, dict[str, Any]]] = {
    "highway": (0, 6, {"screen_width": 900, "screen_height": 130}),
    "two-way": (0, 3, {"screen_width": 900, "screen_height": 90, "centering_position": [0.3, 0.6]}),
    "roundabout": (1, 3, {"scaling": 4.5}),
    "intersection": (2, 3, {}),
    "u-turn": (1, 3, {"scaling": 4.5, "centering_position": [0.35, 0.85]}),
}


def draw(task: str) -> Image.Image:
    """One frame of a task."""
    seed, steps, config = SCENES[task]
    env = gym.make(f"sumo/{task}-v0", config=config, render_mode="rgb_array")
    idle = list(env.unwrapped.actions.values()).index("IDLE")  # type: ignore[attr-defined]
    env.reset(seed=seed)
    for _ in range(steps):
        env.step(idle)
    frame: Any = env.render()
    env.close()
    return Image.fromarray(frame)


def main() -> None:
    """Write all pictures."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for id in sumo_env.IDS:
        task = sumo_env.task_of(id)
        draw(task).quantize(64).save(FOLDER / f"{task}.png", optimize=True)


if __name__ == "__main__":
    main()
