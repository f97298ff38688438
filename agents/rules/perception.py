"""What kinematics observations tell about the traffic, in SI units and in the ego's own frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np

PERIOD = 1.0  # [s] between two observations
TURNING = 0.1  # [rad/s] slower turns are taken for noise
MAX_TURNING = 1.0  # [rad/s]
SAME = 7.0  # [m] a vehicle this close to where one was expected is taken for that one
STANDING = 0.5  # [m/s] below this the direction of the velocity says nothing
LANE_WIDTH = 4.0  # [m]
SIDES = {"LANE_LEFT": -1, "LANE_RIGHT": 1}


@dataclass(frozen=True)
class View:
    """The ego and the n vehicles that it sees.

    Ego: origin (2,) [m] on the map (y down), heading of its road [rad], speed [m/s], curvature of its path [1/m]
    (positive to the right), sideways [m]: how far it left that path to the right in the last period.
    Others, in the frame of the ego (x ahead, y to the right): positions (n, 2) [m], headings [rad], speeds [m/s],
    turning [rad/s] and acceleration [m/s2], (n,) each; the last two are 0 at the first sight of a vehicle.
    """

    origin: np.ndarray
    heading: float
    speed: float
    curvature: float
    sideways: float
    positions: np.ndarray
    headings: np.ndarray
    speeds: np.ndarray
    turning: np.ndarray
    acceleration: np.ndarray


class Perception:
    """Reads the kinematics observations of ``env``, one a period, and follows the vehicles from one to the next.

    Raises ValueError when ``env.unwrapped.observation_type`` lacks one of the features x, y, vx, vy.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        kind: Any = env.unwrapped.observation_type  # type: ignore[attr-defined]
        self._columns = {name: column for column, name in enumerate(kind.features)}
        missing = [name for name in ("x", "y", "vx", "vy") if name not in self._columns]
        if missing:
            raise ValueError(f"Drivers by rules observe x, y, vx and vy: there is no {', '.join(missing)}.")
        self._ranges = kind.ranges
        self._absolute = kind.absolute
        self.reset()

    def reset(self) -> None:
        """Forget everything seen."""
        self._before: View | None = None

    def look(self, observation: np.ndarray, changing_lane: bool = False) -> View:
        """The view in an observation (vehicles, features).

        changing_lane: the ego is on its way to another lane, so that its heading is not that of the road.
        """
        before = self._before
        rows = np.asarray(observation, dtype=float)
        present = (
            rows[:, self._columns["presence"]] > 0.5 if "presence" in self._columns else rows.any(axis=1)
        )
        rows = rows[present]
        points, velocities = self._pair(rows, "x", "y"), self._pair(rows, "vx", "vy")
        # The ego's own row is absolute in any case.
        positions = points[1:] - (points[0] if self._absolute else 0.0)
        velocities[1:] += 0.0 if self._absolute else velocities[0]
        speeds = np.hypot(velocities[:, 0], velocities[:, 1])
        headings = np.arctan2(velocities[:, 1], velocities[:, 0])
        if "cos_h" in self._columns:
            headings = np.arctan2(rows[:, self._columns["sin_h"]], rows[:, self._columns["cos_h"]])
        heading, speed, curvature, sideways = float(headings[0]), float(speeds[0]), 0.0, 0.0
        if before is not None:
            way = PERIOD * (before.speed + speed) / 2
            if changing_lane:
                heading, curvature = before.heading + before.curvature * way, before.curvature
            elif speed < STANDING and "cos_h" not in self._columns:
                heading, curvature = before.heading, before.curvature
            elif (turn := _wrap(heading - before.heading)) and abs(turn) > TURNING * PERIOD:
                curvature = turn / max(way, 1.0)
            right = np.array([-np.sin(before.heading), np.cos(before.heading)])
            sideways = float((points[0] - before.origin) @ right) - before.curvature * way**2 / 2
        ahead = np.array([np.cos(heading), np.sin(heading)])
        frame = np.stack([ahead, [-ahead[1], ahead[0]]], axis=1)
        nothing = np.zeros(len(positions))
        view = View(
            origin=points[0],
            heading=heading,
            speed=speed,
            curvature=curvature,
            sideways=sideways,
            positions=positions @ frame,
            headings=_wrap(headings[1:] - heading),
            speeds=speeds[1:],
            turning=nothing,
            acceleration=nothing,
        )
        if before is not None:
            view = _follow(before, view)
        self._before = view
        return view

    def _pair(self, rows: np.ndarray, *names: str) -> np.ndarray:
        """Two features, mapped from [-1, 1] back to their ranges, (vehicles, 2)."""
        low, high = np.array([self._ranges[name] for name in names]).T
        return low + (rows[:, [self._columns[name] for name in names]] + 1) / 2 * (high - low)


