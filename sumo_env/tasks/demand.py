"""Route files of SUMO (.rou.xml): who departs when, on which route, as which type of vehicle.

What a file leaves to chance (flows with a probability or exponential gaps, distributions of types and routes) is drawn
from the episode's seed. What cannot be driven is an error, what has no effect a warning.
"""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from xml.etree import ElementTree

import numpy as np
from gymnasium import logger

from sumo_env.config import ConfigError
from sumo_env.networks.files import CAR
from sumo_env.networks.lanes import VEHICLE_LENGTH
from sumo_env.traffic.attributes import check_attributes, of_class
from sumo_env.traffic.scenario import EGO

_T = TypeVar("_T")
LONGEST = 3600.0  # [s] that flows without an end go on
Element = ElementTree.Element
Edges = tuple[str, ...]
# from edge, to edge, via edges, vehicle class -> route
Router = Callable[[str, str, Sequence[str], str], Edges]

WHEN = {"depart", "begin", "end", "number", "period", "vehsPerHour", "perHour", "probability"}
WHERE = {"route", "from", "to", "via", "departLane", "departPos", "departSpeed"}
KNOWN = WHEN | WHERE | {"id", "type", "speedFactor"}
LOAD = {"personNumber", "containerNumber"}
WITHOUT_MEANING = LOAD | {"color", "line", "insertionChecks", "parkingBadges", "reroute"}
REFUSED = {
    **dict.fromkeys(("person", "personFlow", "container", "containerFlow"), "only vehicles drive here"),
    "include": "put its contents into this file",
    "interval": "give begin and end to each flow",
}

FRONTS = {
    "base": VEHICLE_LENGTH,
    "last": VEHICLE_LENGTH,
    **dict.fromkeys(("random", "free", "random_free"), math.nan),
}
RIGHTMOST = -1
LANES = {"first": RIGHTMOST, **dict.fromkeys(("random", "free", "allowed", "best"), math.nan)}
SPEEDS = dict.fromkeys(("max", "desired", "speedLimit", "random", "avg", "last"), math.nan)


class Kind(NamedTuple):
    """A vehicle type: name and attributes of a vType, and the factor on the speed limit that its drivers want."""

    name: str
    attributes: Mapping[str, str]
    mean: float = 1.0
    deviation: float = 0.0
    least: float = 0.2
    most: float = 2.0

    @property
    def vehicles(self) -> str:
        """SUMO's class of vehicles."""
        return self.attributes.get("vClass", CAR)

    def factor(self, rng: np.random.Generator) -> float:
        """The factor of one driver."""
        if not self.deviation:
            return self.mean
        return min(max(float(rng.normal(self.mean, self.deviation)), self.least), self.most)


class Departure(NamedTuple):
    """A vehicle of a route file: when, on which route and how it departs. None: drawn at random, or not set."""

    id: str
    route: str
    time: float  # [s]
    lane: int | None  # SUMO's number, 0 for the rightmost
    front: float | None  # position of the front bumper [m]
    speed: float | None  # [m/s]; None for the speed limit
    kind: Kind | None  # None for a driver of the pool


Choice = tuple[tuple[str, float], ...]  # (name, weight)


class Entry(NamedTuple):
    """A vehicle, trip or flow of a route file.

    Attributes:
        times: of its departures [s]; of a flow that is drawn, by a generator of random numbers and the last time [s].
    """

    id: str
    routes: Choice
    kinds: tuple[tuple[Kind | None, float], ...]
    lane: int | None
    front: float | None
    speed: float | None
    factor: float | None
    times: tuple[float, ...] | Callable[[np.random.Generator, float], Iterator[float]]
    single: bool = False

    @property
    def vehicles(self) -> set[str]:
        """SUMO's classes of vehicles."""
        return {CAR if kind is None else kind.vehicles for kind, _ in self.kinds}

    def departures(self, rng: np.random.Generator, begin: float, end: float) -> Iterator[Departure]:
        """Those in [begin, end]; what is left to chance is drawn from `rng`."""
        times = self.times if isinstance(self.times, tuple) else self.times(rng, end) if end > 0 else ()
        for count, time in enumerate(times):
            if not begin <= time <= end:
                continue
            kind = _pick(self.kinds, rng)
            if kind is not None and self.factor is not None:
                kind = kind._replace(mean=self.factor, deviation=0.0)
            name = self.id if self.single else f"{self.id}.{count}"
            yield Departure(name, _pick(self.routes, rng), time, self.lane, self.front, self.speed, kind)


def _drawn(
    law: str, mean: float, begin: float, end: float, number: float, rng: np.random.Generator, last: float
) -> Iterator[float]:
    """Times of a flow [s], at most `number`, up to `end` and `last`; law: method of `rng` that draws a gap."""
    time, count = begin, 0
    while count < number:
        time += float(getattr(rng, law)(mean))
        if time > min(last, end):
            return
        yield time
        count += 1


