"""Driving along paths without any simulator: the seconds before an episode of the intersection begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sumo_env.compiled import compiled
from sumo_env.models.give_way import regulate
from sumo_env.models.idm import path_accelerations
from sumo_env.models.lane_table import LENGTH, Floats, Integers, heading_at, position


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
    exempt: NDArray[np.bool_],
    yielding: NDArray[np.bool_],
    steps: int,
    interval: int,
    dt: float,
) -> None:
    """Drive `steps` steps of `dt` [s] by IDM, with `regulate` every `interval` steps; changes everything in place.

    s: along the lanes [m], shape (n,); the others as in `path_accelerations` and `regulate`.
    """
    for step in range(1, steps + 1):
        acceleration = path_accelerations(
            geometry, successors, routes, stage, x, y, speed, heading, target_speed, drivers
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
