"""The rule-based driver of the field: IDM for speed, MOBIL for lanes, acted out with the ego's meta-actions.

highway-env's ``IDMVehicle`` in the ego's seat, with its parameters. It knows no road and sees what an agent sees, so
that one policy drives in both simulators. It takes whoever is within its corridor for its leader, and looks at no
crossing traffic: on purpose, it is the careful driver that does.
"""

from __future__ import annotations

import math

import numpy as np

from agents.rules.perception import LANE_WIDTH, SIDES, Rules, View

ACCELERATION, DECELERATION = 3.0, 5.0  # [m/s2] comfortable
TIME_GAP = 1.5  # [s]
DISTANCE = 10.0  # [m] between centres in a jam
EXPONENT = 4.0
GAIN = 0.2  # [m/s2] that a lane change has to bring
SAFE_BRAKING = 2.0  # [m/s2] that a new follower may be asked for
HOLD = 1.0  # [m/s2] the target speed is kept for smaller accelerations
CORRIDOR = LANE_WIDTH / 2  # [m] to either side


class IDM(Rules):
    """IDM and MOBIL."""

    def decide(self, view: View) -> str:
        """The lane change that MOBIL wants, else the next higher or lower target speed as IDM accelerates or brakes."""
        along, across = _along(view)
        own = self._behind(view, along, across, 0)
        gains = {
            name: self._behind(view, along, across, side) - own
            for name, side in SIDES.items()
            if name in self._numbers and self._lanes[side] and self._is_safe(view, along, across, side)
        }
        best = max(gains, key=gains.__getitem__, default=None)
        if best is not None and gains[best] > GAIN:
            return best
        return "FASTER" if own > HOLD else "SLOWER" if own < -HOLD else "IDLE"

    def _behind(self, view: View, along: np.ndarray, across: np.ndarray, side: int) -> float:
        """IDM's acceleration [m/s2] behind the leader on this lane."""
        ahead = (np.abs(across - side * LANE_WIDTH) < CORRIDOR) & (along > 0)
        top = float(self._target_speeds[-1])
        if not ahead.any():
            return acceleration(view.speed, top, math.inf, 0.0)
        leader = np.flatnonzero(ahead)[along[ahead].argmin()]
        speed = view.speeds[leader] * math.cos(_turned(view, along)[leader])
        return acceleration(view.speed, top, float(along[leader]), float(speed))

    def _is_safe(self, view: View, along: np.ndarray, across: np.ndarray, side: int) -> bool:
        """Is nobody beside the ego, and need the new follower not brake hard?"""
        there = np.abs(across - side * LANE_WIDTH) < CORRIDOR
        same_way = np.cos(_turned(view, along)) > 0
        behind = there & same_way & (along <= 0)
        if not behind.any():
            return True
        follower = np.flatnonzero(behind)[along[behind].argmax()]
        speed = float(view.speeds[follower])
        return acceleration(speed, max(speed, 1.0), float(-along[follower]), view.speed) > -SAFE_BRAKING


def acceleration(speed: float, desired: float, gap: float, leader: float) -> float:
    """The intelligent driver model [m/s2]: speeds [m/s], `gap` between centres [m], inf without a leader."""
    free = 1.0 - (max(speed, 0.0) / desired) ** EXPONENT
    wanted = (
        DISTANCE + speed * TIME_GAP + speed * (speed - leader) / (2 * math.sqrt(ACCELERATION * DECELERATION))
    )
    return ACCELERATION * (free - (wanted / max(gap, 0.01)) ** 2)


def _along(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Where the others are along the arc that the ego drives, and to the right of it [m], (n,) each."""
    x, y = view.positions.T
    if abs(view.curvature) < 1e-3:
        return x, y
    radius = 1.0 / view.curvature
    right = radius - np.sign(radius) * np.hypot(x, radius - y)
    return abs(radius) * np.arctan2(x, np.abs(radius) - np.sign(radius) * y), right


def _turned(view: View, along: np.ndarray) -> np.ndarray:
    """Headings of the others against that of the arc where they are [rad], (n,)."""
    return view.headings - view.curvature * along
