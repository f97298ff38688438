"""What files of SUMO hold that has to be known before SUMO reads them, and what they must not hold, whoever wrote them.

What is refused is named by file and line. SUMO takes a number that is none for a number, opens connections that an
output names, and ends the process where a network has detectors, or a file includes itself. Outputs themselves are
harmless: `settings.file_settings` says where they go.
"""

from __future__ import annotations

import difflib
import gzip
import os
import re
import stat
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import lru_cache
from math import inf
from pathlib import Path
from typing import NamedTuple, NoReturn
from xml.parsers import expat

from sumo_env.config import ConfigError
from sumo_env.traffic.sumo_files import INPUTS, seconds

# Elements of additional files that end the process when they stand in a network.
NOT_IN_NETWORKS = {
    *("edgeData", "laneData", "e1Detector", "inductionLoop", "instantInductionLoop", "e2Detector"),
    *("laneAreaDetector", "e3Detector", "include", "entryExitDetector", "routeProbe", "vTypeProbe"),
    *("calibrator", "rerouter", "timedEvent", "variableSpeedSign"),
}
READERS = {"rerouter", "variableSpeedSign"}  # elements with a file of further elements
DEPARTING = ("vehicle", "trip", "flow", "person", "personFlow", "container", "containerFlow")
OTHER_FILES = {"net": "a network", "configuration": "a configuration", "osm": "a map of OpenStreetMap"}
UNSORTED = (
    "it departs before what stands before it in its route file. Sort the file (SUMO has "
    "tools/route/sort_routes.py), or take it as an additional file"
)
FLOWS = {"flow", "personFlow", "containerFlow"}
DAY = 86400.0  # [s] after which a flow ends that names no end
MOST = 100.0  # departures of a flow [1/s]; a lane takes less than one
DEEPEST = 50  # elements in each other; SUMO's own are ten at most
CROWD = 10_000  # vehicles of one file that depart at one moment
LARGEST = 1e9  # of any number: seconds, metres, m/s
UNPACKED = 2**32  # bytes of a file
# Attributes that are numbers, or words, or numbers among words such as normc(1, 0.1).
NUMBERS = (
    "accel|decel|tau|length|width|height|sigma|impatience|mass|speed|depart|period|begin|end|number|probability|"
    "vehsPerHour|perHour|duration|until|pos|freq|shape|repeat|x|y|z|friction|scale|offset|stepping|"
    "(lc|jm|cc)[A-Z0-9].*|[a-z].*(Decel|Speed|Factor|Dev|Gap|Pos|Lat|Length|Duration|Offset|Time)"
)
# Options of a configuration; those of time are in seconds.
LIMITS = {"step-length": (0.001, 10.0), "default.action-step-length": (0.0, 100.0), "scale": (0.0, 10.0)}
LIMITS |= {
    "default.speeddev": (0.0, 10.0),
    "threads": (0, 64),
    "device.rerouting.threads": (0, 64),
    "thread-rngs": (1, 1024),
    "precision": (0, 20),
}
# What is possible, by element; the numbers of a distribution such as normc(1, 0.1) are at most the upper limit.
A_TYPE = {"length": (0.1, 1e3), "width": (0.1, 20.0), "accel": (0.01, 100.0), "decel": (0.01, 100.0)}
A_TYPE |= {
    "maxSpeed": (0.1, 1e3),
    "actionStepLength": (0.0, 100.0),
    "scale": (0.0, 10.0),
    "speedFactor": (0.01, 10.0),
    "speedDev": (0.0, 10.0),
    "tau": (0.0, 1e3),
    "minGap": (0.0, 1e3),
}
RANGES = {
    "lane": {"length": (1e-3, LARGEST), "width": (1e-3, LARGEST), "speed": (0.0, 1e3)},
    "vType": A_TYPE,
    "route": {"repeat": (0.0, 1e4)},
    "step": {"speed": (-1e3, 1e3)},
    **{tag: {"length": (0.0, 1e5)} for tag in ("laneAreaDetector", "e2Detector")},
    "phase": {"duration": (1e-3, LARGEST)},
    **{
        tag: {"departPos": (-1e5, 1e5), "departPosLat": (-1e3, 1e3), "speedFactor": (0.01, 10.0)}
        for tag in ("vehicle", "trip", "flow")
    },
}
is_number = lru_cache(1000)(re.compile(NUMBERS).fullmatch)  # whether an attribute of this name is one
WORDS = re.compile(r"[^\s,;:()]+")
SUSPECT = re.compile(
    r"nan|inf|e\+?\d\d|(?<![\d.])\d{10}|0x", re.IGNORECASE
)  # the others are numbers as they should be


