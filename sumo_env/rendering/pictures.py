"""Pictures of a scene, drawn with Pillow: no display, no window, the same pixels on every machine.

The camera follows the ego as highway-env's does. The colours are those of the report's films: the ego is blue, further
learning cars are light blue, other cars are white, crashed ones red, and a car is yellow with a ring while a risk event
acts on it, whose kind is written beside it. In the corner are the time, the ego's speed and its last meta-action.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from sumo_env.networks.roads import Road
from sumo_env.rendering.markings import Points, markings
from sumo_env.scene import CAR_SIZE, VEHICLE_LENGTH, VEHICLE_WIDTH, Scene

Colour = tuple[int, int, int]

GROUND: Colour = (205, 213, 198)
ASPHALT: Colour = (117, 123, 132)
WHITE: Colour = (244, 245, 243)
OUTLINE: Colour = (43, 49, 56)
EGO: Colour = (0, 114, 178)
OTHER: Colour = (233, 237, 241)
CRASHED: Colour = (229, 72, 77)
IN_EVENT: Colour = (255, 196, 0)
GLASS: Colour = (70, 80, 90)
HEADLIGHT: Colour = (255, 250, 200)

SUPERSAMPLING = 2  # drawn this much larger, then averaged
RING = 4.0  # [m] radius of the ring around a car in a risk event, and around a crashed ego

_HALF = VEHICLE_LENGTH / 2, VEHICLE_WIDTH / 2
# Parts of a car in its own frame (x ahead, y right) [m].
_BODY = np.array([(-_HALF[0], -_HALF[1]), (_HALF[0], -_HALF[1]), (_HALF[0], _HALF[1]), (-_HALF[0], _HALF[1])])
_WINDSCREEN = np.array([(0.45, -0.68), (1.25, -0.85), (1.25, 0.85), (0.45, 0.68)])
_REAR_WINDOW = np.array([(-1.9, -0.75), (-1.5, -0.65), (-1.5, 0.65), (-1.9, 0.75)])
_HEADLIGHTS = tuple(
    np.array([(2.05, side - 0.25), (2.5, side - 0.25), (2.5, side + 0.25), (2.05, side + 0.25)])
    for side in (-0.65, 0.65)
)


def draw(
    scene: Scene,
    road: Road,
    config: Mapping[str, Any],
    action: str = "",
    kinds: Mapping[str, str] | None = None,
) -> NDArray[np.uint8]:
    """The picture of a scene, shape (screen_height, screen_width, 3).

    Args:
        scene: what is drawn.
        road: the lanes.
        config: size, zoom and camera by highway-env's keys: ``screen_width``, ``screen_height`` [px], ``scaling``
            [px/m], ``centering_position`` (the ego's place as a share of the picture).
        action: name of the ego's last action, "" for none.
        kinds: of the risk events that act now, by vehicle.
    """
    width, height = int(config["screen_width"]), int(config["screen_height"])
    scale = float(config["scaling"]) * SUPERSAMPLING
    # The camera moves by whole drawn pixels, so that the road does not flicker.
    across, down = config["centering_position"]
    left = round(float(scene.x[0]) * scale - across * width * SUPERSAMPLING)
    top = round(float(scene.y[0]) * scale - down * height * SUPERSAMPLING)
    size = width * SUPERSAMPLING, height * SUPERSAMPLING
    canvas = Image.new("RGB", size, GROUND)
    pen = ImageDraw.Draw(canvas)
    corner = np.array([left, top])
    for layer in _layers(road):
        for polygon in layer.within(corner / scale, (corner + size) / scale):
            pen.polygon(_pixels(polygon * scale - corner), fill=layer.colour)
    labels: list[tuple[float, float, str]] = []
    reach = max([VEHICLE_LENGTH, *(length for length, _ in scene.sizes.values())]) * scale
    for row in range(len(scene) - 1, -1, -1):  # the ego last, on top of the others
        x, y = float(scene.x[row]) * scale - left, float(scene.y[row]) * scale - top
        if -reach < x < size[0] + reach and -reach < y < size[1] + reach:
            extent = scene.size(scene.ids[row])
            _draw_vehicle(pen, x, y, float(scene.heading[row]), scale, _colour(scene, row), extent)
            if scene.ids[row] in scene.in_event:
                _draw_ring(pen, x, y, scale)
                labels.append((x, y - RING * scale, (kinds or {}).get(scene.ids[row], "")))
            if row < scene.cars and scene.crashed[row]:
                _draw_ring(pen, x, y, scale, CRASHED)
    picture = canvas.reduce(SUPERSAMPLING)
    font = _font(9 if height < 100 else min(12 + height // 50, 20))
    pen = ImageDraw.Draw(picture, "RGBA")
    for x, y, kind in labels:
        place = x / SUPERSAMPLING, y / SUPERSAMPLING
        pen.text(place, kind, fill=IN_EVENT, font=font, anchor="mb", stroke_width=2, stroke_fill=OUTLINE)
    text = f"{scene.time:.1f} s   {float(scene.speed[0]):.1f} m/s   {action}".rstrip()
    if scene.crashed[0]:
        text += "   crash"
    _, _, right, bottom = pen.textbbox((8, 5), text, font=font)
    pen.rectangle((0, 0, right + 8, bottom + 5), fill=(*OUTLINE, 200))
    pen.text((8, 5), text, fill=WHITE, font=font)
    return np.array(picture)


@lru_cache(maxsize=8)
def _layers(road: Road) -> tuple[_Layer, ...]:
    """What is painted of a road, from below."""
    paint = markings(road)
    return (
        _Layer(paint.rims, WHITE),
        _Layer(paint.surfaces, ASPHALT),
        _Layer(paint.dashes, WHITE),
    )


@cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size=size)


class _Layer:
    """Polygons of one colour, found by place."""

    def __init__(self, polygons: tuple[Points, ...], colour: Colour) -> None:
        self.polygons, self.colour = polygons, colour
        self._low = np.array([polygon.min(axis=0) for polygon in polygons]).reshape(-1, 2)
        self._high = np.array([polygon.max(axis=0) for polygon in polygons]).reshape(-1, 2)

    def within(self, low: Points, high: Points) -> list[Points]:
        """Those whose bounding box meets the box from `low` to `high` [m]."""
        meet = (self._low <= high).all(axis=1) & (self._high >= low).all(axis=1)
        return [self.polygons[k] for k in np.flatnonzero(meet)]


def _draw_vehicle(
    pen: ImageDraw.ImageDraw,
    x: float,
    y: float,
    heading: float,
    scale: float,
    colour: Colour,
    size: tuple[float, float],
) -> None:
    """A vehicle of this length and width [m] around (x, y) [drawn px]: a car, stretched."""
    cos, sin = math.cos(heading) * scale, math.sin(heading) * scale
    stretch = np.array(size) / CAR_SIZE
    turn = stretch[:, None] * np.array([(cos, sin), (-sin, cos)])

    def place(part: Points) -> list[tuple[int, int]]:
        return _pixels(part @ turn + (x, y))

    pen.polygon(place(_BODY), fill=colour)
    if scale >= 4.0:  # smaller cars have no room for details
        pen.polygon(place(_WINDSCREEN), fill=GLASS)
        pen.polygon(place(_REAR_WINDOW), fill=_blend(GLASS, colour))
        for light in _HEADLIGHTS:
            pen.polygon(place(light), fill=HEADLIGHT)
    pen.polygon(place(_BODY), outline=OUTLINE, width=max(round(scale * 0.15), 1))


def _draw_ring(pen: ImageDraw.ImageDraw, x: float, y: float, scale: float, colour: Colour = IN_EVENT) -> None:
    """A ring around the car at (x, y) [drawn px]."""
    radius = RING * scale
    box = (round(x - radius), round(y - radius), round(x + radius), round(y + radius))
    pen.ellipse(box, outline=colour, width=max(round(scale * 0.4), 2))


def _colour(scene: Scene, row: int) -> Colour:
    """The colour of a car; a crashed learning car keeps its own inside a red ring."""
    if row < scene.cars:
        return _blend(EGO, OTHER) if row else EGO
    if scene.crashed[row]:
        return CRASHED
    return IN_EVENT if scene.ids[row] in scene.in_event else OTHER


def _blend(one: Colour, other: Colour) -> Colour:
    red, green, blue = ((a + b) // 2 for a, b in zip(one, other, strict=True))
    return red, green, blue


def _pixels(points: Points) -> list[tuple[int, int]]:
    """Corners rounded to pixels (Pillow would cut them off, which shifts everything by half a pixel)."""
    rounded = np.rint(points).astype(np.int64)
    return [(column, row) for column, row in rounded.tolist()]
