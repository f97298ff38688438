"""SUMO's own files (.sumocfg, routes, additional files), as the options with which SUMO loads them.

SUMO reads, routes, inserts and removes what is in the files; `foreign` looks into them before. This module knows which
files there are, and how SUMO understands their names.
"""

from __future__ import annotations

import atexit
import os
import re
import shutil
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

from sumo_env.config import ConfigError

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


def is_output(option: str) -> bool:
    """Whether an option of SUMO names a file that it writes."""
    return (option.endswith("output") and option != "human-readable-output") or option in LOGS


def configuration(file: Path) -> dict[str, str]:
    """The options of a .sumocfg, with the paths of its input files made absolute.

    Raises:
        ConfigError: the file cannot be read, is no configuration with a network, or asks for mesoscopic traffic.
    """
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, LookupError, ValueError, ElementTree.ParseError) as error:
        raise ConfigError(f"{file} cannot be read: {error}") from error
    found: dict[str, str] = {}
    for section in root:
        if section.tag == "gui_only":
            continue
        for item in (section, *section):
            value = item.get("value", item.get("v"))
            if value is not None:
                name = SYNONYMS.get(item.tag, item.tag)
                if found.setdefault(name, value) != value:  # SUMO refuses it as well
                    raise ConfigError(
                        f"{file}: the option {name!r} is given twice: {found[name]!r} and {value!r}"
                    )
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
    # a configuration is read here, and has files beside it
    return found if name == "network" else tuple(map(plain_path, found))


def plain_path(path: Path) -> Path:
    """A path to a file that SUMO understands, which takes a comma as the end of a name, and ``${...}`` as a variable.

    Raises:
        ConfigError: there is none, because all folders for temporary files have such names.
    """
    return path if _is_plain(path) else _linked(path, os.getpid())


@cache
def _linked(path: Path, process: int) -> Path:
    """A link to a file: of this process, because a copy of it may live longer."""
    folder = _links(process)
    ending = re.search(r"(\.\w+)*$", path.name)
    assert ending is not None
    link = folder / f"{len(list(folder.iterdir()))}{ending[0]}"
    if not _is_plain(path.name):
        link.symlink_to(path)
        return link
    link.symlink_to(path.parent, target_is_directory=True)  # files beside this one can be found as well
    return link / path.name


def _is_plain(path: str | Path) -> bool:
    return "," not in str(path) and "${" not in str(path)


def temporary_folder() -> str:
    """A folder for temporary files with a name that SUMO understands.

    Raises:
        ConfigError: there is none.
    """
    folders = (tempfile.gettempdir(), "/tmp", "/var/tmp", os.getcwd())
    for folder in folders:
        if _is_plain(folder) and os.access(folder, os.W_OK):
            return folder
    raise ConfigError(
        f"SUMO takes a comma as the end of a name, and ${{...}} as a variable, and needs a folder for temporary files "
        f"without: choose one by TMPDIR (tried: {'; '.join(folders)})"
    )


@cache
def _links(process: int) -> Path:
    """A folder that this process deletes at its end, and no copy of it does."""
    folder = tempfile.mkdtemp(prefix="sumo_env-", dir=temporary_folder())

    def delete() -> None:
        if os.getpid() == process:
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(delete)
    return Path(folder)


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
