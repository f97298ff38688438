"""Pictures for people: the scenery, and notes that say what happens.

The ego is blue, further learning cars are light blue, other cars are white and crashed ones red. Rings with a word mark
a car in a risk event (yellow, with the kind of the event), one with which the ego crashes (red, with its name), and one
to which it comes near (pink, with the time to the collision). In the corner are the time, the ego's speed and its last
meta-action, and below a red or yellow light ahead, a near miss and a crash. The bar at the lower edge is the time.
"""

import math
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from sumo_env.networks.roads import Road
from sumo_env.rendering.labels import Box, beside
from sumo_env.rendering.notes import CRASH, EVENT, LIGHTS, NEAR_MISS, Mark, Notes
from sumo_env.rendering.scenery import FILM, Camera, scenery
from sumo_env.scene import Scene

SUPERSAMPLING = 2  # drawn this much larger, then averaged
RING = 4.0  # [m] radius of the ring around a car; further rings are 1 m larger each
# of marks and lines, by their kinds
COLOURS = {
    "": FILM.line,
    EVENT: FILM.in_event,
    CRASH: (255, 95, 95),
    NEAR_MISS: (255, 130, 215),
    **{name: FILM.lights[state] for state, name in LIGHTS.items()},
}


def draw(scene: Scene, road: Road, view: Mapping[str, Any], notes: Notes | None = None) -> NDArray[np.uint8]:
    """The picture of a scene with notes, shape (screen_height, screen_width, 3); view: as of `Camera.of`."""
    notes = notes or Notes()
    camera = Camera.of(scene, view, SUPERSAMPLING)
    canvas = scenery(scene, road, camera, FILM)
    pen = ImageDraw.Draw(canvas)
    radius: dict[str, float] = {}  # of the last ring around a vehicle [m]
    for mark in notes.marks:
        radius[mark.name] = radius.get(mark.name, RING - 1.0) + 1.0
        row, reach = scene.ids.index(mark.name), radius[mark.name] * camera.scale
        x, y = camera.place(scene.x.item(row), scene.y.item(row)).tolist()
        box = round(x - reach), round(y - reach), round(x + reach), round(y + reach)
        pen.ellipse(box, outline=COLOURS[mark.kind], width=max(round(camera.scale * 0.4), 2))
    picture = canvas.reduce(SUPERSAMPLING)
    font = _font(9 if picture.height < 100 else min(12 + picture.height // 50, 20))
    corner = _write_lines(picture, notes.lines, font)
    _write_beside_cars(picture, scene, Camera.of(scene, view), notes.marks, font, radius, corner)
    shown = np.array(picture)
    if notes.share is not None:
        bar = shown[-_bar(picture) :]
        bar[:], bar[:, : round(picture.width * notes.share)] = FILM.outline, FILM.line
    return shown


def _write_lines(picture: Image.Image, lines: Iterable[tuple[str, str]], font: Any) -> list[Box]:
    """Write kinds and texts into the upper left corner; returns what they cover."""
    pen, top, covered = ImageDraw.Draw(picture, "RGBA"), 5.0, []
    for kind, text in lines:
        _, _, right, bottom = pen.textbbox((8, top), text, font=font)
        covered.append(Box(0.0, top - 5, right + 8, bottom + 5))
        pen.rectangle(covered[-1], fill=(*FILM.outline, 235))
        pen.text((8, top), text, fill=COLOURS[kind], font=font)
        top = bottom + 10
    return covered


def _write_beside_cars(
    picture: Image.Image,
    scene: Scene,
    camera: Camera,
    marks: Iterable[Mark],
    font: Any,
    radius: Mapping[str, float],
    words: list[Box],
) -> None:
    """Write the words of marks beside their cars, where those are wholly in the picture.

    radius: of the largest ring around a vehicle [m]; words: written already, to which the new ones are added.
    """
    pen, whole = ImageDraw.Draw(picture), Box(0.0, 0.0, picture.width, picture.height - _bar(picture))
    cars = [_extent(scene, row, camera) for row in range(len(scene))]
    for mark in marks:
        car = cars[scene.ids.index(mark.name)]
        if not mark.text or not (whole.holds(car.left, car.top) and whole.holds(car.right, car.bottom)):
            continue
        left, top, right, bottom = font.getbbox(mark.text, stroke_width=2)
        reach, size = radius[mark.name] * camera.scale, (right - left, bottom - top)
        centre = (car.left + car.right) / 2, (car.top + car.bottom) / 2
        words.append(beside(centre, reach, size, whole, words, cars))
        corner = words[-1].left - left, words[-1].top - top
        pen.text(corner, mark.text, COLOURS[mark.kind], font, stroke_width=2, stroke_fill=FILM.outline)


def _extent(scene: Scene, row: int, camera: Camera) -> Box:
    """The upright box [px] around a vehicle."""
    length, width = scene.size(scene.ids[row])
    x, y = camera.place(scene.x.item(row), scene.y.item(row)).tolist()
    cos, sin = abs(math.cos(scene.heading.item(row))), abs(math.sin(scene.heading.item(row)))
    return Box.around(
        x, y, (cos * length + sin * width) * camera.scale, (sin * length + cos * width) * camera.scale
    )


def _bar(picture: Image.Image) -> int:
    """Height of the bar of the time [px]."""
    return max(picture.height // 60, 3)


@cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size=size)
