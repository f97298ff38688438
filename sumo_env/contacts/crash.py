"""Where the ego's crash is decided and written down: SUMO's reports and the geometry, joined.

Neither is enough alone. SUMO compares places along lanes, misses corners, and reports vehicles that are far apart;
the geometry sees only what `rectangles.first_touch` is given. So a touch of the rectangles counts in any case, and a
report of SUMO on its own counts where the outlines are within `SUMO_TOLERANCE`. The record says who saw the crash.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from sumo_env.contacts.rectangles import (
    CAR,
    LENGTH,
    WIDTH,
    Half,
    State,
    distance,
    first_touch,
    state_between,
    state_of,
)
from sumo_env.networks.lanes import wrap_to_pi
from sumo_env.scene import Scene

CrashType = Literal["rear-end", "side", "frontal", "junction"]
Detector = Literal["sumo", "geometry", "both", "highway-env"]

SAME_DIRECTION = math.pi / 4  # [rad] headings that differ by less are those of vehicles driving side by side
OPPOSITE_DIRECTION = 3 * math.pi / 4  # [rad] ... by more, of vehicles driving towards each other
SUMO_TOLERANCE = 0.1  # [m] how far apart the outlines may be for a report of SUMO to count on its own


@dataclass(frozen=True, slots=True)
class CrashRecord:
    """A crash of the ego. "Relative" is in the ego's frame: x ahead of it, y to its right.

    Attributes:
        other: id of the other vehicle.
        time: of the first contact, since the start of the episode [s].
        x, y: centre of the ego then [m].
        relative_x, relative_y: centre of the other vehicle [m].
        relative_heading: of the other vehicle [rad], in [-pi, pi).
        closing_speed: magnitude of the relative velocity [m/s] (0 for two vehicles side by side at one speed).
        type: see `classify`.
        detected_by: who noticed it.
    """

    other: str
    time: float
    x: float
    y: float
    relative_x: float
    relative_y: float
    relative_heading: float
    closing_speed: float
    type: CrashType
    detected_by: Detector


def classify(relative_x: float, relative_y: float, relative_heading: float) -> CrashType:
    """Name a crash by the other vehicle's pose in the ego's frame [m, m, rad].

    Headings within 45 degrees: ``rear-end`` if the other is rather ahead or behind than beside (each measured in
    vehicle sizes), ``side`` otherwise. Opposite within 45 degrees: ``frontal``. In between: ``junction``, of paths
    that cross.
    """
    angle = abs(wrap_to_pi(relative_heading))
    if angle > OPPOSITE_DIRECTION:
        return "frontal"
    if angle > SAME_DIRECTION:
        return "junction"
    return "rear-end" if abs(relative_x) / LENGTH >= abs(relative_y) / WIDTH else "side"


def record(ego: State, other: State, other_id: str, time: float, detected_by: Detector) -> CrashRecord:
    """The record of a crash from the states of both vehicles at the first contact, `time` [s]."""
    x, y, speed, heading = ego
    dx, dy = other[0] - x, other[1] - y
    cos, sin = math.cos(heading), math.sin(heading)
    relative_x, relative_y = dx * cos + dy * sin, dy * cos - dx * sin
    turn = wrap_to_pi(other[3] - heading)
    return CrashRecord(
        other=other_id,
        time=time,
        x=x,
        y=y,
        relative_x=relative_x,
        relative_y=relative_y,
        relative_heading=turn,
        closing_speed=math.hypot(other[2] * math.cos(turn) - speed, other[2] * math.sin(turn)),
        type=classify(relative_x, relative_y, turn),
        detected_by=detected_by,
    )


def crash_record(scene: Scene, other: int, detected_by: Detector) -> CrashRecord:
    """The record of the ego's crash with row `other` of the scene of the first contact."""
    return record(state_of(scene, 0), state_of(scene, other), scene.ids[other], scene.time, detected_by)


def is_confirmed(first: State, second: State, half: Half = CAR, other: Half = CAR) -> bool:
    """Whether SUMO's report of a contact of these two counts: it also reports vehicles that are far apart."""
    return distance(first, second, half, other) <= SUMO_TOLERANCE


class CrashDetector:
    """Watches an episode for the ego's first contact, sub-step by sub-step.

    Attributes:
        crash: the ego's first contact; None as long as there is none. Where the geometry was first, `detected_by`
            becomes "both" when SUMO reports the same vehicle in a later sub-step.
        contact: states of the ego and of the other vehicle then.
        reported: ids of the vehicles with which SUMO reported a collision of the ego in the last sub-step.
    """

    contact: tuple[State, State]

    def __init__(self) -> None:
        self.crash: CrashRecord | None = None
        self.reported: Collection[str] = ()

    def detect(
        self,
        time: float,
        dt: float,
        ids: Sequence[str],
        before: Sequence[State],
        after: Sequence[State],
        reported: Collection[str],
        halves: Sequence[Half],
    ) -> CrashRecord | None:
        """Judge one sub-step; returns `crash`.

        Args:
            time: [s] of the end of the sub-step.
            dt: [s] that it lasts.
            ids: of the vehicles that may have touched the ego; the ego is the first.
            before: their states at the start of the sub-step, in the order of `ids`.
            after: their states at its end.
            reported: ids of the vehicles with which SUMO reports a collision of the ego in this sub-step.
            halves: half sizes in the order of `ids`, the ego's first.
        """
        # SUMO may see a contact a sub-step before the geometry does, or a sub-step later.
        earlier, self.reported = self.reported, reported
        if self.crash is not None:
            if self.crash.detected_by == "geometry" and self.crash.other in reported:
                self.crash = replace(self.crash, detected_by="both")
            return self.crash
        touch = first_touch(before[0], after[0], before[1:], after[1:], halves[1:], halves[0])
        if touch is not None:
            row, moment = touch[0] + 1, touch[1]
            by: Detector = "both" if ids[row] in reported or ids[row] in earlier else "geometry"
        else:
            confirmed = (
                row
                for row in range(1, len(ids))
                if ids[row] in reported and is_confirmed(after[0], after[row], halves[0], halves[row])
            )
            row, moment, by = next(confirmed, 0), 1.0, "sumo"
            if row == 0:
                return None
        ego, other = (state_between(before[k], after[k], moment) for k in (0, row))
        self.contact = ego, other
        self.crash = record(ego, other, ids[row], round(time - (1.0 - moment) * dt, 6), by)
        return self.crash