class Found(NamedTuple):
    """What one file holds; of vehicles and others that depart: id, whether it is a vehicle, time [s] if it has one."""

    includes: tuple[Path, ...]
    ids: set[str]
    models: dict[str, str]
    departing: list[tuple[str, bool, float | None]]


class Contents:
    """What route and additional files hold together.

    Attributes:
        ids: of all elements.
        models: car-following models of the vehicle types that name one, by type.
        first_departure: time of the first departure [s], None without one.
        left_out: ids of what SUMO leaves out: it departs earlier than what stands before it in a route file.
    """

    def __init__(self) -> None:
        self.ids: set[str] = set()
        self.models: dict[str, str] = {}
        self.first_departure: float | None = None
        self.left_out: list[str] = []
        self._vehicles: set[str] = set()

    def add(self, found: Found, in_order: bool) -> None:
        """Add a file; in_order: whether SUMO leaves out what departs before what stands before it."""
        latest = -inf
        self.ids |= found.ids
        self.models |= found.models
        for name, is_vehicle, time in found.departing:
            if is_vehicle:
                self._vehicles.add(name)
            if time is None:
                continue
            if in_order and time < latest:
                self.left_out.append(name)
                continue
            latest = max(latest, time)
            if self.first_departure is None or time < self.first_departure:
                self.first_departure = time

    def check_vehicle(self, name: str) -> None:
        """That a vehicle of this id comes, as far as the files say.

        Raises:
            ConfigError: there is none; the message names near ids.
        """
        known = sorted(self._vehicles)
        stem, _, number = name.rpartition(".")
        if name in self.left_out or stem in self.left_out:
            raise ConfigError(f"SUMO leaves out the vehicle {name!r}: {UNSORTED}")
        if name in known or stem in known:
            return
        near = difflib.get_close_matches(name, known, n=5)
        near += [f"{flow}.{number}" for flow in difflib.get_close_matches(stem, known, n=5)]
        hint = f"did you mean one of {', '.join(near)}?" if near else f"they have {', '.join(known[:20])}"
        raise ConfigError(f"the files have no vehicle {name!r}; {hint}")


def check_files(options: Mapping[str, str]) -> Contents:
    """What the files of SUMO's options hold, by their long names without dashes; nothing of it harms.

    Raises:
        ConfigError: the file and the line, what is there, and why it is refused.
    """
    for option, value in options.items():
        low, high = LIMITS.get(option, (-LARGEST, LARGEST))
        if not low <= _number(value.strip(), low) <= high:
            raise ConfigError(f"{option}={value!r} must be a number from {low:g} to {high:g}")
        for name in value.split(","):
            if os.path.exists(name) and not (os.path.isfile(name) or os.path.isdir(name)):
                raise ConfigError(f"{option}={value!r} is no regular file: SUMO would wait for it")
    contents = Contents()
    for option in INPUTS:
        for name in filter(None, options.get(option, "").split(",")):
            found = _check(Path(name), option == "net-file", ())
            if option in ("additional-files", "route-files"):
                contents.add(found, option == "route-files" and options.get("route-steps") != "0")
    return contents


