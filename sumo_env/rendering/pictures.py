"""Pictures for people: the scenery, and notes that say what happens.

The ego is blue, further learning cars are light blue, other cars are white and crashed ones red. Rings with a word mark
a car in a risk event (yellow, with the kind of the event), one with which the ego crashes (red, with its name), and one
to which it comes near (pink, with the time to the collision). In the corner are the time, the ego's speed and its last
meta-action, and below a red or yellow light ahead, a near miss and a crash. The bar at the lower edge is the time.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ImageDraw, ImageFont

from sumo_env.networks.roads import Road
from sumo_env.rendering.notes import CRASH, EVENT, LIGHTS, NEAR_MISS, Notes
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
    """The picture of a scene, shape (screen_height, screen_width, 3).

    Args:
        scene: what is drawn.
        road: the lanes.
        view: size, zoom and camera, see `Camera.of`.
        notes: what is written into it.
    """
    notes = notes or Notes()
    camera = Camera.of(scene, view, SUPERSAMPLING)
    canvas = scenery(scene, road, camera, FILM)
    pen, labels = ImageDraw.Draw(canvas), []
    radius: dict[str, float] = {}  # of the last ring around a vehicle [m]
    for mark in notes.marks:
        radius[mark.name] = radius.get(mark.name, RING - 1.0) + 1.0
        row, reach = scene.ids.index(mark.name), radius[mark.name] * camera.scale
        x, y = camera.place(scene.x.item(row), scene.y.item(row)).tolist()
        box = round(x - reach), round(y - reach), round(x + reach), round(y + reach)
        pen.ellipse(box, outline=COLOURS[mark.kind], width=max(round(camera.scale * 0.4), 2))
        labels.append((x, y - reach, radius[mark.name] - RING, mark))
    picture = canvas.reduce(SUPERSAMPLING)
    pen = ImageDraw.Draw(picture, "RGBA")
    size = 9 if picture.height < 100 else min(12 + picture.height // 50, 20)
    font = _font(size)
    for x, y, below, mark in labels:  # above those of the same vehicle
        place = x / SUPERSAMPLING, y / SUPERSAMPLING - size * below
        pen.text(place, mark.text, COLOURS[mark.kind], font, "mb", stroke_width=2, stroke_fill=FILM.outline)
    top, background = 5.0, (*FILM.outline, 235)
    for kind, text in notes.lines:
        _, _, right, bottom = pen.textbbox((8, top), text, font=font)
        pen.rectangle((0, top - 5, right + 8, bottom + 5), fill=background)
        pen.text((8, top), text, fill=COLOURS[kind], font=font)
        top = bottom + 10
    shown = np.array(picture)
    if notes.share is not None:
        bar = shown[-max(picture.height // 60, 3) :]
        bar[:], bar[:, : round(picture.width * notes.share)] = FILM.outline, FILM.line
    return shown


@cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size=size)
