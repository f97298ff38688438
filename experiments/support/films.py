"""Episodes as animated pictures: recorded at every other simulation step, put side by side, saved as GIF or MP4."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from agents.files import atomic
from experiments.support.errors import UserError
from sumo_env.tasks import get_task

FREQUENCY = 5  # pictures per second
HOLD = 5  # pictures for which the last one stays
# configuration of an environment whose pictures stand beside others
PANEL: dict[str, Any] = {
    "screen_width": 440,
    "screen_height": 280,
    "scaling": 3.4,
    "centering_position": [0.45, 0.65],
}
LOWEST, MARGIN = 120, 30  # [px] of such a picture, and beyond a road that is straight
TITLE, GAP = 22, 8  # [px] above a picture, and between two

Pictures = list[Image.Image]


class Film:
    """Pictures of an environment as it is driven; `frame` adds one after a reset or a step.

    Environments of `sumo_env` are recorded between policy steps too, in real time.
    """

    recording, frames_per_sec = True, 0  # as environments expect of a `gymnasium.wrappers.RecordVideo`

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        self.env: Any = env.unwrapped
        self.pictures: Pictures = []
        self._seen = 0
        if hasattr(self.env, "set_record_video_wrapper"):
            self.env.set_record_video_wrapper(self)

    def frame(self) -> None:
        """Add the present picture, after a reset or a step."""
        self._seen = 0
        self.pictures.append(Image.fromarray(self.env.render()))

    def _capture_frame(self) -> None:
        self._seen += 1
        if self._seen % max(self.frames_per_sec // FREQUENCY, 1) == 0:
            self.pictures.append(Image.fromarray(self.env.render()))


def panel(task: str, config: Mapping[str, Any]) -> dict[str, Any]:
    """`PANEL`, lower where the road of the task is straight, so that little of a picture is ground."""
    known = get_task(task)
    lanes = known.road({**known.defaults, **config}).lanes.values()
    across = [lane.position(s, 0.0)[1] for lane in lanes for s in (0.0, lane.length / 2, lane.length)]
    # the camera follows the ego, on any of the lanes
    height = int(2 * PANEL["scaling"] * (max(across) - min(across))) + 2 * MARGIN
    if height >= PANEL["screen_height"]:
        return PANEL
    return {**PANEL, "screen_height": max(height, LOWEST), "centering_position": [0.45, 0.5]}


def side_by_side(
    films: Sequence[tuple[str, Pictures]], columns: int | None = None, caption: Sequence[str] = ()
) -> Pictures:
    """Films of pictures of one size in one, each under its title, in one row or in so many columns.

    The shorter ones stay at their end. The lines of the caption stand below.
    """
    length, columns = max(len(pictures) for _, pictures in films), columns or len(films)
    width, height = films[0][1][0].size
    rows = -(-len(films) // columns)
    font, sheets = ImageFont.load_default(size=14), []
    for number in range(length):
        size = (columns * (width + GAP) - GAP, rows * (height + TITLE) + len(caption) * TITLE)
        sheet = Image.new("RGB", size, "white")
        pen = ImageDraw.Draw(sheet)
        for place, (title, pictures) in enumerate(films):
            left, top = place % columns * (width + GAP), place // columns * (height + TITLE)
            pen.text((left + 4, top + 3), title, fill="black", font=font)
            sheet.paste(pictures[min(number, len(pictures) - 1)], (left, top + TITLE))
        for line, text in enumerate(caption):
            pen.text((4, rows * (height + TITLE) + line * TITLE + 3), text, fill="black", font=font)
        sheets.append(sheet)
    return sheets


def check_film(file: Path | None, *endings: str) -> None:
    """That a film can be written to a file, before it is made. Raises UserError; None is always right."""
    if file is not None and file.suffix not in endings:
        raise UserError(f"{file}: the name of a film ends in {' or '.join(endings)}")
    if file is not None and not file.parent.is_dir():
        raise UserError(
            f"there is no folder {file.parent} for {file.name}: make it, or choose another one with --out"
        )


def save_film(pictures: Pictures, file: Path) -> None:
    """Write a film, as a GIF or, where the file's name ends so, as an MP4.

    Raises:
        UserError: moviepy is missing, which writes MP4.
    """
    if file.suffix == ".gif":
        return save_gif(pictures, file)
    try:
        from moviepy import ImageSequenceClip  # type: ignore[import-untyped]
    except ImportError:
        raise UserError("an .mp4 needs moviepy: pip install moviepy (a .gif does not)") from None
    width, height = pictures[0].size
    # as H.264 asks for
    even = [picture.crop((0, 0, width // 2 * 2, height // 2 * 2)) for picture in pictures]
    frames = [np.asarray(picture) for picture in even + even[-1:] * HOLD]
    file.unlink(missing_ok=True)  # a link in its place is not followed
    ImageSequenceClip(frames, fps=FREQUENCY).write_videofile(str(file), logger=None)


def save_gif(pictures: Pictures, file: Path) -> None:
    """Write an animation atomically; the last picture stays for a second."""
    first, *others = [picture.quantize(64) for picture in pictures + pictures[-1:] * HOLD]
    options: dict[str, Any] = {"duration": 1000 // FREQUENCY, "loop": 0, "optimize": True}
    with atomic(file) as opened:
        first.save(opened, "GIF", save_all=True, append_images=others, **options)
