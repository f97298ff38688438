"""Options of SUMO that a user adds, such as output files."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from sumo_env.config import ConfigError

# What the environment sets itself, or could not do its work with.
REFUSED = (
    *("--configuration-file", "--net-file", "--route-files", "--begin", "--end", "--step-length"),
    *("--collision.action", "--collision.check-junctions", "--collision.mingap-factor", "--time-to-teleport"),
    *("--lanechange.duration", "--lateral-resolution", "--load-state"),
    *("--remote-port", "--num-clients", "--gui", "--start"),
)


# Likewise, where SUMO loads the traffic of its own files.
REFUSED_FOR_FILES = (
    *("--configuration-file", "--net-file", "--route-files", "--begin", "--end", "--step-length", "--seed"),
    *(
        "--random",
        "--collision.action",
        "--collision.check-junctions",
        "--collision.mingap-factor",
        "--load-state",
    ),
    *("--remote-port", "--num-clients", "--gui", "--start"),
)
OUTPUT_DIR = "--output-dir"  # no option of SUMO: the folder for its outputs


def check_options(options: Sequence[str], refused: Collection[str] = REFUSED) -> tuple[str, ...]:
    """The options, each as ``--name=value``; they may also be given as ``--name``, ``value``.

    Raises:
        ConfigError: not a list of strings, no long name, or an option that cannot be changed.
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
        if name in refused:
            raise ConfigError(
                f"SUMO's option {name} is the environment's own: roads and vehicles are those of SumoDrivingEnv, steps "
                "and ends follow 'begin', 'simulation_frequency' and 'duration', SUMO's seed is that of reset(), and "
                "export() writes an episode for sumo-gui"
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