def _pick(choices: Sequence[tuple[_T, float]], rng: np.random.Generator) -> _T:
    if len(choices) == 1:
        return choices[0][0]
    weights = np.array([weight for _, weight in choices])
    return choices[int(rng.choice(len(choices), p=weights / weights.sum()))][0]


def read(file: Path, router: Router) -> tuple[dict[str, Edges], tuple[Entry, ...]]:
    """Routes by name, and what departs; `router` finds the routes of trips.

    Raises:
        ConfigError: the file cannot be read, or has something that cannot be driven; the message names it.
    """
    try:
        with gzip.open(file) if file.suffix == ".gz" else file.open("rb") as opened:
            root = ElementTree.parse(opened).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise ConfigError(f"{file} cannot be read as a route file: {error}") from error
    if root.tag not in ("routes", "additional"):
        raise ConfigError(
            f"{file} is no route file of SUMO: it begins with <{root.tag}> and not with <routes>"
        )
    reader = _Reader(file, router)
    for item in root:
        reader.take(item)
    if reader.ignored:
        logger.warn(f"{file}: without effect here: {', '.join(sorted(reader.ignored))}")
    return reader.routes, tuple(reader.entries)


class _Reader:
    """What a route file has said so far."""

    def __init__(self, file: Path, router: Router) -> None:
        self.routes: dict[str, Edges] = {}
        self.entries: list[Entry] = []
        self.ignored: set[str] = set()
        self._file, self._router = file, router
        self._names = {EGO}
        self._choices: dict[tuple[str, str], tuple[tuple[Any, float], ...]] = {}  # of types, and of routes

    def take(self, item: Element) -> None:
        """Read an element of the file."""
        tag, name = item.tag, item.get("id", "")
        if next(item.iter("stop"), None) is not None:
            raise self._wrong(item, "stops are not driven here; take <stop> out")
        if tag == "vType":
            self._choices[tag, name] = ((self._kind(item), 1.0),)
        elif tag == "route":
            self._choices[tag, name] = ((self._route(name, item), 1.0),)
        elif tag in ("vTypeDistribution", "routeDistribution"):
            self._choices[tag.removesuffix("Distribution"), name] = self._distribution(item)
        elif tag in ("vehicle", "trip", "flow"):
            self.entries.append(self._entry(item))
        else:
            raise self._wrong(item, REFUSED.get(tag, "it cannot be driven"))

    def _wrong(self, item: Element, reason: str) -> ConfigError:
        return ConfigError(f"{self._file}: {item.tag} {item.get('id', '')!r}: {reason}")

    def _number(
        self, item: Element, name: str, default: float, words: Mapping[str, float] | None = None
    ) -> float:
        from sumolib.miscutils import parseTime

        text = item.get(name)
        if text is None or text in (words or {}):
            return default if text is None else (words or {})[text]
        try:
            return float(parseTime(text))
        except (TypeError, ValueError):
            raise self._wrong(item, f"{name}={text!r} is no number that can be driven") from None

    # -- types and routes ----------------------------------------------------------------------------------

    def _kind(self, item: Element) -> Kind:
        """A vType; nested elements and `<param>` are of devices and models that have no effect here."""
        given = {
            key: value for key, value in item.attrib.items() if key not in ("id", "color", "probability")
        }
        self.ignored |= {f"<{inner.tag}> of vType {item.get('id')!r}" for inner in item}
        deviation = self._number(item, "speedDev", 0.0)
        factor = given.pop("speedFactor", "1")
        given.pop("speedDev", None)
        numbers = factor.removesuffix(")").rpartition("(")[2].split(",")
        try:
            values = [float(number) for number in numbers]
        except ValueError:
            raise self._wrong(item, f"speedFactor={factor!r} is no number and no normc(...)") from None
        name = item.get("id", "")
        try:
            attributes = of_class(name, given)
            check_attributes(name, attributes)
        except ValueError as error:
            raise ConfigError(f"{self._file}: {error}") from error
        if len(values) > 1:
            return Kind(name, attributes, *values)
        return Kind(name, attributes, values[0], deviation)

    def _distribution(self, item: Element) -> tuple[tuple[Any, float], ...]:
        """Members by their weights: elements inside, or names in an attribute."""
        tag = item.tag.removesuffix("Distribution")
        members = []
        for inner in item.findall(tag):
            if inner.get("id") is not None:
                self.take(inner)
            name = inner.get("id") or inner.get("refId") or ""
            members.append((name, self._number(inner, "probability", 1.0)))
        names = item.get(f"{tag}s", "").split()
        weights = map(float, item.get("probabilities", "").split() or ["1"] * len(names))
        members += zip(names, weights, strict=True)
        return tuple((one, weight) for name, weight in members for one, _ in self._named(item, tag, name))

    def _named(self, item: Element, tag: str, name: str) -> tuple[tuple[Any, float], ...]:
        """The types or routes of a name that an element gives."""
        if (tag, name) not in self._choices:
            raise self._wrong(item, f"unknown {tag} {name!r}")
        return self._choices[tag, name]

    def _route(self, name: str, item: Element) -> str:
        self.routes[name] = tuple(item.get("edges", "").split())
        if not self.routes[name]:
            raise self._wrong(item, "a route needs edges")
        return name

    # -- departures ----------------------------------------------------------------------------------------

    def _way(self, item: Element, vehicles: str) -> Choice:
        """The routes of a vehicle, a trip or a flow; `vehicles` is the class for which a trip is routed."""
        name = f"route of {item.get('id')}"
        inner = item.find("route")
        if inner is not None:
            return ((self._route(name, inner), 1.0),)
        if (among := item.find("routeDistribution")) is not None:
            for number, route in enumerate(among.findall("route")):
                route.set("id", f"{name} {number}")
            return self._distribution(among)
        if item.get("route") is not None:
            return self._named(item, "route", item.get("route", ""))
        if item.get("from") is None or item.get("to") is None:
            raise self._wrong(item, "it has no route, and no edges in from and to")
        via = item.get("via", "").split()
        self.routes[name] = self._router(item.get("from", ""), item.get("to", ""), via, vehicles)
        if not self.routes[name]:
            raise self._wrong(
                item, f"no route leads from edge {item.get('from')!r} to edge {item.get('to')!r}"
            )
        return ((name, 1.0),)

    def _entry(self, item: Element) -> Entry:
        self.ignored |= {
            f"<{inner.tag}> of a {item.tag}" for inner in item if not inner.tag.startswith("route")
        }
        self.ignored |= {f"{key} of a {item.tag}" for key in set(item.keys()) - KNOWN - WITHOUT_MEANING}
        name = item.get("id", "")
        if name in self._names:
            raise self._wrong(item, "there is another vehicle of this id")
        self._names.add(name)
        if item.tag != "flow" and item.get("depart") is None:
            raise self._wrong(item, "it needs a time to depart")
        lane = self._number(item, "departLane", math.nan, LANES)
        front = self._number(item, "departPos", VEHICLE_LENGTH, FRONTS)
        speed = self._number(item, "departSpeed", 0.0, SPEEDS)
        if speed < 0.0:
            raise self._wrong(item, f"departSpeed={speed:g} is negative")
        kind = item.get("type")
        kinds = ((None, 1.0),) if kind is None else self._named(item, "vType", kind)
        classes = {CAR if one is None else one.vehicles for one, _ in kinds}
        common: dict[str, Any] = {
            "id": name,
            "routes": self._way(item, CAR if CAR in classes else min(classes)),
            "kinds": kinds,
            "lane": None if math.isnan(lane) else int(lane),
            "front": None if math.isnan(front) else front,
            "speed": None if math.isnan(speed) else speed,
            "factor": self._number(item, "speedFactor", 1.0) if item.get("speedFactor") else None,
        }
        if item.tag != "flow":
            return Entry(**common, times=(self._number(item, "depart", 0.0),), single=True)
        return Entry(**common, times=self._times(item))

    def _times(self, item: Element) -> Any:
        """When the vehicles of a flow depart."""
        begin, end = self._number(item, "begin", 0.0), self._number(item, "end", math.inf)
        number = self._number(item, "number", math.inf)
        period = item.get("period", "")
        if period.startswith("exp("):
            try:
                rate = float(period[4:-1])
            except ValueError:
                rate = 0.0
            if not 0.0 < rate < math.inf:
                raise self._wrong(item, f"period={period!r} is no exp(rate)")
            return partial(_drawn, "exponential", 1.0 / rate, begin, end, number)
        if item.get("probability") is not None:
            chance = self._number(item, "probability", 0.0)
            if not 0.0 < chance <= 1.0:
                raise self._wrong(item, f"probability={chance:g} must lie in (0, 1]")
            return partial(_drawn, "geometric", chance, begin, end, number)
        rate = self._number(item, "vehsPerHour", self._number(item, "perHour", 0.0))
        gap = 3600.0 / rate if rate > 0 else self._number(item, "period", 0.0)
        if gap <= 0 and math.isfinite(number) and math.isfinite(end):
            gap = (end - begin) / max(number, 1.0)
        if gap <= 0:
            raise self._wrong(item, "it needs vehsPerHour, period, probability, or number and end")
        count = min(number, math.ceil((min(end, begin + LONGEST) - begin) / gap))
        return tuple(begin + k * gap for k in range(int(count)))
