"""Options of SUMO that a user adds, such as output files."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version

from sumo_env.config import ConfigError

# What the environment sets itself, or could not do its work with: everywhere, in tasks that place their vehicles
# themselves, and where SUMO loads the traffic of its own files.
REFUSED = (
    *("--configuration-file", "--net-file", "--route-files", "--begin", "--end", "--step-length"),
    *("--collision.action", "--collision.check-junctions", "--collision.mingap-factor"),
    *("--load-state", "--mesosim", "--remote-port", "--num-clients", "--gui", "--start"),
)
REFUSED_BY_TASKS = ("--time-to-teleport", "--lanechange.duration", "--lateral-resolution")
REFUSED_FOR_FILES = ("--seed", "--random", "--output-prefix")
# Beginnings of the options that change what SUMO does with the vehicles of its own files: when they come, how they are
# inserted, what their types leave out, and SUMO's random numbers.
OF_FILES = (
    *("--scale", "--max-num-vehicles", "--max-depart-delay", "--random", "--seed", "--default."),
    *("--insertion-checks", "--sloppy-insert", "--eager-insert", "--emergency-insert"),
    *("--extrapolate-departpos", "--route-steps", "--ignore-route-errors", "--thread-rngs"),
)
OUTPUT_DIR = "--output-dir"  # no option of SUMO: the folder for its outputs
LIVE = "--sumo-gui"  # likewise: that SUMO runs in its own window


def check_live(live: str | None) -> bool:
    """Whether SUMO's own window is wanted.

    Raises:
        ConfigError: another window.
        ImportError: there is no sumo-gui of libsumo's version.
    """
    if live not in (None, "sumo-gui"):
        raise ConfigError(f"live must be None or 'sumo-gui', not {live!r}")
    if live is None:
        return False
    found, needed = {}, version("libsumo")
    for package in ("eclipse-sumo", "traci"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "missing"
    if set(found.values()) != {needed}:
        said = ", ".join(f"{package} is {what}" for package, what in found.items())
        raise ImportError(
            f"live='sumo-gui' needs eclipse-sumo and traci {needed}, as libsumo has it, but {said}: "
            f"pip install eclipse-sumo=={needed} traci=={needed} (or, in a clone of this project, pip install '.[gui]')"
        )
    return True


def check_options(options: Sequence[str], of_files: bool) -> tuple[str, ...]:
    """The options, each as ``--name=value``; they may also be given as ``--name``, ``value``.

    of_files: whether SUMO loads the traffic of its own files.

    Raises:
        ConfigError: not a list of strings, no long name, an option that cannot be changed, or one that has no effect.
    """
    if isinstance(options, str) or not all(isinstance(option, str) for option in options):
        raise ConfigError(
            f'sumo_options must be a list of strings, such as ["--tripinfo-output", "trips.xml"], not {options!r}'
        )
    found: dict[str, str] = {}
    name = ""
    for part in options:
        if part.startswith("--"):
            name, _, value = part.partition("=")
            found[name] = value or "true"
        elif name:
            found[name], name = part, ""
        else:
            raise ConfigError(f"sumo_options: expected the long name of one of SUMO's options, not {part!r}")
        if name in (*REFUSED, *(REFUSED_FOR_FILES if of_files else REFUSED_BY_TASKS)):
            raise ConfigError(
                f"SUMO's option {name} is the environment's own: roads and vehicles are those of SumoDrivingEnv, steps "
                "and ends follow 'begin', 'simulation_frequency' and 'duration', SUMO's seed is that of reset(), and "
                "export() writes an episode for sumo-gui"
            )
        if not of_files and name.startswith(OF_FILES):
            raise ConfigError(
                f"SUMO's option {name} has no effect here: it is for the vehicles of SUMO's files, and this task "
                "places every vehicle itself, by the seed of reset(). Keys of the configuration change the traffic; "
                "SumoDrivingEnv drives SUMO's files"
            )
    return tuple(f"{name}={value}" for name, value in found.items())


def check_copyable(options: Sequence[str]) -> None:
    """See to it that a simulation with these options can be copied.

    Raises:
        TypeError: it writes files, which copies would write as well, or it runs in several threads.
    """
    for option in options:
        name = option.partition("=")[0]
        writes = (
            "output" in name or "log" in name or name.startswith("--save-") or name == "--additional-files"
        )
        if writes or name.endswith("threads"):
            raise TypeError(
                f"an environment with SUMO's option {name} cannot be copied: copies would write to the same files, "
                "and have none of the threads"
            )
