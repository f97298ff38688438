"""Episodes as animated pictures: recorded at every other simulation step, put side by side, saved as GIF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
from PIL import Image, ImageDraw, ImageFont

from agents.checkpoint import atomic
from experiments.support.errors import UserError

FREQUENCY = 5  # pictures per second
HOLD = 5  # pictures for which the last one stays
TITLE, GAP = 22, 8  # [px] above a picture, and between two

Pictures = list[Image.Image]


class Film:
    """Pictures of an environment as it is driven; `frame` adds one after a reset or a step.

    Environments of `sumo_env` are recorded between policy steps too, in real time.
    """

    recording, frames_per_sec = True, 0  # as environments expect of a `gymnasium.wrappers.RecordVideo`
    frequency: float = FREQUENCY

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        self.env: Any = env.unwrapped
        self.pictures: list[Any] = []
        self._seen = 0
        if hasattr(self.env, "set_record_video_wrapper"):
            self.env.set_record_video_wrapper(self)

    def frame(self) -> None:
        """Add the present picture, after a reset or a step."""
        self._seen = 0
        self.pictures.append(self.picture())

    def _capture_frame(self) -> None:
        self._seen += 1
        if self._seen % max(self.frames_per_sec // self.frequency, 1) == 0:
            self.pictures.append(self.picture())

    def picture(self) -> Any:
        """The present picture."""
        return Image.fromarray(self.env.render())


def side_by_side(films: Sequence[tuple[str, Pictures]], columns: int | None = None) -> Pictures:
    """Films of pictures of one size in one, each under its title, in one row or in so many columns.

    The shorter ones stay at their end.
    """
    length, columns = max(len(pictures) for _, pictures in films), columns or len(films)
    width, height = films[0][1][0].size
    rows = -(-len(films) // columns)
    font, sheets = ImageFont.load_default(size=14), []
    for number in range(length):
        size = (columns * (width + GAP) - GAP, rows * (height + TITLE))
        sheet = Image.new("RGB", size, "white")
        pen = ImageDraw.Draw(sheet)
        for place, (title, pictures) in enumerate(films):
            left, top = place % columns * (width + GAP), place // columns * (height + TITLE)
            pen.text((left + 4, top + 3), title, fill="black", font=font)
            sheet.paste(pictures[min(number, len(pictures) - 1)], (left, top + TITLE))
        sheets.append(sheet)
    return sheets


def check_gif(file: Path | None) -> None:
    """That a film can be written to a file, before it is made. Raises UserError; None is always right."""
    if file is not None and file.suffix.lower() != ".gif":
        raise UserError(f"a film is an animated GIF: name a file that ends in .gif, not {file}")
    if file is not None and not file.parent.is_dir():
        raise UserError(
            f"there is no folder {file.parent} for {file.name}: make it, or choose another one with --out"
        )


def save_gif(pictures: Pictures, file: Path) -> None:
    """Write an animation atomically; the last picture stays for a second."""
    first, *others = [picture.quantize(64) for picture in pictures + pictures[-1:] * HOLD]
    options: dict[str, Any] = {"duration": 1000 // FREQUENCY, "loop": 0, "optimize": True}
    with atomic(file) as opened:
        first.save(opened, "GIF", save_all=True, append_images=others, **options)
