"""Draws the films and pictures of the tasks: ``python docs/films.py``.

docs/img/environments/*.png   one moment of each task, as its page shows it
docs/img/films/*.gif          up to 12 s of each task at risk 1, all of one size
docs/img/risk.gif             one scenario at risk 0 and at risk 1

``python docs/films.py town`` trains an agent of examples/arrive.py in Braunschweig: docs/img/films/town.gif
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[0] = str(ROOT)

from agents.rules import make_policy
from experiments.support.films import Film, Pictures, save_gif, side_by_side
from sumo_env.env import DrivingEnv

IMAGES = ROOT / "docs" / "img"

# task -> seed, steps driven, configuration
PAGES: dict[str, tuple[int, int, dict[str, Any]]] = {
    "highway": (0, 6, {"screen_width": 900, "screen_height": 130}),
    "two-way": (0, 3, {"screen_width": 900, "screen_height": 90, "centering_position": [0.3, 0.6]}),
    "roundabout": (1, 3, {"scaling": 4.5}),
    "intersection": (2, 3, {}),
    "u-turn": (1, 3, {"scaling": 4.5, "centering_position": [0.35, 0.85]}),
}
SIZE = {"screen_width": 280, "screen_height": 200}
# task -> seed, policy, configuration of its film
FILMS: dict[str, tuple[int, str, dict[str, Any]]] = {
    "highway": (8, "careful", {"scaling": 4.0, "centering_position": [0.35, 0.5]}),
    "two-way": (4, "careful", {"scaling": 4.0, "centering_position": [0.35, 0.5]}),
    "roundabout": (2, "careful", {"scaling": 2.8, "centering_position": [0.5, 0.7]}),
    "intersection": (4, "careful", {"scaling": 3.4, "centering_position": [0.5, 0.65]}),
    "u-turn": (11, "careful", {"scaling": 2.2, "centering_position": [0.4, 0.75]}),
}
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


def environments() -> None:
    """One frame for the page of each task."""
    for task, (seed, steps, config) in PAGES.items():
        film(task, seed, "idle", config, steps)[-1].quantize(64).save(
            IMAGES / "environments" / f"{task}.png", optimize=True
        )


def films() -> None:
    """One film of each task."""
    for task, (seed, name, config) in FILMS.items():
        save_gif(film(task, seed, name, {**SIZE, **config, "risk": 1.0}), IMAGES / "films" / f"{task}.gif")


def risk() -> None:
    """The same scenario at risk 0 and at risk 1, side by side."""
    task, seed, name, config = BESIDE
    titles = {0.0: "risk 0", 1.0: "risk 1: yellow while a risk event acts"}
    both = [(title, film(task, seed, name, {**config, "risk": dose})) for dose, title in titles.items()]
    save_gif(side_by_side(both), IMAGES / "risk.gif")


def town(seed: int = 10_000, seconds: int = 60) -> None:
    """An agent of examples/arrive.py in Braunschweig, from its departure to its arrival; needs eclipse-sumo."""
    from examples.arrive import STEPS, make, own_dqn

    size = {"screen_width": 420, "screen_height": 260, "scaling": 3.0}
    with tempfile.TemporaryDirectory() as folder:
        env = make("town", folder, render_mode="rgb_array")
        act = own_dqn(env, 0, STEPS["dqn"])
        env.configure(size)
        recorded = Film(env)
        observation, _ = env.reset(seed=seed)
        for _ in range(seconds):
            observation, _, terminated, _, info = env.step(act(observation))
            recorded.frame()
            if terminated:
                print("arrived" if info["arrived"] else info)
                break
        env.close()
    save_gif(recorded.pictures[::2], IMAGES / "films" / "town.gif")  # at twice the speed


if __name__ == "__main__":
    if "town" in sys.argv:
        town()
        sys.exit()
    environments()
    films()
    risk()
