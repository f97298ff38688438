"""Which lanes are near a point: a grid over the plane, so that not all of them need be looked at."""

from __future__ import annotations

import math

import numpy as np

from sumo_env.compiled import borrowing, compiled
from sumo_env.models.lane_table import (
    CIRCULAR,
    COS,
    KIND,
    LENGTH,
    SIN,
    Floats,
    Integers,
    heading_at,
    position,
)

CELL = 2.0  # [m]
SAMPLE = 0.5  # [m] so fine that every cell which an area reaches into holds a sample of it and its margin
MARGIN = 1.0  # [m]


@compiled
def _samples(geometry: Floats, lane: int, beyond: float, beside: float) -> Floats:
    """Points [m] all over a lane, `beyond` its ends and `beside` its centre line [m] and a margin, shape (m, 2)."""
    along = np.arange(-beyond - MARGIN, geometry[lane, LENGTH] + beyond + MARGIN + SAMPLE, SAMPLE)
    across = np.arange(-beside - MARGIN, beside + MARGIN + SAMPLE, SAMPLE)
    points = np.empty((len(along) * len(across), 2))
    for i in range(len(along)):
        x, y = position(geometry, lane, along[i])
        cos, sin = geometry[lane, COS], geometry[lane, SIN]
        if geometry[lane, KIND] == CIRCULAR:
            heading = heading_at(geometry, lane, along[i])
            cos, sin = math.cos(heading), math.sin(heading)
        for k in range(len(across)):
            points[i * len(across) + k, 0] = x - across[k] * sin
            points[i * len(across) + k, 1] = y + across[k] * cos
    return points


def lane_grid(geometry: Floats, beyond: float, beside: float) -> tuple[Floats, Integers]:
    """The corner of a grid over all lanes [m], shape (2,), and the lanes near each cell, shape (columns, rows, most).

    Near is who is up to `beside` the centre line, and on up to `beyond` its ends [m], in the coordinates of the lane.
    Numbers of lanes rise and are padded with -1. Nothing is near the outermost cells. `geometry`: of a `LaneTable`.
    """
    samples = [_samples(geometry, lane, beyond, beside) for lane in range(len(geometry))]
    everywhere = np.concatenate(samples)
    corner = everywhere.min(axis=0) - CELL
    size = np.floor((everywhere.max(axis=0) - corner) / CELL).astype(int) + 2
    near = np.zeros((*size, len(geometry)), np.bool_)
    for lane, points in enumerate(samples):
        column, row = np.floor((points - corner) / CELL).astype(int).T
        near[column, row, lane] = True
    numbers = np.full((*size, near.sum(axis=2).max()), -1)
    place = near.cumsum(axis=2) - 1  # of a lane among those of its cell
    numbers[*np.nonzero(near)[:2], place[near]] = np.nonzero(near)[2]
    return corner, numbers


@borrowing
def cell(corner: Floats, near: Integers, x: float, y: float) -> tuple[int, int]:
    """Column and row in `near` of (x, y) [m]; `corner`, `near`: of `lane_grid`."""
    column = min(max(math.floor((x - corner[0]) / CELL), 0), near.shape[0] - 1)
    row = min(max(math.floor((y - corner[1]) / CELL), 0), near.shape[1] - 1)
    return column, row
