"""SUMO's own files (.sumocfg, routes, additional files), as the options with which SUMO loads them.

SUMO reads, routes, inserts and removes what is in the files. This module only finds out what has to be known before:
which files there are, with which step, from when on, and which ids are in use.
"""

from __future__ import annotations

import difflib
import gzip
import os
import re
import tempfile
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from sumo_env.config import ConfigError

Options = Mapping[str, str]  # SUMO's long names, without dashes -> values
# Short and old names that configurations have for options that are read here.
SYNONYMS = {
    **{
        "n": "net-file",
        "net": "net-file",
        "r": "route-files",
        "route": "route-files",
        "routes": "route-files",
    },
    **{"a": "additional-files", "additional": "additional-files", "b": "begin", "e": "end", "S": "scale"},
    **{"l": "log", "log-file": "log", "w": "weight-files", "weights": "weight-files", "v": "verbose"},
    **{"ndump": "netstate-dump", "netstate": "netstate-dump", "person-fcd": "person-fcd-output"},
    **{"summary": "summary-output", "tripinfo": "tripinfo-output", "personinfo": "personinfo-output"},
    **{"vehroutes": "vehroute-output", "personroutes": "personroute-output", "X": "xml-validation"},
    **{"device.fcd-replay.file": "device.fcd-replay.files", "m": "edgedata-files"},
    **{"data-files": "edgedata-files"},
}
INPUTS = (
    "net-file",
    "route-files",
    "additional-files",
    "weight-files",
    "load-state",
    "device.fcd-replay.files",
    "edgedata-files",
)
# Of a configuration: what belongs to sumo-gui, to a server, or to the episode; and what ends SUMO at once, or lets it
# read schemas of the network and document types whose entities never end.
LEFT_OUT = (
    *("end", "seed", "random", "remote-port", "num-clients", "start", "quit-on-end", "verbose"),
    *("duration-log.statistics", "print-options", "output-prefix", "configuration-file"),
    *("configuration", "c", "help", "version", "V", "save-configuration", "save-config", "C"),
    *("save-template", "save-schema", "save-commented", "save-template.commented", "xml-validation"),
    *("xml-validation.net", "xml-validation.routes"),
)
LOGS = {"log", "message-log", "error-log", "netstate-dump", "device.ssm.file", "device.toc.file"}
DEPARTING = ("vehicle", "trip", "flow", "person", "personFlow", "container", "containerFlow")


def is_output(option: str) -> bool:
    """Whether an option of SUMO names a file that it writes."""
    return (option.endswith("output") and option != "human-readable-output") or option in LOGS


def configuration(file: Path) -> dict[str, str]:
    """The options of a .sumocfg, with the paths of its input files made absolute.

    Raises:
        ConfigError: the file cannot be read, is no configuration with a network, or asks for mesoscopic traffic.
    """
    root = _root(file)
    found: dict[str, str] = {}
    for section in root:
        if section.tag == "gui_only":
            continue
        for item in (section, *section):
            value = item.get("value", item.get("v"))
            if value is not None:
                found[SYNONYMS.get(item.tag, item.tag)] = value
    for name in set(found).intersection(INPUTS):
        files = [file.parent / part.strip() for part in found[name].split(",") if part.strip()]
        found[name] = ",".join(map(str, paths(f"{file}: {name}", files)))
    if "net-file" not in found:
        raise ConfigError(
            f"{file} is no configuration of SUMO with a network: it has no <net-file value=.../>"
        )
    if found.get("mesosim", "false") not in ("false", "0", "no", "off"):
        raise ConfigError(f"{file}: with 'mesosim' SUMO moves queues and no single cars: take the option out")
    return {name: value for name, value in found.items() if name not in LEFT_OUT}


def paths(name: str, given: str | Path | Sequence[str | Path]) -> tuple[Path, ...]:
    """Files of an argument, one or several.

    Raises:
        ConfigError: one of them does not exist.
    """
    several = [given] if isinstance(given, str | Path) else list(given)
    found = tuple(Path(os.path.realpath(path)) for path in several)
    for path in found:
        if not os.path.isfile(path):  # also where the name is longer than any
            raise ConfigError(f"{name}: there is no file {path}")
    # a network is opened by the session, see `options.readable`; of the others there may be several
    return found if name.endswith(("network", "net-file")) else tuple(map(_plain_path, found))


