"""Draws the films and pictures of the tasks: ``python docs/films.py``.

docs/img/environments/*.png   one moment of each task, as its page shows it
docs/img/films/*.gif          each task at risk 1, while the ego is in sight, in a scenario with early danger
docs/img/risk.gif             README's Drive at risk 0, at risk 1, and as its crash could have been avoided
docs/img/scenarios.png        one moment of each environment in examples/scenarios, with SUMO as the driver

``python docs/films.py environments`` draws the first line alone, ``films``, ``risk`` and ``scenarios`` the others.
docs/img/films/town.gif is what the script of docs/scenarios.md writes.
"""

import copy
import re
import runpy
import sys
from contextlib import ExitStack
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
from sumo_env.tasks import get_task

IMAGES = ROOT / "docs" / "img"

WIDE = {"screen_width": 900}
# task -> seed, steps driven, configuration
PAGES: dict[str, tuple[int, int, dict[str, Any]]] = {
    "highway": (0, 6, {**WIDE, "screen_height": 130}),
    "two-way": (0, 3, {**WIDE, "screen_height": 130, "centering_position": [0.3, 0.6]}),
    "roundabout": (1, 3, {"scaling": 4.5}),
    "intersection": (2, 3, {}),
    "u-turn": (1, 3, {"scaling": 4.5, "centering_position": [0.35, 0.85]}),
    "merge": (4, 7, {**WIDE, "screen_height": 130, "centering_position": [0.4, 0.5]}),
    "exit": (3, 10, {**WIDE, "screen_height": 200, "scaling": 4.5, "centering_position": [0.4, 0.3]}),
}
STRIP = {"screen_width": 320, "screen_height": 114, "centering_position": [0.5, 0.5]}
HIGH = {"screen_width": 240, "screen_height": 280}
NEARER = get_task("two-way").levels["5+2"]
Place = tuple[float | None, float | None]
# task -> seed, configuration of its film, and what is in its middle [m]: None where the camera follows the ego. The
# seeds are among the first ones with a near miss or crash beside a car in a risk event; on the two-way road, where
# oncoming cars are met by then at its level 5+2, the first one with a crash. On the roundabout no two others touch.
FILMS: dict[str, tuple[int, dict[str, Any], Place]] = {
    "highway": (5, {**STRIP, "scaling": 4.5}, (None, 3.6)),
    "two-way": (2, {**STRIP, **NEARER, "scaling": 5.0, "centering_position": [0.35, 0.5]}, (None, 1.0)),
    "merge": (12, {**STRIP, "scaling": 3.8}, (None, 4.6)),
    "roundabout": (11, {**HIGH, "screen_width": 280, "scaling": 4.3}, (0.0, -4.0)),
    "intersection": (0, {**HIGH, "scaling": 5.5}, (2.0, 6.0)),
    "u-turn": (6, {**HIGH, "scaling": 4.6}, (130.0, 22.0)),
}
SCENARIO, TILE = 10_000, 300  # of the small scenarios: seed, size [px]
STEPS = {"lights": 20, "ramp": 24}  # until there is something to see; of the others 12
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
        ego = self.pictured.x.item(0), self.pictured.y.item(0)
        size = view["screen_width"], view["screen_height"]
        for axis, middle in enumerate(self.middle):
            if middle is not None:
                place[axis] = 0.5 + (ego[axis] - middle) * view["scaling"] / size[axis]
        return place

    def render(self) -> NDArray[np.uint8] | None:
        """The scene from where the camera is."""
        self.config["centering_position"] = place = self.ego_place()
        self.seen.append(all(0.0 < share < 1.0 for share in place))
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


def environments() -> None:
    """One frame for the page of each task."""
    for task, (seed, steps, config) in PAGES.items():
        picture = film(task, seed, "idle", config, steps)[-1].quantize(64)
        picture.save(IMAGES / "environments" / f"{task}.png", optimize=True)


def films() -> None:
    """One film of each task."""
    for task, (seed, view, middle) in FILMS.items():
        pictures = film(task, seed, "careful", {**view, "risk": 1.0}, middle=middle)
        save_gif(pictures, IMAGES / "films" / f"{task}.gif")


def risk() -> None:
    """README's Drive at risk 0, at risk 1, and from the last moment on from which its crash can be avoided."""
    idle, copies, over = 1, [], False
    with ExitStack() as opened:
        regular, risky = (
            opened.enter_context(Watched("highway", {**DRIVE, "risk": dose}, (None, 4.0)))
            for dose in (0.0, 1.0)
        )
        regular.reset(seed=SEED)
        risky.reset(seed=SEED)
        while not over:
            copies.append(opened.enter_context(copy.deepcopy(risky)))
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
        env = runpy.run_path(str(script))["make"](render_mode="rgb_array").unwrapped
        env.reset(seed=SCENARIO)
        alone = isinstance(env, gym.Env)
        cars = {"ego": env} if alone else env.cars
        for _ in range(STEPS.get(script.stem, 12)):
            ignored = {}
            for name, car in cars.items():
                car.hand_over()
                ignored[name] = 1 if hasattr(car.action_space, "n") else car.action_space.sample()
            env.step(ignored["ego"] if alone else ignored)
        frames.append((script.stem, [Image.fromarray(env.render()).resize((TILE, TILE))]))
        env.close()
    side_by_side(frames, columns=3)[0].save(IMAGES / "scenarios.png", optimize=True)


if __name__ == "__main__":
    parts = {draw.__name__: draw for draw in (environments, films, risk, scenarios)}
    for draw in [parts[name] for name in sys.argv[1:]] or parts.values():
        draw()
