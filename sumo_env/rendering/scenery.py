"""What is to be seen of a scene: the road, its traffic lights and the vehicles, drawn with Pillow.

No display, no window, the same pixels on every machine. The camera follows the ego as highway-env's does.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from sumo_env.contacts.rectangles import state_of
from sumo_env.networks.roads import Road
from sumo_env.rendering.markings import LINE_WIDTH, Points, markings
from sumo_env.scene import CAR_SIZE, LETTERS, VEHICLE_LENGTH, VEHICLE_WIDTH, Scene, is_obstacle

Colour = Any  # red, green and blue, or one grey


class Paint(NamedTuple):
    """The colours of a picture."""

    ground: Colour
    asphalt: Colour
    line: Colour
    outline: Colour
    ego: Colour
    further: Colour  # of further learning cars
    other: Colour
    crashed: Colour  # also of learning cars, unless `in_event` is given: those have a mark then
    obstacle: Colour
    lights: tuple[Colour, Colour, Colour, Colour]  # red, yellow, green, and off
    # of cars on which a risk event acts; None where that is not to be seen, nor windows and headlights
    in_event: Colour = None

    def in_grey(self, weights: NDArray[np.float64]) -> "Paint":
        """The greys of these colours, by weights of red, green and blue."""

        def grey(colour: Colour) -> int:
            return int(np.dot(colour, weights).clip(0, 255))

        greys: dict[str, Any] = {name: grey(getattr(self, name)) for name in self._fields[:9]}
        greys["lights"] = tuple(grey(light) for light in self.lights)
        return self._replace(**greys, in_event=None)


FILM = Paint(
    ground=(205, 213, 198),
    asphalt=(117, 123, 132),
    line=(244, 245, 243),
    outline=(43, 49, 56),
    ego=(0, 114, 178),
    further=(116, 175, 209),
    other=(233, 237, 241),
    crashed=(229, 72, 77),
    obstacle=(150, 90, 50),
    lights=((255, 60, 60), (255, 190, 0), (40, 190, 90), (60, 65, 70)),
    in_event=(255, 196, 0),
)
GLASS, REAR_GLASS, HEADLIGHT = (70, 80, 90), (151, 158, 165), (255, 250, 200)
# WorldSurface.GREY and WHITE, VehicleGraphics.BLACK, GREEN, BLUE, RED, YELLOW; lights, which it lacks, are three greys
HIGHWAY_ENVS = Paint(
    ground=(100, 100, 100),
    asphalt=(100, 100, 100),
    line=(255, 255, 255),
    outline=(60, 60, 60),
    ego=(50, 200, 0),
    further=(50, 200, 0),
    other=(100, 200, 255),
    crashed=(255, 100, 100),
    obstacle=(200, 200, 0),
    lights=((60, 0, 0), (255, 255, 0), (0, 255, 100), (60, 60, 60)),
)

_HALF = VEHICLE_LENGTH / 2, VEHICLE_WIDTH / 2
# Parts of a car in its own frame (x ahead, y right) [m].
_BODY = np.array([(-_HALF[0], -_HALF[1]), (_HALF[0], -_HALF[1]), (_HALF[0], _HALF[1]), (-_HALF[0], _HALF[1])])
_WINDSCREEN = np.array([(0.45, -0.68), (1.25, -0.85), (1.25, 0.85), (0.45, 0.68)])
_REAR_WINDOW = np.array([(-1.9, -0.75), (-1.5, -0.65), (-1.5, 0.65), (-1.9, 0.75)])
_HEADLIGHTS = tuple(
    np.array([(2.05, side - 0.25), (2.5, side - 0.25), (2.5, side + 0.25), (2.05, side + 0.25)])
    for side in (-0.65, 0.65)
)


class Camera(NamedTuple):
    """The part of the plane that a picture shows: its upper left corner [px], its size [px], and pixels per metre."""

    corner: NDArray[np.int64]
    size: NDArray[np.int64]
    scale: float

    @classmethod
    def of(cls, scene: Scene, view: Mapping[str, Any], finer: int = 1) -> "Camera":
        """By highway-env's keys: ``screen_width``, ``screen_height``, ``scaling``, ``centering_position``.

        finer: pixels along each side of one of the picture. The camera moves by whole pixels, so that the road does not
        flicker.
        """
        size = np.array([int(view["screen_width"]), int(view["screen_height"])]) * finer
        scale = float(view["scaling"]) * finer
        ego = np.array([scene.x.item(0), scene.y.item(0)]) * scale
        corner = ego - size * np.array(view["centering_position"])
        return cls(np.rint(corner).astype(np.int64), size, scale)

    def place(self, x: float, y: float) -> Points:
        """Where a point of the plane [m] is in the picture [px]."""
        return np.array([x, y]) * self.scale - self.corner


def scenery(scene: Scene, road: Road, camera: Camera, paint: Paint, mode: str = "RGB") -> Image.Image:
    """The road and what is on it; mode: "RGB", or "L" where the colours are greys."""
    canvas = Image.new(mode, tuple(camera.size.tolist()), paint.ground)
    pen, scale = ImageDraw.Draw(canvas), camera.scale
    rims, surfaces, lines, lights = _painted(road)
    is_coarse = LINE_WIDTH * scale < 1.0  # then lines are as wide as a pixel, as in highway-env
    for polygon, _ in (surfaces if is_coarse else rims).within(camera):
        if is_coarse:
            pen.line([*polygon, polygon[0]], fill=paint.line, width=3)
        else:
            pen.polygon(polygon, fill=paint.line)
    for polygon, _ in surfaces.within(camera):
        pen.polygon(polygon, fill=paint.asphalt)
    for polygon, _ in lines.within(camera):
        if is_coarse:
            one, other = polygon[: len(polygon) // 2], polygon[::-1]
            middle = [((a + c) // 2, (b + d) // 2) for (a, b), (c, d) in zip(one, other, strict=False)]
            pen.line(middle, fill=paint.line)
        else:
            pen.polygon(polygon, fill=paint.line)
    for polygon, (signal, number) in lights.within(camera) if scene.signals else ():
        letter = scene.signals.get(signal, "")[number : number + 1]
        pen.polygon(polygon, fill=paint.lights[LETTERS.get(letter, -1)])
    reach = max([VEHICLE_LENGTH, *(length for length, _ in scene.sizes.values())]) * scale
    for row in range(len(scene) - 1, -1, -1):  # the ego last, on top of the others
        x, y = camera.place(scene.x.item(row), scene.y.item(row)).tolist()
        if -reach < x < camera.size[0] + reach and -reach < y < camera.size[1] + reach:
            _draw_vehicle(pen, scene, row, camera, paint)
    return canvas


class _Layer:
    """Polygons [m] that are found by place, and something that is known of each."""

    def __init__(self, polygons: Sequence[Points], known: Sequence[Any] = ()) -> None:
        self._polygons, self._known = polygons, known or [None] * len(polygons)
        self._low = np.array([polygon.min(axis=0) for polygon in polygons]).reshape(-1, 2)
        self._high = np.array([polygon.max(axis=0) for polygon in polygons]).reshape(-1, 2)

    def within(self, camera: Camera) -> Iterator[tuple[list[tuple[int, int]], Any]]:
        """Those whose bounding box meets the picture, as pixels, with what is known of them."""
        low, high = camera.corner / camera.scale, (camera.corner + camera.size) / camera.scale
        meet = (self._low <= high).all(axis=1) & (self._high >= low).all(axis=1)
        for k in np.flatnonzero(meet).tolist():
            yield _pixels(self._polygons[k] * camera.scale - camera.corner), self._known[k]


@lru_cache(maxsize=8)
def _painted(road: Road) -> tuple[_Layer, _Layer, _Layer, _Layer]:
    """Rims, surfaces and lines of a road, and its lights, with the traffic light and the place of its letter."""
    paint = markings(road)
    lights = _Layer([light[0] for light in paint.lights], [light[1:] for light in paint.lights])
    return _Layer(paint.rims), _Layer(paint.surfaces), _Layer((*paint.dashes, *paint.lines)), lights


def _draw_vehicle(pen: ImageDraw.ImageDraw, scene: Scene, row: int, camera: Camera, paint: Paint) -> None:
    """A vehicle of a scene: a car, stretched."""
    x, y, _, heading = state_of(scene, row)
    centre, scale, colour = camera.place(x, y), camera.scale, _colour(scene, row, paint)
    cos, sin = math.cos(heading) * scale, math.sin(heading) * scale
    # Pillow draws the pixels of both edges
    stretch = (np.array(scene.size(scene.ids[row])) - 1.0 / scale) / CAR_SIZE
    turn = stretch[:, None] * np.array([(cos, sin), (-sin, cos)])

    def place(part: Points) -> list[tuple[int, int]]:
        return _pixels(part @ turn + centre)

    pen.polygon(place(_BODY), fill=colour)
    is_car = paint.in_event is not None and colour != paint.obstacle
    if is_car and scale >= 4.0:  # smaller cars have no room for details
        pen.polygon(place(_WINDSCREEN), fill=GLASS)
        pen.polygon(place(_REAR_WINDOW), fill=REAR_GLASS)
        for light in _HEADLIGHTS:
            pen.polygon(place(light), fill=HEADLIGHT)
    pen.polygon(place(_BODY), outline=paint.outline, width=max(round(scale * 0.15), 1))


def _colour(scene: Scene, row: int, paint: Paint) -> Colour:
    """The colour of a vehicle, or of an obstacle, also of one that is hit."""
    if is_obstacle(scene.ids[row]):
        return paint.obstacle
    if scene.crashed[row] and (row >= scene.cars or paint.in_event is None):
        return paint.crashed
    if row < scene.cars:
        return paint.further if row else paint.ego
    is_marked = paint.in_event is not None and scene.ids[row] in scene.in_event
    return paint.in_event if is_marked else paint.other


def _pixels(points: Points) -> list[tuple[int, int]]:
    """Corners rounded to pixels (Pillow would cut them off, which shifts everything by half a pixel)."""
    rounded = np.rint(points).astype(np.int64)
    return [(column, row) for column, row in rounded.tolist()]
