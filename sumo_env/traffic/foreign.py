"""What files of SUMO hold that has to be known before SUMO reads them: ids, types, and who departs when.

SUMO's own reader judges what they say. Refused are the few inputs that end the process instead of an error, and
outputs that open a connection; where outputs go, `settings.file_settings` says.
"""

from __future__ import annotations

import difflib
import gzip
import os
import re
import zlib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from math import inf
from pathlib import Path
from typing import NamedTuple, NoReturn
from xml.parsers import expat

from sumo_env.config import ConfigError, did_you_mean
from sumo_env.traffic.sumo_files import INPUTS, seconds

NOT_IN_NETWORKS = {"edgeData", "laneData", "timedEvent"}  # they end the process there
VEHICLES = {"vehicle", "trip", "flow"}
PEOPLE = {"person", "personFlow"}
DEPARTING = {*VEHICLES, *PEOPLE, "container", "containerFlow"}
OTHER_FILES = {"net": "a network", "configuration": "a configuration", "osm": "a map of OpenStreetMap"}
UNSORTED = (
    "it departs before what stands before it in its route file. Sort the file (SUMO has "
    "tools/route/sort_routes.py), or take it as an additional file"
)


class Found(NamedTuple):
    """What one file holds: as of `Contents`, and who departs, with the time [s] where it is known."""

    includes: list[Path]
    ids: set[str]
    models: dict[str, str]
    distributions: set[str]
    stopping: set[str]
    departing: list[Departure]


class Departure(NamedTuple):
    """A vehicle, flow, person or container; tag: of its element; is_line: whether it is a line of public transport."""

    name: str
    tag: str
    is_line: bool
    time: float | None


class Contents:
    """What route and additional files hold together.

    Attributes:
        ids: of all elements.
        models: car-following models of the vehicle types, by type; "" where a type names none.
        distributions: ids of distributions of vehicle types.
        people: whether somebody is on foot.
        stopping: ids of vehicles and flows that arrive at a place of their own (``arrivalPos``).
        first_departure: time of the first departure [s], None without one.
        left_out: ids of what SUMO leaves out: it departs earlier than what stands before it in a route file.
    """

    def __init__(self) -> None:
        self.ids: set[str] = set()
        self.models: dict[str, str] = {}
        self.distributions: set[str] = set()
        self.people = False
        self.stopping: set[str] = set()
        self.first_departure: float | None = None
        self.left_out: list[str] = []
        self._vehicles: set[str] = set()

    def add(self, found: Found, in_order: bool) -> None:
        """Add a file; in_order: whether SUMO leaves out what departs before what stands before it."""
        latest = -inf
        self.ids |= found.ids
        self.models |= found.models
        self.distributions |= found.distributions
        self.stopping |= found.stopping
        for name, tag, is_line, time in found.departing:
            self.people |= tag in PEOPLE
            if tag in VEHICLES:
                self._vehicles.add(name)
            if time is None:
                continue
            if in_order and time < latest:
                self.left_out.append(name)
                continue
            if not is_line:  # lines of public transport may all stand before the others
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

    def check_type(self, name: str) -> None:
        """That there is a vehicle type of this id.

        Raises:
            ConfigError: there is none, or it is a distribution of types.
        """
        if name in self.distributions:
            raise ConfigError(f"{name!r} is a distribution of vehicle types: name one of its types")
        if name not in self.models and not name.startswith("DEFAULT_"):
            known = did_you_mean(name, self.models) or f"they have {', '.join(sorted(self.models)) or 'none'}"
            raise ConfigError(f"the files have no vehicle type {name!r}; {known}")


def check_files(options: Mapping[str, str]) -> Contents:
    """What the files of SUMO's options hold, by their long names without dashes.

    Raises:
        ConfigError: a file cannot be read, or holds what would end the process; the message names file and line.
    """
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
    if not os.path.isfile(path):
        raise ConfigError(f"there is no file {path}")
    about = path.stat()
    found = _read(path, is_network, about.st_mtime_ns, about.st_size)
    for further in filter(os.path.isfile, found.includes):  # without a word SUMO goes on without the others
        if further in (path, *including):
            raise ConfigError(f"{path} includes {further}, which includes it: SUMO would not come to an end")
        _check(further, is_network, (path, *including))
    return found


