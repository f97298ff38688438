"""Where words stand beside cars: inside the picture, and neither on the ego nor on each other."""

from collections.abc import Sequence
from typing import NamedTuple

FURTHER = 6  # steps of its own height that a word moves away from its ring, at most
STEP = 0.08  # of its area [px2]: what a word rather covers of other cars than to move on
HIDDEN = 100.0  # how much worse it is to cover the ego or words, or to be cut off, than to cover another car
# where a word is tried, from the middle of its car, in this order: y points down
SIDES = ((0, -1), (0, 1), (1, 0), (-1, 0), (1, -1), (-1, -1), (1, 1), (-1, 1))


class Box(NamedTuple):
    """An upright rectangle [px]."""

    left: float
    top: float
    right: float
    bottom: float

    @classmethod
    def around(cls, x: float, y: float, width: float, height: float) -> "Box":
        """By its middle and size."""
        return cls(x - width / 2, y - height / 2, x + width / 2, y + height / 2)

    def holds(self, x: float, y: float) -> bool:
        """Whether a point is inside."""
        return self.left < x < self.right and self.top < y < self.bottom

    def common(self, other: "Box") -> float:
        """Area of what two have in common [px2]."""
        width = min(self.right, other.right) - max(self.left, other.left)
        height = min(self.bottom, other.bottom) - max(self.top, other.top)
        return max(width, 0.0) * max(height, 0.0)


def beside(
    centre: tuple[float, float],
    reach: float,
    size: tuple[float, float],
    picture: Box,
    words: Sequence[Box],
    cars: Sequence[Box],
) -> Box:
    """The place of a word of this size beside a car's middle: near, and free as far as there is such a place [px].

    reach: radius of the car's ring; picture: what has to hold the word; words: written already; cars: the ego first.
    """
    area, costs = size[0] * size[1], dict[Box, float]()
    for further in range(FURTHER + 1):
        away = reach + further * size[1]
        for right, down in SIDES:
            x, y = centre[0] + right * (away + size[0] / 2), centre[1] + down * (away + size[1] / 2)
            box = Box.around(x, y, *size)
            hidden = area - box.common(picture) + sum(map(box.common, (*words, *cars[:1])))
            costs[box] = HIDDEN * hidden + sum(map(box.common, cars[1:])) + STEP * area * further
    return min(costs, key=costs.__getitem__)
