"""A learning car of an episode in SUMO: who drives it, what is near it, and what it meets in a policy step."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import Any

from sumo_env.contacts.crash import CrashDetector, CrashRecord, record
from sumo_env.contacts.measures import HORIZON
from sumo_env.contacts.rectangles import State, first_touch
from sumo_env.networks.meeting import Meeting
from sumo_env.simulator import EgoCommand, EgoStep
from sumo_env.sumo.nearby_vehicles import Surroundings
from sumo_env.sumo.session import Session

BY_SUMO = EgoCommand(None, None)


class Car:
    """One learning car."""

    def __init__(self, session: Session, name: str, ego: Any, meeting: Meeting | None) -> None:
        """ego: an `Ego` or a `RouteEgo`, which drives it; meeting: see `Surroundings`."""
        self.name, self.ego = name, ego
        self.is_commanded = False  # whether it has a command for this policy step; else SUMO drives it
        self.around = Surroundings(session, name, ego.speed, meeting)  # what is near it
        self._session, self._detector = session, CrashDetector()
        self._least_ttc, self.distance = inf, 0.0  # [s], and covered [m], in this policy step

    def obey(self, command: Any) -> None:
        """Begin a policy step."""
        self.is_commanded = command is not None
        self.ego.obey(command or BY_SUMO)
        self.around.list_vehicles()
        self._least_ttc, self.distance = inf, 0.0

    def update(
        self, time: float, dt: float, reported: Sequence[tuple[str, str]], commanded: Mapping[str, float]
    ) -> CrashRecord | None:
        """Look around after the sub-step of `dt` [s] that ended at `time` [s]; its first crash if it was in this one.

        reported: pairs of vehicles that SUMO reports in collision; commanded: see `Surroundings.update`.
        """
        around, detector, name, ego = self.around, self._detector, self.name, self.ego
        seen, before = around.ego, around.near
        around.update(time, ego.speed, commanded)
        # whom SUMO reports in collision with this car
        partners = {one if other == name else other for one, other in reported if name in (one, other)}
        ids, found = around.within_reach(seen, before, dt, partners), None
        if ids and not ego.overlaps_count:
            ids = self._without_overlaps(ids, seen, before, partners)
        if ids or reported or detector.reported:
            everybody = name, *ids
            then = seen, *[before[other] for other in ids]
            now = around.ego, *[around.near[other] for other in ids]
            halves = self._session.halves(everybody)
            crash = detector.detect(time, dt, everybody, then, now, partners, halves)
            if crash is not None and not ego.vehicle.crashed:
                ego.vehicle.crash(ego.speed)
                found = crash
        if around.near and not ego.vehicle.crashed:
            least = self._least_ttc
            self._least_ttc = min(least, around.time_to_collision(min(least, HORIZON)))
        return found

    def _without_overlaps(
        self, ids: list[str], seen: State, before: dict[str, State], reported: Collection[str]
    ) -> list[str]:
        """Those of `ids` whose touch is a crash even if SUMO reports none; that of another one is noted."""
        around, ego = self.around, self.ego
        apart = [name for name in ids if name not in reported and around.passes(name, ego.is_sumos)]
        if apart:
            halves = self._session.halves((self.name, *apart))
            others = [before[name] for name in apart], [around.near[name] for name in apart]
            touch = first_touch(seen, around.ego, *others, halves[1:], halves[0])
            ego.overlap = ego.overlap if touch is None else apart[touch[0]]
        return [name for name in ids if name not in apart]

    def be_hit(self, other: "Car", crash: CrashRecord) -> None:
        """Another learning car has touched this one; the contact is this car's first one, unless it had one."""
        if not self.ego.vehicle.crashed:
            self.ego.vehicle.crash(self.ego.speed)
            theirs, own = other._detector.contact
            mirrored = record(own, theirs, other.name, crash.time, crash.detected_by)
            # as seen from the other car, turned by up to 45 degrees, the same contact may have another name
            self._detector.crash = replace(mirrored, type=crash.type)

    def met(self) -> EgoStep:
        """The result of a policy step."""
        ego = self.ego
        return EgoStep(ego.target_lane, self._detector.crash, self._least_ttc, self.distance, ego.ended)