class Rules:
    """A driver by rules: what it sees, and what it remembers; `decide` is its rule, which draws nothing at random.

    ``env.unwrapped`` has actions, target_speeds [m/s] and observation_type.

    Raises ValueError when the observation lacks one of x, y, vx, vy.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        source: Any = env.unwrapped
        self._numbers = {name: number for number, name in source.actions.items()}
        self._target_speeds = np.array(source.target_speeds, dtype=float)
        self._perception = Perception(env)
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode: forget what was seen."""
        self._perception.reset()
        self._lanes = {-1: False, 1: False}  # whether one is known on this side, left or right
        self._action: str | None = None

    def act(self, observation: np.ndarray) -> int:
        """The action that the rule decides for."""
        view = self._perception.look(observation, self._action in SIDES)
        self._learn_lanes(view)
        self._action = self.decide(view)
        return self._numbers[self._action]

    def _learn_lanes(self, view: View) -> None:
        """A lane is known once somebody was seen on it, or the ego came from it; not if the ego failed to reach it."""
        if self._action in SIDES:
            side = SIDES[self._action]
            arrived = side * view.sideways > 0.4 * LANE_WIDTH
            self._lanes = {side: False, -side: arrived or self._lanes[-side]}
        parallel = (np.abs(np.sin(view.headings)) < 0.2) & (np.abs(view.positions[:, 0]) < 100)
        for side in (-1, 1):
            beside = np.abs(view.positions[:, 1] - side * LANE_WIDTH) < 1.0
            self._lanes[side] = self._lanes[side] or bool((parallel & beside).any())

    def decide(self, view: View) -> str:
        """The name of the next meta-action; `self._action` is that of the last one, None at the start."""
        raise NotImplementedError


def _follow(before: View, now: View) -> View:
    """``now`` with the turning and the acceleration of the vehicles that were seen ``before``."""
    if not len(before.positions) or not len(now.positions):
        return now
    # Where the vehicles were expected, in the frame of ``now``: turned by the change of heading, moved by the way.
    turn = now.heading - before.heading
    cos, sin = np.cos(turn), np.sin(turn)
    others = before.speeds[:, None] * np.stack([np.cos(before.headings), np.sin(before.headings)], axis=1)
    ego = (before.speed * np.array([1.0, 0.0]) + now.speed * np.array([cos, sin])) / 2
    frame = np.array([[cos, -sin], [sin, cos]])
    expected = (before.positions + PERIOD * (others - ego)) @ frame
    distance = np.linalg.norm(now.positions[:, None] - expected[None], axis=2)
    nearest = distance.argmin(axis=1)
    known = distance.min(axis=1) < SAME
    turned = _wrap(now.headings + turn - before.headings[nearest]) / PERIOD
    slow = (now.speeds < 1) | (before.speeds[nearest] < 1)
    turned[(np.abs(turned) < TURNING) | slow] = 0.0
    return replace(
        now,
        turning=np.where(known, np.clip(turned, -MAX_TURNING, MAX_TURNING), 0.0),
        acceleration=np.where(known, (now.speeds - before.speeds[nearest]) / PERIOD, 0.0),
    )


def _wrap(angle: Any) -> Any:
    """The same angle in [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
