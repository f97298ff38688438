"""SUMO's own files (.sumocfg, routes, additional files), as the options with which SUMO loads them.

SUMO reads, routes, inserts and removes what is in the files; `file_checks` looks into them before. This module knows
which files there are.
"""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree

from sumo_env.config import ConfigError
from sumo_env.sumo.paths import is_output, listed, plain_path
from sumo_env.traffic.sumo_schemas import schema

# Short and old names of options that are read or left out here (`sumo --print-options true` lists all).
SYNONYMS = {
    short: name
    for name, several in {
        "net-file": "n net",
        "route-files": "r routes",
        "additional-files": "a additional",
        "weight-files": "w weights",
        "device.fcd-replay.files": "device.fcd-replay.file",
        "begin": "b",
        "end": "e",
        "seed": "srand",
        "random": "abs-rand",
        "route-steps": "s",
        "device.rerouting.threads": "routing-threads",
        "no-warnings": "W suppress-warnings",
        "duration-log.disable": "no-duration-log",
        "duration-log.statistics": "t",
        "verbose": "v",
        "version": "V",
        "help": "?",
        "xml-validation": "X",
        "configuration-file": "c configuration",
        "save-configuration": "C",
        "log": "l log-file",
        "netstate-dump": "ndump netstate netstate-output",
        "summary-output": "summary",
        "statistic-output": "statistics-output",
        "tripinfo-output": "tripinfo",
        "vehroute-output": "vehroutes",
        "personinfo-output": "personinfo",
        "personroute-output": "personroutes",
        "person-fcd-output": "person-fcd",
        "gui-settings-file": "g",
        "edgedata-files": "m data-files",
        "alternative-net-file": "N",
        "breakpoints": "B",
        "delay": "d",
        "demo": "D",
        "disable-textures": "T",
        "game": "G",
        "quit-on-end": "Q",
        "start": "S",
    }.items()
    for short in several.split()
}
INPUTS = ("net-file", "route-files", "additional-files")  # that are looked into
# Of a configuration: what belongs to a server or to the episode; threads, which copies do not have; what ends SUMO at
# once, or lets it fetch schemas.
LEFT_OUT = {
    *("end", "seed", "random", "remote-port", "num-clients", "threads", "device.rerouting.threads"),
    *("verbose", "duration-log.statistics", "print-options", "output-prefix", "help", "version"),
    *("configuration-file", "xml-validation", "xml-validation.net", "xml-validation.routes"),
}


def is_configuration(file: Path) -> bool:
    """Whether a file is a configuration of SUMO, by its first element."""
    is_named_so = file.name.lower().endswith(".sumocfg")
    try:
        with file.open("rb") as opened:
            _, root = next(ElementTree.iterparse(opened, ("start",)))
    except (OSError, LookupError, ValueError, ElementTree.ParseError):
        return is_named_so  # what is wrong is said where it is read
    return is_named_so or root.tag.lower().endswith("configuration")


def configuration(file: Path) -> dict[str, str]:
    """What a configuration says, as options of SUMO with absolute names of files.

    SUMO's schema says which options name files, and which belong to sumo-gui. Options of the window and those that are
    LEFT_OUT are not among them. ``sumo -c`` is no substitute: it cannot be told to write no outputs.

    Raises:
        ConfigError: the file cannot be read, is no configuration with a network, or asks for mesoscopic traffic.
    """
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, LookupError, ValueError, ElementTree.ParseError) as error:
        raise ConfigError(f"{file} cannot be read: {error}") from error
    kinds = schema("sumoConfigurationType")
    of_window = kinds.get("sumogui_onlyTopicType", {})
    found: dict[str, str] = {}
    for item in root.iter():
        name = SYNONYMS.get(item.tag, item.tag)
        value = item.get("value", item.get("v", item.text or "")).strip()
        value = re.sub(r"\$\{(\w*)\}", lambda variable: os.environ.get(variable[1], ""), value)
        if len(item) or not value or name in LEFT_OUT or name in of_window or name.startswith("save-"):
            continue
        if found.setdefault(name, value) != value:  # SUMO refuses it as well
            raise ConfigError(f"{file}: the option {name!r} is given twice: {found[name]!r} and {value!r}")
    files = {name for names in kinds.values() for name, kind in names.items() if kind == "fileOptionType"}
    for name in (files | {*INPUTS}) & found.keys():
        if not is_output(name):
            several = (plain_path(_beside(file, part)) for part in found[name].split(",") if part.strip())
            found[name] = listed(*several)
    if "net-file" not in found:
        raise ConfigError(f"{file} is no configuration with a network: it has no <net-file value=.../>")
    if found.get("mesosim", "false") not in ("false", "0", "no", "off"):
        raise ConfigError(f"{file}: with 'mesosim' SUMO moves queues and no single cars: take the option out")
    return found


def _beside(configuration: Path, name: str) -> Path:
    """A file that a configuration names, in UTF-8 and perhaps with characters as %20, whatever the locale is."""
    decoded = os.fsdecode(unquote(name.strip()).encode())
    return Path(os.path.abspath(configuration.parent / os.path.expanduser(decoded)))


def paths(name: str, given: str | Path | Sequence[str | Path]) -> tuple[Path, ...]:
    """Files of an argument, one or several.

    Raises:
        ConfigError: one of them does not exist.
    """
    several: Sequence[Any] = given if isinstance(given, list | tuple) else [given]
    if not all(isinstance(path, str | Path) for path in several):
        raise ConfigError(f"{name} must be a file or a list of files, not {given!r}")
    found = tuple(Path(os.path.abspath(path)) for path in several)
    for path in found:
        if not os.path.isfile(path):  # also where the name is longer than any
            raise ConfigError(f"{name}: there is no file {path}")
    # a configuration is read here, and has files beside it
    return found if name == "network" else tuple(map(plain_path, found))


def seconds(option: str, text: str) -> float:
    """A time of SUMO [s], which may be written as hours:minutes:seconds.

    Raises:
        ConfigError: it is none.
    """
    from sumolib.miscutils import parseTime  # late: it takes a tenth of a second

    try:
        return float(parseTime(text))
    except (TypeError, ValueError):
        raise ConfigError(f"{option}={text!r} is no time") from None
