"""The careful driver: one rule for every task with highway-env's kinematics observation and meta-actions.

It knows no road. It extrapolates every vehicle that it sees, tries all plans of three meta-actions in a small model
of its own motion, and takes the first action of the plan that gets farthest without coming too close to anybody. "Too
close" has a price rather than a limit; where no plan avoids a collision, it brakes.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np

from agents.rules.perception import LANE_WIDTH, SIDES, Rules, View

STEP = 0.25  # [s] of the prediction
HORIZON = 4.0  # [s]
PLANNED = 3  # actions in a plan, one a second; afterwards the commanded speed is held
SPEED_LAG = 0.6  # [s] time constant of the ego's speed control
LATERAL_LAG = 0.5  # [s] time constant of a lane change
# Vehicles of 5 x 2 m: three discs cover one, and all points within a radius of its middle line cover it, too.
DISCS = np.array([-1.67, 0.0, 1.67])  # [m] centres along the vehicle
RADIUS = 1.3  # [m]
MARGIN = 0.2  # [m] beyond contact
# [m/s] more margin for what lies farther ahead: a little for traffic along the own road, more for crossing traffic,
# whose way is less certain.
GROWTH, CROSSING_GROWTH = 0.15, 0.6
# Price [m of way] of being where another vehicle will be so much later [s], or was so much earlier: 0 is a collision,
# the others are a short headway, or a narrow escape in a crossing.
PRICES = {0.0: 1000.0, 0.5: 300.0, -0.5: 200.0, 1.0: 100.0}
FORGETTING = 2.0  # [s] the price of what is so far ahead counts 1/e: there is time to react
UNSAFE = 300.0  # [m of way] where every plan costs more than this, the cheapest and slowest one is taken
LANE_CHANGE = 3.0  # [m of way] price of a lane change
BRAKING = 2.0  # [s] vehicles that brake go on braking for so long
# An ego that cannot change lanes may be on a route that turns across the oncoming lane: oncoming cars so near count as
# nearer to its own lane than they are.
TURN_AHEAD, TURN_SHIFT = 25.0, 2.0  # [m] ahead, [m] to the right
GAP = 6.0  # [m] between centres along a curve: a vehicle length and a little
SPEED_CHANGES = {"SLOWER": -1, "FASTER": 1}

FUTURE = np.arange(1, round(HORIZON / STEP) + 1) * STEP  # [s] times at which the plans are judged
SPAN = 1.0  # [s] the ego is followed so much before and beyond, to compare it with others at other times
TIMES = np.arange(-round(SPAN / STEP), round((HORIZON + SPAN) / STEP) + 1) * STEP


class Careful(Rules):
    """Drives by prediction. ``caution``: factor on the margins that it keeps and on the price of being closer."""

    def __init__(self, env: gym.Env[Any, Any], caution: float = 1.0) -> None:
        super().__init__(env)
        self._caution = caution
        known = [
            name for name in ("IDLE", "SLOWER", "FASTER", "LANE_LEFT", "LANE_RIGHT") if name in self._numbers
        ]
        plans: list[tuple[str, list[int]]] = []  # of equal plans the first one is taken
        for first in known:
            for later in product((0, -1, 1), repeat=PLANNED - 1):
                changes = [SPEED_CHANGES.get(first, 0), *later]
                if not {-1, 1} <= set(changes):  # speeding up in order to brake is creeping into a crossing
                    plans.append((first, changes))
        self._first = np.array([first for first, _ in plans])
        self._sides = np.array([SIDES.get(first, 0) for first, _ in plans])
        self._changes = np.array([changes for _, changes in plans])

    def decide(self, view: View) -> str:
        """The first action of the best plan."""
        way = self._way(view.speed)
        price = self._price(view, way)
        gain = way[:, len(TIMES) - 1 - round(SPAN / STEP)] - price
        possible = np.array([side == 0 or self._lanes[side] for side in self._sides])
        if self._action is None:  # nothing is known yet about how the others move
            possible &= np.isin(self._first, ("IDLE", "SLOWER"))
        if price[possible].min() > UNSAFE:
            gain = -price - 1e-3 * way[:, -1]
        return str(self._first[np.argmax(np.where(possible, gain, -np.inf))])

    def _way(self, speed: float) -> np.ndarray:
        """Way of each plan [m] at each of TIMES, (plans, times), with a first-order speed control."""
        index = np.full(len(self._changes), np.abs(self._target_speeds - speed).argmin())
        decay = np.exp(-STEP / SPEED_LAG)
        v = np.full(len(index), speed)
        ways = [speed * np.minimum(time, 0.0) * np.ones(len(index)) for time in TIMES[TIMES <= 0]]
        for number in range(len(TIMES) - len(ways)):
            second, part = divmod(number * STEP, 1.0)
            if part == 0 and second < PLANNED:
                index = np.clip(index + self._changes[:, int(second)], 0, len(self._target_speeds) - 1)
            excess = v - self._target_speeds[index]
            ways.append(ways[-1] + self._target_speeds[index] * STEP + excess * SPEED_LAG * (1 - decay))
            v = self._target_speeds[index] + excess * decay
        return np.stack(ways, axis=1)

    def _price(self, view: View, way: np.ndarray) -> np.ndarray:
        """Price of each plan's encounters and of its lane change [m of way], (plans,)."""
        price = LANE_CHANGE * np.abs(self._sides).astype(float)
        if not len(view.positions):
            return price
        place, direction = _arc(way, view.curvature)
        place += (
            1j
            * direction
            * LANE_WIDTH
            * self._sides[:, None]
            * (1 - np.exp(-np.maximum(TIMES, 0) / LATERAL_LAG))
        )
        if "LANE_LEFT" not in self._numbers:
            view = replace(view, positions=_as_if_turning(view))
        drive = _drive(view)
        others = _discs(view, drive)
        leading = np.where(
            _on_curve(view)[:, None], np.abs(_complex(view.positions))[:, None] + drive, np.inf
        )
        crossing = (
            np.abs(np.sin(view.headings)) if "LANE_LEFT" in self._numbers else np.abs(view.headings) > 0.3
        )
        growth = self._caution * (GROWTH + CROSSING_GROWTH * crossing)[:, None]
        near = 2 * RADIUS + self._caution * MARGIN + growth * FUTURE
        for delay, cost in PRICES.items():
            start = round((SPAN + delay) / STEP) + 1
            window = slice(start, start + len(FUTURE))
            offset = (others - place[:, None, window, None]) / direction[:, None, window, None]
            beyond = np.maximum(np.abs(offset.real) - DISCS[-1], 0.0)  # of the ego's ends
            close = (beyond**2 + offset.imag**2).min(axis=3) < near**2
            close |= leading - way[:, None, window] < GAP
            price += self._caution * cost * (close * np.exp(-FUTURE / FORGETTING)).max(axis=(1, 2))
        return price


