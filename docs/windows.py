"""Draws docs/img/windows: both windows on five tasks and on a network of one's own, on a display that nobody sees.

xvfb-run -s "-screen 0 1280x900x24" python docs/windows.py      # needs openbox, the extras [window] and [gui]
"""

import os
import subprocess
import time
from pathlib import Path
from typing import Any

from PIL import Image, ImageGrab

from sumo_env.env import DrivingEnv
from sumo_env.scenarios import SumoDrivingEnv

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "img" / "windows"
RAMP = ROOT / "examples" / "scenarios" / "networks" / "ramp.net.xml"
ROUTES = [["main", "merge", "out"]], ["ramp", "merge", "out"]
WIDTH, GAP = 460, 10  # [px] of a window, and between two pictures
STEPS = {"highway": 3, "two-way": 3, "roundabout": 4, "u-turn": 5, "intersection": 5, "ramp": 17}
WINDOWS = {"pygame": {"render_mode": "human"}, "sumo-gui": {"live": "sumo-gui"}}


def shot(name: str, kind: str) -> Image.Image:
    """A window in the middle of an episode."""
    window: Any = WINDOWS[kind]
    if name == "ramp":
        env: DrivingEnv = SumoDrivingEnv(RAMP, *ROUTES, {"spawn_probability": 0.6}, **window)
    else:
        env = DrivingEnv(name, {"risk": 0.5}, **window)
    env.reset(seed=3)
    for _ in range(STEPS[name]):
        env.step(1)
    time.sleep(0.5)
    picture = ImageGrab.grab(xdisplay=os.environ["DISPLAY"]).convert("RGB")
    env.close()
    drawn = picture.point(lambda value: 255 * (value > 4)).getbbox()
    assert drawn is not None, "the display is black"
    left, top, right, bottom = drawn
    if kind == "sumo-gui":  # nor its log, which names files of this machine
        bottom -= round(0.135 * (bottom - top))
    picture = picture.crop((left, top, right, bottom))
    return picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)), Image.Resampling.LANCZOS)


def beside(pictures: list[Image.Image], columns: int = 2) -> Image.Image:
    """Pictures of one width in columns, each where there is most room."""
    heights, places, width = [0] * columns, [], pictures[0].width + GAP
    for picture in pictures:
        column = heights.index(min(heights))
        places.append((column * width, heights[column]))
        heights[column] += picture.height + GAP
    whole = Image.new("RGB", (columns * width - GAP, max(heights) - GAP), "white")
    for picture, place in zip(pictures, places, strict=True):
        whole.paste(picture, place)
    return whole


def main() -> None:
    """Both pictures."""
    os.environ.pop("SDL_VIDEODRIVER", None)
    FOLDER.mkdir(exist_ok=True)
    with subprocess.Popen(["openbox"], stderr=subprocess.DEVNULL) as manager:
        for kind in WINDOWS:
            picture = beside([shot(name, kind) for name in STEPS])
            small = picture.quantize(96, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
            small.save(FOLDER / f"{kind}.png", optimize=True)
        manager.terminate()


if __name__ == "__main__":
    main()
