"""Draw the README's picture: one moment of each task, with risky drivers (python experiments/draw_tasks.py)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PIL import Image

from sumo_env.env import DrivingEnv

TARGET = Path(__file__).resolve().parent.parent / "docs" / "img" / "tasks.png"
GAP = 6  # [px] between the pictures
# task -> (seed, steps driven, screen width, screen height), chosen to show some traffic
SHOTS = {
    "highway": (3, 4, 900, 150),
    "two-way": (2, 2, 900, 110),
    "u-turn": (1, 3, 900, 290),
    "roundabout": (5, 3, 447, 420),
    "intersection": (5, 4, 447, 420),
}


def shot(task: str) -> Image.Image:
    """One frame of a task."""
    seed, steps, width, height = SHOTS[task]
    config: dict[str, Any] = {"screen_width": width, "screen_height": height, "risk": 1.0}
    if task == "u-turn":
        config["centering_position"] = [0.35, 0.78]
    env = DrivingEnv(task, config, render_mode="rgb_array")
    env.reset(seed=seed)
    for _ in range(steps):
        env.step(1)
    frame = env.render()
    assert frame is not None
    env.close()
    return Image.fromarray(frame)


def main() -> None:
    """Put the five frames onto one sheet."""
    wide = [shot(task) for task in ("highway", "two-way", "u-turn")]
    square = [shot(task) for task in ("roundabout", "intersection")]
    width = wide[0].width
    height = sum(image.height + GAP for image in wide) + square[0].height
    sheet = Image.new("RGB", (width, height), "white")
    y = 0
    for image in wide:
        sheet.paste(image, (0, y))
        y += image.height + GAP
    sheet.paste(square[0], (0, y))
    sheet.paste(square[1], (width - square[1].width, y))
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    sheet.quantize(64).save(TARGET, optimize=True)


if __name__ == "__main__":
    main()
