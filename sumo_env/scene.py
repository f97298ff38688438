"""The state of the traffic at one instant. Simulators produce scenes; observations, rewards and measures read them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

VEHICLE_LENGTH = 5.0  # [m] highway_env.vehicle.kinematics.Vehicle.LENGTH
VEHICLE_WIDTH = 2.0  # [m] Vehicle.WIDTH
PERCEPTION_DISTANCE = 200.0  # [m] 5 * Vehicle.MAX_SPEED, AbstractEnv.PERCEPTION_DISTANCE

Floats = NDArray[np.float64]


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
    """

    ids: tuple[str, ...]
    x: Floats
    y: Floats
    speed: Floats
    heading: Floats
    crashed: NDArray[np.bool_]
    time: float
    in_event: frozenset[str] = frozenset()

    def __deepcopy__(self, memo: dict[int, object]) -> Scene:
        return self  # immutable

    @property
    def vx(self) -> Floats:
        """Velocity to the east [m/s], shape (n,)."""
        return self.speed * np.cos(self.heading)

    @property
    def vy(self) -> Floats:
        """Velocity to the south [m/s], shape (n,)."""
        return self.speed * np.sin(self.heading)

    def __len__(self) -> int:
        return len(self.ids)
