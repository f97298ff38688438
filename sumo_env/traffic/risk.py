"""What risky drivers do at times fixed in advance, whatever the ego does: cut-ins, sudden braking, surges.

Parameters of drivers alone (`drivers.DriverPool`) do not make every road more dangerous, so a dose of risk also brings
seeded events. Even a risky driver looks whether there is room to cut in and whether the way straight ahead is free;
without that, most events would be crashes among the traffic itself, far from the ego.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import cos, sin
from typing import Any, Literal, get_args

from sumo_env.config import ConfigError, nearest
from sumo_env.contacts.rectangles import CAR, LENGTH, Half, State, distance
from sumo_env.streams import stream

FREE_WAY = 40.0  # [m]
CUT_IN_GAP = 1.0  # [m] that a cut-in leaves to every other vehicle, else it does not happen
LOOKED_AT = 4.0 * LENGTH  # [m] vehicles further away, along x and y together, do not hinder a cut-in
SWERVE_TIME = 3.0  # [s] that a cut-in into the lane of oncoming traffic lasts
Kind = Literal["cut-in", "brake", "surge"]
KINDS: list[str] = list(get_args(Kind))
RATES = tuple(kind.replace("-", "_") for kind in KINDS)  # as `RiskRates` calls how often they are
HALF_CORRIDOR = 2.0  # [m] to either side of the centre: half a lane


@dataclass(frozen=True, slots=True)
class RiskRates:
    """What the drivers of a task do at dose 1, per vehicle and second (calibration: docs/developers/decisions.md)."""

    cut_in: float = 0.0  # unsafe lane changes [1/s]
    brake: float = 0.0  # sudden braking [1/s]
    brake_decel: float = 6.0  # [m/s2]
    brake_duration: float = 1.0  # [s]
    surge: float = 0.0  # sudden acceleration [1/s]
    surge_accel: float = 4.0  # [m/s2]
    surge_duration: float = 2.0  # [s]
    surge_way: float = FREE_WAY  # [m] free straight ahead, else a surge pauses


@dataclass(frozen=True)
class EventKind:
    """A kind of event of a user's own, on SUMO alone: a subclass says what it commands (docs/own-parts.md).

    An event of it runs from its time on for its duration. ``at`` is a `sumo_env.sumo.events.Moment`: the event, the
    vehicle that it commands, and what SUMO knows. What a subclass has beside methods are fields of a frozen dataclass.

    Attributes:
        rate: events per vehicle and second at dose 1 [1/s], where a task names the kind in ``own_kinds``.
        duration: of these events [s].
    """

    rate: float = 0.0
    duration: float = 0.0

    def __str__(self) -> str:
        return type(self).__name__

    def pauses(self, at: Any) -> bool:
        """Whether it leaves the vehicle to SUMO in this sub-step."""
        return False

    def command(self, at: Any) -> None:
        """Command the vehicle for the next sub-step."""
        raise NotImplementedError(f"{self} has no method command(at)")

    def give_back(self, at: Any) -> None:
        """Give SUMO what `command` has taken: when the event pauses or ends, or another one takes its place."""
        raise NotImplementedError(f"{self} has no method give_back(at)")


@dataclass(frozen=True, slots=True)
class RiskEvent:
    """Something dangerous that a driver does at a time fixed in advance.

    Attributes:
        time: since the start of the episode [s].
        vehicle: id of the driver's vehicle.
        kind: ``cut-in``: change to the neighbouring lane at once, where `has_room`. ``brake``: brake for nothing.
            ``surge``: accelerate, whoever crosses the way, but pause while there is no `free_way`. Or an `EventKind`.
        direction: of a cut-in, -1 left or +1 right (the other one where there is no lane or no room).
        accel: of a surge, or of a brake (negative) [m/s2].
        duration: of all but a cut-in [s].
        way: of a surge, to the next vehicle straight ahead, from centre to centre [m]; it pauses while that is nearer.
        is_further: whether it comes only if its vehicle is near a learning car then (`tilt.Tilt`).

    Raises:
        ConfigError: there is no such kind.
    """

    time: float
    vehicle: str
    kind: Kind | EventKind
    direction: int = 0
    accel: float = 0.0
    duration: float = 0.0
    way: float = FREE_WAY
    is_further: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KINDS and not isinstance(self.kind, EventKind):
            instead = f"{nearest(str(self.kind), KINDS)}, or an instance of a subclass of EventKind"
            raise ConfigError(f"an event of {self.vehicle!r} is of the unknown kind {self.kind!r}: {instead}")

    def kind_on(self, simulator: str) -> Kind:
        """Its kind on a simulator without kinds of a user's own and further events. Raises ConfigError for those."""
        if self.is_further:
            raise ConfigError(f"{simulator} has no 'event_factor', which SUMO alone has")
        if isinstance(self.kind, EventKind):
            raise ConfigError(f"{simulator} has no events of the kind {type(self.kind).__name__!r}: SUMO has")
        return self.kind