@cache
def _plain_path(path: Path) -> Path:
    """A path to a file that SUMO understands, which takes a comma as the end of a name, and ``${...}`` as a variable.

    Raises:
        ConfigError: there is none, because the folder for temporary files has such a name.
    """
    folder_is_odd, name_is_odd = ("," in part or "${" in part for part in (str(path.parent), path.name))
    if not (folder_is_odd or name_is_odd):
        return path
    folder = Path(_links().name)
    ending = re.search(r"(\.\w+)*$", path.name)
    assert ending is not None
    link = folder / f"{len(list(folder.iterdir()))}{ending[0]}"
    if "," in str(link) or "${" in str(link):
        raise ConfigError(
            f"SUMO cannot read {path}: it takes a comma as the end of a name, and ${{...}} as a variable. Choose "
            "another folder (TMPDIR is the variable for temporary files)"
        )
    if name_is_odd:
        link.symlink_to(path)
        return link
    link.symlink_to(path.parent, target_is_directory=True)  # files beside this one can be found as well
    return link / path.name


@cache
def _links() -> tempfile.TemporaryDirectory[str]:
    """A folder of this process, deleted at its end."""
    return tempfile.TemporaryDirectory(prefix="sumo_env-")


def seconds(option: str, text: str) -> float:
    """A time of SUMO [s], which may be written as hours:minutes:seconds.

    Raises:
        ConfigError: it is none.
    """
    parts = text.split(":")
    try:
        return float(
            sum(float(part) * unit for part, unit in zip(reversed(parts), (1, 60, 3600, 86400), strict=False))
        )
    except ValueError:
        raise ConfigError(f"{option}={text!r} is no time") from None


class Contents:
    """What is asked of route and additional files before SUMO reads them."""

    def __init__(self, options: Options) -> None:
        listed = (options.get("additional-files", ""), options.get("route-files", ""))
        self.files = [Path(part) for names in listed for part in names.split(",") if part]

    def first_departure(self) -> float | None:
        """Time of the first departure [s], for SUMO reads files in the order of departure; None without one."""
        times = []
        for file in self.files:
            with closing(_elements(file)) as elements:
                for item in elements:
                    text = item.get("depart", item.get("begin"))
                    if item.tag in DEPARTING and text is not None:
                        if re.fullmatch(r"[\d.:]+", text):
                            times.append(seconds("depart", text))
                        break
        return min(times, default=None)

    def has_id(self, name: str) -> bool:
        """Whether something in the files may have this id."""
        pattern = re.compile(rb"""\bid\s*=\s*["']%s["']""" % re.escape(name.encode()))
        for file in self.files:
            with _opened(file) as opened:
                if pattern.search(opened.read()):
                    return True
        return False

    def check_vehicle(self, name: str) -> None:
        """That a vehicle of this id comes, as far as the files say.

        Raises:
            ConfigError: there is none; the message names near ids.
        """
        known: set[str] = set()
        for file in self.files:
            for item in _elements(file):
                if item.tag in ("vehicle", "trip", "flow"):
                    known.add(item.get("id", ""))
        if name in known or name.rpartition(".")[0] in known:
            return
        stem, _, number = name.rpartition(".")
        near = difflib.get_close_matches(name, sorted(known), n=5)
        near += [f"{flow}.{number}" for flow in difflib.get_close_matches(stem, sorted(known), n=5)]
        hint = (
            f"did you mean one of {', '.join(near)}?"
            if near
            else f"they have {', '.join(sorted(known)[:20])}"
        )
        raise ConfigError(f"the files have no vehicle {name!r}; {hint}")

    def models(self) -> dict[str, str]:
        """Car-following models of the vehicle types that name one, by type."""
        return {
            item.get("id", ""): item.get("carFollowModel", "")
            for file in self.files
            for item in _elements(file)
            if item.tag == "vType" and item.get("carFollowModel")
        }


def _opened(file: Path) -> Any:
    return gzip.open(file) if file.suffix == ".gz" else file.open("rb")


def _root(file: Path) -> ElementTree.Element:
    try:
        with _opened(file) as opened:
            return ElementTree.parse(opened).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise ConfigError(f"{file} cannot be read: {error}") from error


def _elements(file: Path) -> Generator[ElementTree.Element, None, None]:
    """The elements of a file, as far as they are asked for."""
    try:
        with _opened(file) as opened:
            for _, item in ElementTree.iterparse(opened):
                yield item
                if item.tag in DEPARTING:
                    item.clear()
    except (OSError, ElementTree.ParseError) as error:
        raise ConfigError(f"{file} cannot be read: {error}") from error
