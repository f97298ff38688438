"""The independent truth: vehicles as shapely's polygons."""

import numpy as np
import shapely

from sumo_env.contacts.rectangles import Half, State

CAR: Half = (2.5, 1.0)  # half its length and width [m]
CORNERS = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])  # in half sizes


def polygons(x, y, heading, half: Half = CAR) -> np.ndarray:
    """Polygons of vehicles at x, y [m] with these headings [rad]: arrays of one shape, which is the result's.

    half: their half size [m].
    """
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    along, across = (CORNERS * half).T
    x, y = x[..., None] + along * cos - across * sin, y[..., None] + along * sin + across * cos
    return shapely.polygons(np.stack([x, y], axis=-1))


def state(x: float, y: float, heading: float = 0.0, speed: float = 0.0) -> State:
    return x, y, speed, heading


def rows(poses: np.ndarray) -> list[State]:
    """States from the poses of n vehicles, shape (n, 3): x, y [m], heading [rad]."""
    return [state(*pose) for pose in poses.tolist()]
