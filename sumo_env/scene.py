"""The state of the traffic at one instant. Simulators produce scenes; observations, rewards and measures read them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

VEHICLE_LENGTH = 5.0  # [m] highway_env.vehicle.kinematics.Vehicle.LENGTH
VEHICLE_WIDTH = 2.0  # [m] Vehicle.WIDTH
CAR_SIZE = (VEHICLE_LENGTH, VEHICLE_WIDTH)
PERCEPTION_DISTANCE = 200.0  # [m] 5 * Vehicle.MAX_SPEED, AbstractEnv.PERCEPTION_DISTANCE

Floats = NDArray[np.float64]
UNLIT, RED, YELLOW, GREEN = -1, 0, 1, 2  # states of a traffic light; UNLIT where there is none


class Light(NamedTuple):
    """The next traffic light on the ego's way: its state, and how far its stop line is from the ego's front [m]."""

    state: int = UNLIT
    distance: float = inf


NO_LIGHT = Light()


@dataclass(frozen=True, slots=True)
class Scene:
    """Struct of arrays, one row per vehicle, row 0 the ego; highway-env's coordinates (x east, y *down*).

    Attributes:
        ids: names of the vehicles, ``"ego"`` first.
        x, y: centres of the vehicles [m], shape (n,).
        speed: along the heading [m/s], shape (n,).
        heading: from +x towards +y [rad], shape (n,).
        crashed: whether the vehicle has crashed, shape (n,).
        time: since the start of the episode [s].
        in_event: names of the vehicles on which a risk event acts now.
        sizes: length and width [m] of the vehicles that do not have highway-env's size.
        light: the next traffic light on the ego's way.
    """

    ids: tuple[str, ...]
    x: Floats
    y: Floats
    speed: Floats
    heading: Floats
    crashed: NDArray[np.bool_]
    time: float
    in_event: frozenset[str] = frozenset()
    sizes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    light: Light = NO_LIGHT

    def size(self, name: str) -> tuple[float, float]:
        """Length and width of a vehicle [m]."""
        return self.sizes.get(name, CAR_SIZE)

    def __deepcopy__(self, memo: dict[int, object]) -> Scene:
        return self  # immutable

    def __len__(self) -> int:
        return len(self.ids)
