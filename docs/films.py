"""Draws the films and pictures of the tasks: ``python docs/films.py``.

docs/img/environments/*.png   one moment of each task, as its page shows it
docs/img/films/*.gif          up to 12 s of each task at risk 1, in the first scenario with early danger
docs/img/risk.gif             one scenario at risk 0 and at risk 1

docs/img/scenarios.png        one moment of each environment in examples/scenarios, with SUMO as the driver

``python docs/films.py films`` draws the second line alone, ``python docs/films.py scenarios`` the last one, and
``python docs/films.py town`` docs/img/films/town.gif by the script of docs/scenarios.md.
"""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
from itertools import count
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path[0] = str(ROOT)

from agents.rules import make_policy
from experiments.support.films import Film, Pictures, save_gif, side_by_side
from sumo_env.env import DrivingEnv

IMAGES = ROOT / "docs" / "img"

WIDE = {"screen_width": 900}
# task -> seed, steps driven, configuration
PAGES: dict[str, tuple[int, int, dict[str, Any]]] = {
    "highway": (0, 6, {**WIDE, "screen_height": 130}),
    "two-way": (0, 3, {**WIDE, "screen_height": 90, "centering_position": [0.3, 0.6]}),
    "roundabout": (1, 3, {"scaling": 4.5}),
    "intersection": (2, 3, {}),
    "u-turn": (1, 3, {"scaling": 4.5, "centering_position": [0.35, 0.85]}),
    "merge": (4, 7, {**WIDE, "screen_height": 130, "centering_position": [0.4, 0.5]}),
    "exit": (3, 10, {**WIDE, "screen_height": 200, "scaling": 4.5, "centering_position": [0.4, 0.3]}),
}
SIZE = {"screen_width": 280, "screen_height": 200}
# task -> configuration of its film
FILMS: dict[str, dict[str, Any]] = {
    "highway": {"scaling": 4.0, "centering_position": [0.35, 0.5]},
    "two-way": {"scaling": 4.0, "centering_position": [0.35, 0.5]},
    "roundabout": {"scaling": 2.8, "centering_position": [0.5, 0.7]},
    "intersection": {"scaling": 3.4, "centering_position": [0.5, 0.65]},
    "u-turn": {"scaling": 2.2, "centering_position": [0.4, 0.75]},
    "merge": {"scaling": 3.2, "centering_position": [0.35, 0.45]},
}
SCENARIO, SECONDS, TILE = 10_000, 12, 300  # of the small scenarios: seed, steps, size [px]
DRIVER = "careful"
NEAR = 30.0  # [m] to a car that is in the picture
EARLY, LEAST = 3, 8  # [s] until the first near miss, and that the ego drives at least
BESIDE: tuple[str, int, str, dict[str, Any]] = (
    "u-turn", 2, "careful",
    {"screen_width": 400, "screen_height": 240, "scaling": 2.9, "centering_position": [0.4, 0.8]},
)  # fmt: skip


def film(task: str, seed: int, name: str, config: dict[str, Any], seconds: int = 12) -> Pictures:
    """An episode that a rule drives, as pictures."""
    env = DrivingEnv(task, config, render_mode="rgb_array")
    policy, recorded = make_policy(name, env), Film(env)
    observation, _ = env.reset(seed=seed)
    policy.reset(seed)
    for _ in range(seconds):
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        recorded.frame()
        if terminated or truncated:
            break
    env.close()
    return recorded.pictures


def with_danger(task: str) -> int:
    """The first seed with a near miss, and a car in a risk event within sight of it, in the first seconds."""
    env = DrivingEnv(task, {"risk": 1.0})
    policy = make_policy(DRIVER, env)
    for seed in count():
        observation, _ = env.reset(seed=seed)
        policy.reset(seed)
        dangerous = False
        for second in range(1, LEAST + 1):
            observation, _, terminated, truncated, info = env.step(policy.act(observation))
            scene = env.scene
            apart = np.hypot(scene.x - scene.x[0], scene.y - scene.y[0]).tolist()
            near = [name for name, far in zip(scene.ids, apart, strict=True) if far < NEAR]
            acting = any(name in scene.in_event for name in near)
            dangerous = dangerous or (second <= EARLY and info["near_miss"] and acting)
            if terminated or truncated:
                break
        if dangerous and second == LEAST:
            break
    env.close()
    return seed


def environments() -> None:
    """One frame for the page of each task."""
    for task, (seed, steps, config) in PAGES.items():
        picture = film(task, seed, "idle", config, steps)[-1].quantize(64)
        picture.save(IMAGES / "environments" / f"{task}.png", optimize=True)


def films() -> None:
    """One film of each task."""
    for task, config in FILMS.items():
        seed = with_danger(task)
        print(f"{task}: seed {seed}")
        pictures = film(task, seed, DRIVER, {**SIZE, **config, "risk": 1.0})
        save_gif(pictures, IMAGES / "films" / f"{task}.gif")


def risk() -> None:
    """The same scenario at risk 0 and at risk 1, side by side."""
    task, seed, name, config = BESIDE
    titles = {0.0: "risk 0", 1.0: "risk 1: yellow while a risk event acts"}
    both = [(title, film(task, seed, name, {**config, "risk": dose})) for dose, title in titles.items()]
    save_gif(side_by_side(both), IMAGES / "risk.gif")


def scenarios() -> None:
    """One frame of each of the small scenarios, in rows of three."""
    frames = []
    for script in sorted((ROOT / "examples" / "scenarios").glob("*.py")):
        if script.stem in ("build", "train"):
            continue
        env = runpy.run_path(str(script))["make"](render_mode="rgb_array")
        env.reset(seed=SCENARIO)
        alone = isinstance(env, gym.Env)
        cars = {"ego": env.unwrapped} if alone else env.cars
        for _ in range(SECONDS):
            for car in cars.values():
                car.hand_over()
            spaces = {name: car.action_space for name, car in cars.items()}
            ignored = {name: 1 if hasattr(space, "n") else space.sample() for name, space in spaces.items()}
            if alone:
                cars["ego"].step(ignored["ego"])
            else:
                env.step(ignored)
        frames.append(Image.fromarray(env.render()).resize((TILE, TILE)))
        env.close()
    columns, gap = 3, 10
    rows = -(-len(frames) // columns)
    whole = Image.new("RGB", (columns * (TILE + gap) - gap, rows * (TILE + gap) - gap), "white")
    for number, frame in enumerate(frames):
        row, column = divmod(number, columns)
        whole.paste(frame, (column * (TILE + gap), row * (TILE + gap)))
    whole.save(IMAGES / "scenarios.png", optimize=True)


def town() -> None:
    """The film that the script of docs/scenarios.md makes; needs eclipse-sumo."""
    page = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    scripts = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (script,) = (script for script in scripts if "town.gif" in script)
    with tempfile.TemporaryDirectory() as folder:
        paths = {**os.environ, "PYTHONPATH": str(ROOT)}
        subprocess.run([sys.executable, "-c", script], cwd=folder, env=paths, check=True)
        shutil.copy(Path(folder) / "town.gif", IMAGES / "films")


if __name__ == "__main__":
    parts = {"films": films, "scenarios": scenarios, "town": town}
    for draw in [parts[name] for name in sys.argv[1:]] or [environments, films, risk, scenarios]:
        draw()
