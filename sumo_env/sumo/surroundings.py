"""What is near the ego after every sub-step.

SUMO is asked vehicle by vehicle where the ego is, and everybody who may be within reach. Its context subscription gives
the same states and takes longer than the rest of a sub-step on small roads (docs/developers/decisions.md).
"""

from __future__ import annotations

from math import inf

from sumo_env.contacts.crash import SUMO_TOLERANCE
from sumo_env.contacts.measures import TTC_RADIUS, ego_ttc
from sumo_env.contacts.rectangles import DIAGONAL, State, reach_of, stay_apart
from sumo_env.sumo.session import Session
from sumo_env.traffic.scenario import EGO

FASTEST = 200.0  # [m/s] no two vehicles close in faster


class Surroundings:
    """The ego and the vehicles near it, those that somebody else has added to the simulation included."""

    def __init__(self, session: Session, speed: float, *, ego: str = EGO) -> None:
        self._session, self._name = session, ego
        self.ego: State
        self.near: dict[str, State]  # whose front is within `TTC_RADIUS` of the ego's, in alphabetical order
        self.take_stock()
        self.look(0.0, speed)

    def take_stock(self) -> None:
        """Read which vehicles are on the road, and look at all of them next."""
        self._others = [name for name in self._session.vehicles() if name != self._name]
        self._due: dict[str, float] = {}  # distant vehicle -> time before which it cannot be near [s]

    def look(self, time: float, speed: float) -> None:
        """Look around after the sub-step that ended at `time` [s] with the ego's `speed` [m/s].

        A distant vehicle is skipped until it may have come near (conservative advancement).
        """
        if self._session.changed:
            self.take_stock()
        others, due = self._others, self._due
        if due:
            others = [name for name in others if due.get(name, time) <= time]
        (x, y, _, heading), self.near, distant = self._session.near(self._name, others, TTC_RADIUS)
        # SUMO's speed is the commanded one, which covers the way of a sub-step
        self.ego = x, y, speed, heading
        for name, further in distant:
            due[name] = time + further / FASTEST

    def time_to_collision(self, horizon: float) -> float:
        """Least time to collision of the ego [s], inf without one within `horizon` [s]."""
        if not self._session.sizes:
            return ego_ttc(self.ego, self.near.values(), horizon)
        sized = zip(self.near.values(), self._session.halves(self.near), strict=True)
        return min((ego_ttc(self.ego, (other,), horizon, half) for other, half in sized), default=inf)

    def within_reach(self, ego: State, before: dict[str, State], dt: float) -> list[str]:
        """Who may have touched the ego in the last `dt` [s], or nearly; `ego` and `before` are the states then."""
        x, y, _, _ = self.ego
        reach = DIAGONAL + SUMO_TOLERANCE
        if self._session.sizes:
            reach += max((reach_of(half) - DIAGONAL for half in self._session.halves(self.near)), default=0.0)
        far = reach + FASTEST * dt
        found = []
        for name, other in self.near.items():
            dx, dy = other[0] - x, other[1] - y
            if -far < dx < far and -far < dy < far and name in before:
                was = before[name]
                if not stay_apart(was[0] - ego[0], was[1] - ego[1], dx, dy, reach):
                    found.append(name)
        return found