def check_outputs(outputs: Iterable[tuple[str, str]]) -> None:
    """That outputs of a configuration, as (option, value), are files, and go where the others go.

    Raises:
        ConfigError: one opens a connection, or ignores the folder that is asked for.
    """
    for option, value in outputs:
        if option == "vtk-output":
            raise ConfigError(
                f"{option}={value!r} is not written to output_dir but where the file says: take it out, or give it "
                "among your sumo_options"
            )
        if _is_connection(value):
            raise ConfigError(f"{option}={value!r} opens a connection to another program: name a file")


def _check(path: Path, is_network: bool, including: tuple[Path, ...]) -> Found:
    path = Path(os.path.realpath(path))  # Path.resolve fails where links form a circle
    try:
        about = path.stat()
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from None
    if not stat.S_ISREG(about.st_mode):
        raise ConfigError(f"{path} is no regular file: SUMO would wait for it")
    found = _read(path, is_network, about.st_mtime_ns, about.st_size)
    for further in found.includes:
        if further in (path, *including):
            raise ConfigError(f"{path} includes {further}, which includes it: SUMO would not come to an end")
        _check(further, is_network, (path, *including))
    return found


@lru_cache(256)
def _read(path: Path, is_network: bool, changed: int, size: int) -> Found:
    return _Reader(path, is_network).read()


class _Reader:
    """Goes through the elements of one file, and refuses what must not be there."""

    def __init__(self, path: Path, is_network: bool) -> None:
        self._path, self._is_network = path, is_network
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler, self._parser.EndElementHandler = self._element, self._end
        self._parser.StartDoctypeDeclHandler = self._document_type
        self._included, self._found = list[Path](), Found((), set(), {}, [])
        self._departures = Counter[str]()  # vehicles by the attribute "depart"
        self._depth, self._lanes = 0, 0  # lanes: of the present edge

    def read(self) -> Found:
        """What the file holds."""
        path, left = self._path, UNPACKED
        try:
            with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as opened:
                while part := opened.read(2**20):  # large parts: the parser begins again at each one
                    if (left := left - len(part)) < 0:
                        self._refuse("more than 4 GiB when it is unpacked")
                    self._parser.Parse(part)
                self._parser.Parse(b"", True)
        except ConfigError:
            raise
        except (OSError, EOFError, LookupError, ValueError, zlib.error, expat.ExpatError) as error:
            raise ConfigError(f"{path} cannot be read: {error}") from None
        return self._found._replace(includes=tuple(self._included))

    def _refuse(self, what: str) -> NoReturn:
        raise ConfigError(f"{self._path}, line {self._parser.CurrentLineNumber}: {what}")

    def _document_type(self, *_: object) -> None:
        self._refuse("a document type (<!DOCTYPE ...>) may hold entities that never end: remove it")

    def _end(self, _: str) -> None:
        self._depth -= 1

    def _element(self, tag: str, has: Mapping[str, str]) -> None:
        self._depth += 1
        if self._depth > DEEPEST:
            self._refuse(f"more than {DEEPEST} elements in each other")
        if self._is_network:
            self._network(tag, has)
        elif tag in OTHER_FILES:  # anywhere: a network within routes may end the process
            self._refuse(f"this is {OTHER_FILES[tag]}, and no file of routes or additional elements")
        self._attributes(tag, has)
        if not self._is_network:
            self._note(tag, has)
        self._departure(tag, has)
        self._other_file(tag, has)

    def _network(self, tag: str, has: Mapping[str, str]) -> None:
        if tag in NOT_IN_NETWORKS:
            self._refuse(f"<{tag}> in a network may end the process: move it to an additional file")
        if tag == "lane":
            place = self._depth, has.get("index")
            if place != (3, str(self._lanes)) or len(has.get("shape", "").split()) < 2:
                self._refuse(f"expected lane {self._lanes} of an edge, with a shape of two points or more")
            self._lanes += 1
        elif tag == "edge":
            self._lanes = 0

    def _attributes(self, tag: str, has: Mapping[str, str]) -> None:
        for name, text in has.items():
            if is_number(name) and SUSPECT.search(text):
                if any(map(_is_none, WORDS.findall(text))):
                    self._refuse(f'<{tag} {name}="{text:.60}"> is no number that SUMO can drive with')
            elif name in ("file", "output", "dest") and _is_connection(text):
                self._refuse(
                    f'<{tag} {name}="{text:.60}"> opens a connection to another program: name a file'
                )
            if span := RANGES.get(tag, {}).get(name):
                low, high = span
                numbers = [_number(word, low) for word in WORDS.findall(text)]
                is_cut = text.count("(") != text.count(")")
                if is_cut or (numbers and not (low <= numbers[0] and max(numbers) <= high)):
                    self._refuse(f'<{tag} {name}="{text:.60}"> must be from {low:g} to {high:g}')
        if has.get("vClass", "passenger") not in _classes():
            self._refuse(f'there is no vClass="{has["vClass"]:.60}"; SUMO would take another without a word')

    def _note(self, tag: str, has: Mapping[str, str]) -> None:
        name = has.get("id", "")
        self._found.ids.add(name)
        if tag == "vType" and "carFollowModel" in has:
            self._found.models[name] = has["carFollowModel"]
        if tag in DEPARTING:
            text = has.get("depart", has.get("begin", ""))
            time = seconds("depart", text) if re.fullmatch(r"[\d.:]+", text) else None
            self._found.departing.append((name, tag in ("vehicle", "trip", "flow"), time))

    def _departure(self, tag: str, has: Mapping[str, str]) -> None:
        if tag in ("vehicle", "trip"):
            depart = has.get("depart", "")
            self._departures[depart] += 1
            if self._departures[depart] > CROWD:
                self._refuse(f'more than {CROWD:,} vehicles have depart="{depart}"')
        elif tag in FLOWS and (rate := _rate(has)) > MOST:
            flow = f"<{tag}> {has.get('id', '')!r}"
            self._refuse(f"{flow} asks for {rate:.3g} departures a second; at most {MOST:g} are possible")

    def _other_file(self, tag: str, has: Mapping[str, str]) -> None:
        if tag == "include" or (tag in READERS and "file" in has):
            if not (name := has.get("href", "") or has.get("file", "")):
                self._refuse(f"<{tag}> names no file: SUMO would end the process")
            self._included.append(self._path.parent / name)
        elif re.search("file|output", has.get("key", "")) and _is_connection(has.get("value", "")):
            self._refuse(f'"{has["key"]}" opens a connection to {has["value"]}: name a file')


