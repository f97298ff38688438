"""Driving along paths without any simulator: the seconds before an episode of the intersection begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sumo_env.compiled import compiled
from sumo_env.models.give_way import regulate
from sumo_env.models.idm import accelerations_along
from sumo_env.models.lane_grid import cell
from sumo_env.models.lane_table import LENGTH, Floats, Integers, heading_at, local_coordinates, position


@compiled
def warm_up(
    geometry: Floats,
    successors: Integers,
    routes: Integers,
    stage: Integers,
    s: Floats,
    x: Floats,
    y: Floats,
    heading: Floats,
    speed: Floats,
    target_speed: Floats,
    drivers: Floats,
    corner: Floats,
    near: Integers,
    exempt: NDArray[np.bool_],
    yielding: NDArray[np.bool_],
    steps: int,
    interval: int,
    dt: float,
) -> None:
    """Drive `steps` steps of `dt` [s] by IDM, with `regulate` every `interval` steps; changes everything in place.

    s: along the lanes [m], shape (n,); corner, near: of a `lane_grid` of the lanes on which vehicles are leaders; the
    others as in `accelerations_along` and `regulate`.
    """
    on, lat = np.empty((len(x), len(geometry))), np.empty((len(x), len(geometry)))
    for step in range(1, steps + 1):
        on[:] = np.inf
        for i in range(len(x)):
            own = routes[i, stage[i]]
            on[i, own], lat[i, own] = local_coordinates(geometry, own, x[i], y[i])
            column, row = cell(corner, near, x[i], y[i])
            for k in range(near.shape[2]):
                lane = near[column, row, k]
                if lane >= 0:
                    on[i, lane], lat[i, lane] = local_coordinates(geometry, lane, x[i], y[i])
        acceleration = accelerations_along(
            geometry, successors, routes, stage, on, lat, speed, heading, target_speed, drivers
        )
        if step % interval == 0:
            regulate(geometry, routes, stage, x, y, speed, heading, exempt, target_speed, yielding)
        s += speed * dt
        speed += acceleration * dt
        for i in range(len(x)):
            length = geometry[routes[i, stage[i]], LENGTH]
            if s[i] > length and stage[i] < 2:
                s[i] -= length
                stage[i] += 1
            lane = routes[i, stage[i]]
            x[i], y[i] = position(geometry, lane, s[i])
            heading[i] = heading_at(geometry, lane, s[i])