def pushes(rates: RiskRates) -> dict[Kind, dict[str, Any]]:
    """What events of these kinds have beside their time and vehicle."""
    return {
        "brake": {"accel": -rates.brake_decel, "duration": rates.brake_duration},
        "surge": {"accel": rates.surge_accel, "duration": rates.surge_duration, "way": rates.surge_way},
    }


def draw_events(
    rates: RiskRates,
    dose: float,
    vehicles: tuple[tuple[str, float], ...],
    seed: int,
    duration: float,
    purpose: str = "risk events",
) -> tuple[RiskEvent, ...]:
    """Events of an episode, sorted by time; none at dose 0.

    Poisson processes of the rates at dose 1, thinned by the dose: the events of a smaller dose are a subset
    of those of a larger one. `vehicles`: (id, time from which it is on the road [s]); `purpose`: of the random stream.
    """
    if dose <= 0.0:
        return ()
    rng = stream(seed, purpose)
    kinds: dict[Kind, float] = {"cut-in": rates.cut_in, "brake": rates.brake, "surge": rates.surge}
    more_of, events = pushes(rates), list[RiskEvent]()
    for vehicle, start in vehicles:
        for kind, rate in kinds.items():
            for _ in range(rng.poisson(rate * duration)):
                time, keep, side = rng.random(3)
                time *= duration
                if keep >= dose or time < start:
                    continue
                more = more_of.get(kind) or {"direction": -1 if side < 0.5 else 1}
                events.append(RiskEvent(time, vehicle, kind, **more))
    return tuple(sorted(events, key=lambda event: (event.time, event.vehicle, event.kind)))


def draw_own_events(
    kinds: Sequence[EventKind],
    dose: float,
    vehicles: tuple[tuple[str, float], ...],
    seed: int,
    duration: float,
    purpose: str = "own risk events",
) -> tuple[RiskEvent, ...]:
    """Events of a user's own kinds, sorted by time; processes and arguments as of `draw_events`.

    Raises:
        ConfigError: a kind has no rate or no duration.
    """
    for kind in kinds:
        if not (kind.rate > 0.0 and kind.duration > 0.0):
            raise ConfigError(
                f"{kind!r} needs a rate [1/s] and a duration [s] above 0 to be one of 'own_kinds'"
            )
    if dose <= 0.0 or not kinds:
        return ()
    rng, events = stream(seed, purpose), list[RiskEvent]()
    for vehicle, start in vehicles:
        for kind in kinds:
            for time, keep in rng.random((rng.poisson(kind.rate * duration), 2)).tolist():
                if keep < dose and time * duration >= start:
                    events.append(RiskEvent(time * duration, vehicle, kind, duration=kind.duration))
    return tuple(sorted(events, key=lambda event: event.time))


def has_room(there: State, others: Sequence[State], halves: Sequence[Half] = ()) -> bool:
    """Would a vehicle in the state `there`, in the lane beside, be at least CUT_IN_GAP from every other vehicle?

    halves: half sizes [m], of the vehicle first; all are cars without them.
    """
    own, *further = halves or (CAR,) * (1 + len(others))
    return all(
        abs(other[0] - there[0]) + abs(other[1] - there[1]) > LOOKED_AT + half[0] + own[0]
        or distance(there, other, own, half) >= CUT_IN_GAP
        for other, half in zip(others, further, strict=True)
    )


def free_way(vehicle: State, others: Iterable[State], way: float) -> bool:
    """Is no centre of another vehicle in the straight corridor of `way` [m] ahead of a vehicle?

    The vehicle itself may be among the others.
    """
    x, y, _, heading = vehicle
    c, s = cos(heading), sin(heading)
    return not any(
        0.0 < (dx := other[0] - x) * c + (dy := other[1] - y) * s < way
        and abs(dy * c - dx * s) < HALF_CORRIDOR
        for other in others
    )
