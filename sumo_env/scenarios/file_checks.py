"""What files of SUMO hold that has to be known before SUMO reads them: ids, types, and who departs when.

SUMO's own reader judges what they say. Refused are the few inputs that end the process instead of an error, and
outputs that open a connection; where outputs go, `settings.file_settings` says.
"""

import gzip
import os
import re
import zlib
from collections.abc import Mapping
from functools import lru_cache
from math import inf
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from sumo_env.config import ConfigError, did_you_mean
from sumo_env.networks.meeting import edge_of
from sumo_env.scenarios.configuration import INPUTS, seconds
from sumo_env.sumo.user_options import is_connection
from sumo_env.traffic.scenario import Arrival

NOT_IN_NETWORKS = {"edgeData", "laneData", "timedEvent"}  # they end the process there
VEHICLES = {"vehicle", "trip", "flow"}
REMOVING = {"calibrator", "vaporizer"}
PEOPLE = {"person", "personFlow"}
DEPARTING = {*VEHICLES, *PEOPLE, "container", "containerFlow"}
OTHER_FILES = {"net": "a network", "configuration": "a configuration", "osm": "a map of OpenStreetMap"}
UNSORTED = (
    "it departs before what stands before it in its route file. Sort the file (SUMO has "
    "tools/route/sort_routes.py), or take it as an additional file"
)


class Contents:
    """What route and additional files hold together."""

    def __init__(self) -> None:
        self.vehicles: set[str] = set()  # ids of vehicles and trips
        self.flows: set[str] = set()  # ids of flows, whose vehicles are named ID.0, ID.1 and so on
        self.ids: set[str] = set()  # of all elements
        # car-following models of the vehicle types, by type; "" where a type names none
        self.models: dict[str, str] = {}
        self.distributions: set[str] = set()  # ids of distributions of vehicle types
        self.people = False  # whether somebody is on foot
        # of vehicles, trips and flows that say where they arrive, by their ids
        self.arrivals: dict[str, Arrival] = {}
        self.removing: set[str] = set()  # edges on which calibrators or vaporizers remove vehicles
        self.first_departure: float | None = None  # time of it [s], None without one
        # ids of what SUMO leaves out: it departs earlier than what stands before it in a route file
        self.left_out: list[str] = []

    def check_vehicle(self, name: str) -> None:
        """That a vehicle of this id comes, as far as the files say.

        Raises:
            ConfigError: there is none, or it is a flow; the message names vehicles.
        """
        stem, _, number = name.rpartition(".")  # of a vehicle of a flow
        if name in self.left_out or stem in self.left_out:
            raise ConfigError(f"SUMO leaves out the vehicle {name!r}: {UNSORTED}")
        if name in self.vehicles or (stem in self.flows and number.isdigit()):
            return
        if name in self.flows:
            raise ConfigError(f"{name} is a flow: its vehicles are named {name}.0, {name}.1, ...")
        known = sorted(self.vehicles | {f"{flow}.0" for flow in self.flows - {""}})
        hint = did_you_mean(name, known) or f"they have {', '.join(known[:20]) or 'none'}"
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
    named = ((option, name) for option in INPUTS for name in options.get(option, "").split(",") if name)
    files = tuple((option, *_stamped(Path(name))) for option, name in named)
    return _contents(files, options.get("route-steps") != "0")


@lru_cache(64)
def _contents(files: tuple[tuple[str, Path, int, int], ...], in_order: bool) -> Contents:
    """What files hold, which are known by option, path, time and size; in_order: whether SUMO wants routes sorted."""
    contents = Contents()
    for option, path, *_ in files:
        _Reader(contents, path, option == "net-file", in_order and option == "route-files").read()
    return contents


def _stamped(path: Path) -> tuple[Path, int, int]:
    path = Path(os.path.realpath(path))  # Path.resolve fails where links form a circle
    if not os.path.isfile(path):
        raise ConfigError(f"there is no file {path}")
    about = path.stat()
    return path, about.st_mtime_ns, about.st_size


class _Reader:
    """Goes through the elements of one file, and notes what is in it."""

    def __init__(
        self,
        contents: Contents,
        path: Path,
        is_network: bool,
        in_order: bool,
        including: tuple[Path, ...] = (),
    ) -> None:
        """in_order: whether SUMO leaves out what departs before what stands before it."""
        self._contents, self._path, self._is_network, self._in_order = contents, path, is_network, in_order
        self._including, self._includes = (path, *including), list[Path]()
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler, self._parser.EndElementHandler = self._element, self._end
        self._latest = -inf  # departure [s]
        self._edge, self._lanes = "", set[str]()  # the edge around an element, and the numbers of its lanes

    def read(self) -> None:
        """Read the file, and those that it includes."""
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
        # without a word SUMO goes on without the others
        for further in filter(os.path.isfile, self._includes):
            if further in self._including:
                raise ConfigError(f"{path} includes {further}, which includes it: SUMO would not end")
            _Reader(self._contents, further, self._is_network, False, self._including).read()

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
        name, contents = has.get("id", ""), self._contents
        contents.ids.add(name)
        if tag == "vType":
            contents.models[name] = has.get("carFollowModel", "")
        if tag == "vTypeDistribution":
            contents.distributions.add(name)
        if tag in VEHICLES:
            (contents.flows if tag == "flow" else contents.vehicles).add(name)
            if {"arrivalPos", "arrivalEdge"} & has.keys():
                contents.arrivals[name] = Arrival(has.get("arrivalPos", "max"), has.get("arrivalEdge", ""))
        if tag in REMOVING:
            contents.removing.add(has.get("edge", "") or edge_of(has.get("lane", "")) or name)
        contents.people |= tag in PEOPLE
        depart = has.get("depart", has.get("begin", ""))
        if tag in DEPARTING and re.fullmatch(r"[\d.:]+", depart):
            self._depart(name, seconds("depart", depart), bool(has.get("line")))

    def _depart(self, name: str, time: float, is_line: bool) -> None:
        """is_line: whether it is a line of public transport, all of which may stand before the others."""
        if self._in_order and time < self._latest:
            self._contents.left_out.append(name)
            return
        if not is_line:
            self._latest = max(self._latest, time)
        first = self._contents.first_departure
        self._contents.first_departure = time if first is None else min(first, time)

    def _other_files(self, tag: str, has: Mapping[str, str]) -> None:
        """Files that an element reads or writes."""
        named = {name: has[name] for name in ("file", "output", "dest") if name in has}
        if re.search("file|output", has.get("key", "")):
            named[has["key"]] = has.get("value", "")
        for name, value in named.items():
            if is_connection(value):
                self._refuse(
                    f'<{tag}> opens a connection to another program, {name}="{value:.60}": name a file'
                )
        if tag == "include":
            if not (name := has.get("href", "")):
                self._refuse("<include> names no file, which ends the process")
            self._includes.append(Path(os.path.realpath(self._path.parent / name)))
        if tag == "variableSpeedSign" and not (self._path.parent / has.get("file", "")).exists():
            self._refuse(f"there is no file {has['file']!r}, which ends the process")