def _arc(way: np.ndarray, curvature: Any) -> tuple[np.ndarray, np.ndarray]:
    """Place [m] and direction (of length 1) after a way along an arc from the origin, both as complex numbers."""
    half = way * curvature / 2
    return way * np.sinc(half / np.pi) * np.exp(1j * half), np.exp(2j * half)


def _drive(view: View) -> np.ndarray:
    """Way of each vehicle [m] at each time of FUTURE, (n, times): at its speed, or braking as it does for a while."""
    braking = np.clip(view.acceleration, -6.0, -1e-6)[:, None]
    speed = view.speeds[:, None]
    time = np.minimum(FUTURE, np.minimum(BRAKING, -speed / braking))  # until when it brakes
    return speed * time + braking * time**2 / 2 + (speed + braking * time) * (FUTURE - time)


def _discs(view: View, drive: np.ndarray) -> np.ndarray:
    """Centres of the discs of each vehicle at each time of FUTURE, complex, (n, times, discs)."""
    curvature = view.turning / np.maximum(view.speeds, 1.0)
    place, direction = _arc(drive, curvature[:, None])
    direction *= np.exp(1j * view.headings)[:, None]
    place *= np.exp(1j * view.headings)[:, None]
    return (_complex(view.positions)[:, None] + place)[..., None] + direction[..., None] * DISCS


def _on_curve(view: View) -> np.ndarray:
    """Whether a vehicle may be ahead on a road that goes straight and then bends as its heading says, (n,).

    On a bend that begins at the ego the bearing is half the heading; where it begins later it is less.
    """
    turned = np.abs(view.headings)
    x, y = view.positions[:, 0], view.positions[:, 1] * np.sign(view.headings)
    return (turned > 0.2) & (turned < 2.0) & (x > 0) & (y > -2.5) & (y < x * np.tan(turned / 2) + 2.5)


def _as_if_turning(view: View) -> np.ndarray:
    """Positions (n, 2) with the oncoming vehicles on the left moved towards the own lane."""
    x, y = view.positions.T
    oncoming = (np.abs(view.headings) > 2.6) & (x > -5.0) & (x < TURN_AHEAD) & (y < 0)
    return np.stack([x, np.where(oncoming, np.minimum(y + TURN_SHIFT, 0.0), y)], axis=1)


def _complex(points: np.ndarray) -> np.ndarray:
    return points[:, 0] + 1j * points[:, 1]
