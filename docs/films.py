"""Draws the films and pictures of the tasks: ``python docs/films.py``.

docs/img/environments/*.png   one moment of each task, as its page shows it
docs/img/films/*.gif          each task at risk 1, while the ego is in sight, in the first scenario with early danger
docs/img/risk.gif             README's Drive at risk 0, at risk 1, and as its crash could have been avoided

docs/img/scenarios.png        one moment of each environment in examples/scenarios, with SUMO as the driver

``python docs/films.py films`` draws the second line alone, ``risk`` the third, ``scenarios`` the last one, and ``town``
docs/img/films/town.gif by the script of docs/scenarios.md.
"""

from __future__ import annotations

import copy
import os
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
from contextlib import ExitStack, closing
from itertools import count
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path[0] = str(ROOT)

from agents.rules import make_policy
from experiments.replay import filmed
from experiments.study.replaying.avoid import way_out
from experiments.support.films import Film, Pictures, save_gif, side_by_side
from sumo_env.env import DrivingEnv
from sumo_env.rendering.scenery import FILM

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
STRIP = {"screen_width": 320, "screen_height": 114, "centering_position": [0.5, 0.5]}
HIGH = {"screen_width": 240, "screen_height": 280}
Place = tuple[float | None, float | None]
# task -> configuration of its film, and what is in its middle [m]: None where the camera follows the ego
FILMS: dict[str, tuple[dict[str, Any], Place]] = {
    "highway": ({**STRIP, "scaling": 4.5}, (None, 3.6)),
    "two-way": ({**STRIP, "scaling": 6.0}, (None, 1.0)),
    "merge": ({**STRIP, "scaling": 3.8}, (None, 4.6)),
    "roundabout": ({**HIGH, "screen_width": 280, "scaling": 4.3}, (0.0, -4.0)),
    "intersection": ({**HIGH, "scaling": 5.5}, (2.0, 6.0)),
    "u-turn": ({**HIGH, "scaling": 4.6}, (130.0, 22.0)),
}
SCENARIO, SECONDS, TILE = 10_000, 12, 300  # of the small scenarios: seed, steps, size [px]
DRIVER = "careful"
NEAR = 15.0  # [m] to a car that is beside the ego
EARLY, LEAST = 5, 4  # [s] until the first danger, and that the ego is seen at least
# the picture of README's Drive, whose seed it has, and policy steps after the crash
(SEED,) = map(int, re.findall(r"reset\(seed=(\d+)\)", (ROOT / "README.md").read_text(encoding="utf-8"))[:1])
DRIVE: dict[str, Any] = {"policy_frequency": 5, "duration": 20, **STRIP, "screen_width": 600, "scaling": 5.0}
AFTER = 15


class Watched(DrivingEnv):
    """An environment whose camera stays where `middle` [m] has numbers, and elsewhere follows the ego."""

    def __init__(self, task: str, config: dict[str, Any], middle: Place = (None, None)) -> None:
        super().__init__(task, config, render_mode="rgb_array")
        self.middle = middle
        self.seen: list[bool] = []  # whether the ego is in each of the pictures

    def ego_place(self) -> list[float]:
        """Where the ego is in the picture, as shares of its width and height."""
        view, place = self.config, list(self.config["centering_position"])
        ego, size = (
            (self.scene.x.item(0), self.scene.y.item(0)),
            (view["screen_width"], view["screen_height"]),
        )
        for axis, middle in enumerate(self.middle):
            if middle is not None:
                place[axis] = 0.5 + (ego[axis] - middle) * view["scaling"] / size[axis]
        return place

    def is_ego_seen(self) -> bool:
        """Whether the ego is in the picture."""
        return all(0.0 < share < 1.0 for share in self.ego_place())

    def render(self) -> NDArray[np.uint8] | None:
        """The scene from where the camera is."""
        self.seen.append(self.is_ego_seen())
        self.config["centering_position"] = self.ego_place()
        return super().render()


