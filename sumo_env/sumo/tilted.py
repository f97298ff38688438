"""Which risk events come more often in an episode, and how many were to be expected (`traffic.tilt`)."""

from bisect import insort
from collections.abc import Iterable
from math import inf

import numpy as np

from sumo_env.scene import NearEvents, Scene
from sumo_env.traffic.risk import EventKind, RiskEvent
from sumo_env.traffic.tilt import Tilt


class Tilted:
    """Counts the events of an episode that are near learning cars.

    Policy steps are looked at from scene to scene: an event whose time lies between two is near where its vehicle was
    within reach in the first one. Events of a user's own kinds come as often as ever, and are not counted.
    """

    def __init__(self, tilt: Tilt) -> None:
        self._tilt = tilt
        self._risky: set[str] = set()  # vehicles whose events are known
        self._coming: list[RiskEvent] = []  # not yet counted, the latest first
        self._since, self._near, self._before = -inf, frozenset[str](), frozenset[str]()
        self._events, self._others, self._expected = 0, 0, 0.0

    def plan(self, vehicles: Iterable[str], events: Iterable[RiskEvent]) -> None:
        """Vehicles have come or will come, and these are all their events."""
        self._risky.update(vehicles)
        for event in events:
            if not isinstance(event.kind, EventKind):
                insort(self._coming, event, key=lambda one: -one.time)

    def comes(self, event: RiskEvent) -> bool:
        """Whether an event that is due begins."""
        near = self._near if event.time > self._since else self._before
        return not event.is_further or event.vehicle in near

    def count(self, scene: Scene) -> NearEvents:
        """Count up to the end of a policy step, or to the start of the episode; then look who is near."""
        while self._coming and self._coming[-1].time <= scene.time:
            event = self._coming.pop()
            self._events += event.vehicle in self._near
            self._others += event.vehicle not in self._near and not event.is_further
        end = self._tilt.duration
        lasted = min(scene.time, end) - min(self._since, end) if self._near else 0.0
        self._expected += self._tilt.rate * len(self._near) * lasted
        self._since, self._before, self._near = scene.time, self._near, self._look(scene)
        weight = self._tilt.log_weight(self._events, self._expected)
        return NearEvents(self._events, self._expected, self._others, weight)

    def _look(self, scene: Scene) -> frozenset[str]:
        """Vehicles within reach of a learning car, which may have events."""
        near = np.zeros(len(scene), np.bool_)
        for car in range(scene.cars):
            near |= np.hypot(scene.x - scene.x[car], scene.y - scene.y[car]) <= self._tilt.reach
        return frozenset(name for name, is_near in zip(scene.ids, near, strict=True) if is_near) & self._risky