@lru_cache(256)
def _read(path: Path, is_network: bool, changed: int, size: int) -> Found:
    return _Reader(path, is_network).read()


class _Reader:
    """Goes through the elements of one file."""

    def __init__(self, path: Path, is_network: bool) -> None:
        self._path, self._is_network = path, is_network
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler, self._parser.EndElementHandler = self._element, self._end
        self._found = Found([], set(), {}, set(), set(), [])
        self._edge, self._lanes = "", set[str]()  # the edge around an element, and the numbers of its lanes

    def read(self) -> Found:
        """What the file holds."""
        path = self._path
        try:
            with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as opened:
                while part := opened.read(2**20):  # large parts: the parser begins again at each one
                    self._parser.Parse(part)
                self._parser.Parse(b"", True)
        except ConfigError:
            raise
        except (OSError, EOFError, LookupError, ValueError, zlib.error, expat.ExpatError) as error:
            raise ConfigError(f"{path} cannot be read: {error}") from None
        return self._found

    def _refuse(self, what: str) -> NoReturn:
        raise ConfigError(f"{self._path}, line {self._parser.CurrentLineNumber}: {what}")

    def _end(self, tag: str) -> None:
        if tag == "edge":
            self._edge = ""

    def _element(self, tag: str, has: Mapping[str, str]) -> None:
        if self._is_network:
            self._network(tag, has)
        elif tag in OTHER_FILES:  # anywhere: a network within routes may end the process
            self._refuse(f"this is {OTHER_FILES[tag]}, and no file of routes or additional elements")
        else:
            self._note(tag, has)
        self._other_files(tag, has)

    def _network(self, tag: str, has: Mapping[str, str]) -> None:
        """Lanes within junctions may have one number twice: netconvert 1.22 to 1.27 wrote them so."""
        if tag in NOT_IN_NETWORKS:
            self._refuse(f"<{tag}> in a network ends the process: move it to an additional file")
        if tag == "edge":
            self._edge, self._lanes = has.get("id", ""), set()
        elif tag == "lane":
            number = has.get("index", "")
            if not self._edge or (number in self._lanes and not self._edge.startswith(":")):
                where = f"lane {number} of edge {self._edge!r} again" if self._edge else "a lane of no edge"
                self._refuse(f"{where}, which ends the process: make the network again with netconvert")
            self._lanes.add(number)

    def _note(self, tag: str, has: Mapping[str, str]) -> None:
        name = has.get("id", "")
        self._found.ids.add(name)
        if tag == "vType":
            self._found.models[name] = has.get("carFollowModel", "")
        if tag == "vTypeDistribution":
            self._found.distributions.add(name)
        if has.get("arrivalPos", "max") != "max":
            self._found.stopping.add(name)
        if tag in DEPARTING:
            text = has.get("depart", has.get("begin", ""))
            time = seconds("depart", text) if re.fullmatch(r"[\d.:]+", text) else None
            self._found.departing.append(Departure(name, tag, bool(has.get("line")), time))

    def _other_files(self, tag: str, has: Mapping[str, str]) -> None:
        """Files that an element reads or writes."""
        named = {name: has[name] for name in ("file", "output", "dest") if name in has}
        if re.search("file|output", has.get("key", "")):
            named[has["key"]] = has.get("value", "")
        for name, value in named.items():
            if _is_connection(value):
                self._refuse(
                    f'<{tag}> opens a connection to another program, {name}="{value:.60}": name a file'
                )
        if tag == "include":
            if not (name := has.get("href", "")):
                self._refuse("<include> names no file, which ends the process")
            self._found.includes.append(Path(os.path.realpath(self._path.parent / name)))
        if tag == "variableSpeedSign" and not (self._path.parent / has.get("file", "")).exists():
            self._refuse(f"there is no file {has['file']!r}, which ends the process")


def _is_connection(name: str) -> bool:
    """As SUMO decides: a colon, but for the letter of a drive of Windows."""
    return name.find(":") > 1 or name.startswith("[")