def film(
    task: str, seed: int, name: str, config: dict[str, Any], seconds: int = 12, middle: Place = (None, None)
) -> Pictures:
    """An episode that a rule drives, as pictures: those in which the ego is seen."""
    env = Watched(task, config, middle)
    policy, recorded = make_policy(name, env), Film(env)
    observation, _ = env.reset(seed=seed)
    policy.reset(seed)
    for _ in range(seconds):
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        recorded.frame()
        if terminated or truncated:
            break
    env.close()
    return [picture for picture, is_seen in zip(recorded.pictures, env.seen, strict=True) if is_seen]


def with_danger(task: str, config: dict[str, Any], middle: Place) -> int:
    """The first seed with a near miss or crash beside a car in a risk event, soon after the ego comes into sight."""
    env = Watched(task, config, middle)
    policy = make_policy(DRIVER, env)
    for seed in count():
        observation, _ = env.reset(seed=seed)
        policy.reset(seed)
        seconds, dangerous, over = 0, False, False
        while not over and (env.is_ego_seen() or not seconds):
            observation, _, terminated, truncated, info = env.step(policy.act(observation))
            over, scene = terminated or truncated, env.scene
            seconds += env.is_ego_seen()
            apart = np.hypot(scene.x - scene.x[0], scene.y - scene.y[0]).tolist()
            near = {name for name, far in zip(scene.ids, apart, strict=True) if far < NEAR}
            is_close = info["near_miss"] or info["crashed"]
            dangerous = dangerous or bool(is_close and near & scene.in_event and 0 < seconds <= EARLY)
        if dangerous and seconds >= LEAST:
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
    for task, (view, middle) in FILMS.items():
        config = {**view, "risk": 1.0}
        seed = with_danger(task, config, middle)
        pictures = film(task, seed, DRIVER, config, middle=middle)
        save_gif(pictures, IMAGES / "films" / f"{task}.gif")
        ground = np.mean([(np.asarray(picture) == FILM.ground).all(axis=2).mean() for picture in pictures])
        print(f"{task}: seed {seed}, {len(pictures)} pictures, {ground:.0%} of them ground")


def risk() -> None:
    """README's Drive at risk 0, at risk 1, and from the last moment on from which its crash can be avoided."""
    idle, copies, over = 1, [], False
    with ExitStack() as opened:

        def kept(env: Watched) -> Watched:
            return opened.enter_context(closing(env))

        regular, risky = (
            kept(Watched("highway", {**DRIVE, "risk": dose}, (None, 4.0))) for dose in (0.0, 1.0)
        )
        regular.reset(seed=SEED)
        risky.reset(seed=SEED)
        while not over:
            copies.append(kept(copy.deepcopy(risky)))
            *_, over, _, info = risky.step(idle)
        steps = reversed(range(len(copies)))
        step, free = next((step, free) for step in steps if (free := way_out(copies[step])[0]))
        time, contact = step / DRIVE["policy_frequency"], info["crash"]["time"]
        words = " ".join(risky.actions[action] for action in free if action != idle)
        avoided = (
            f"risk 1, {words} at {time:.1f} s; point of no return: {contact - time:.1f} s before the contact"
        )
        whole = len(copies) + AFTER
        drives = {
            "risk 0, IDLE": (regular, (idle,) * whole),
            f"risk 1, IDLE: crash after {contact:.1f} s": (copies[0], (idle,) * len(copies)),
            avoided: (copies[0], ((idle,) * step + free)[:whole]),
        }
        films = [(title, filmed(*drive)) for title, drive in drives.items()]
    save_gif(side_by_side(films, columns=1), IMAGES / "risk.gif")


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
    parts = {"films": films, "risk": risk, "scenarios": scenarios, "town": town}
    for draw in [parts[name] for name in sys.argv[1:]] or [environments, films, risk, scenarios]:
        draw()