@lru_cache(1)
def _classes() -> frozenset[str]:
    """SUMO's classes of vehicles."""
    from sumolib.net.lane import SUMO_VEHICLE_CLASSES

    return frozenset((*SUMO_VEHICLE_CLASSES, "ignoring"))


def _number(text: str, otherwise: float) -> float:
    try:
        return float(text)
    except ValueError:
        return otherwise


def _is_none(word: str) -> bool:
    """Whether a word is a number that is not finite, or too large for anything on a road."""
    return word[:2].lower() == "0x" or not abs(_number(word, 0.0)) <= LARGEST


def _is_connection(name: str) -> bool:
    """As SUMO decides: a colon, but for the letter of a drive of Windows."""
    return name.find(":") > 1 or name.startswith("[")


def _rate(has: Mapping[str, str]) -> float:
    """Departures of a flow [1/s], as far as its attributes are plain numbers."""
    if "number" in has and "period" not in has:
        begin = _number(has.get("begin", "0"), 0.0)
        seconds = _number(has.get("end", ""), begin + DAY) - begin
        return _number(has["number"], 0.0) / seconds if seconds > 0.0 else 0.0
    for name in ("vehsPerHour", "perHour"):
        if name in has:
            return _number(has[name], 0.0) / 3600.0
    period = has.get("period", "")
    if drawn := re.fullmatch(r"\s*exp\((.*)\)\s*", period):
        return _number(drawn[1], 0.0)
    gap = _number(period, 1.0)
    return 1.0 / gap if gap > 0.0 else 0.0
