"""Options of SUMO that a user adds, such as output files."""

from __future__ import annotations

from collections.abc import Sequence

from sumo_env.config import ConfigError

# Why an option cannot be changed: the environment sets it itself or could not do its work with it.
REASONS = {
    "the environment configures SUMO; pass single options": ["configuration-file"],
    "roads and vehicles are the task's: use SumoDrivingEnv(network=..., routes=...)": [
        "net-file",
        "route-files",
    ],
    "episodes begin and end with reset() and 'duration'": ["begin", "end"],
    "use the config key 'simulation_frequency'": ["step-length"],
    "crash records and the ego rely on the value that it has": [
        "collision.action",
        "collision.check-junctions",
        "collision.mingap-factor",
        "time-to-teleport",
        "lanechange.duration",
    ],
    "the lane changes of the ego do not work with SUMO's sublane model": ["lateral-resolution"],
    "an episode begins with a scenario: reset(options={'scenario': ...})": ["load-state"],
    "SUMO runs inside the process, without a window; export() writes an episode for sumo-gui": [
        "remote-port",
        "num-clients",
        "gui",
        "start",
    ],
}
REFUSED = {f"--{name}": reason for reason, names in REASONS.items() for name in names}


def check_options(options: Sequence[str]) -> tuple[str, ...]:
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
        if name in REFUSED:
            raise ConfigError(f"SUMO's option {name} cannot be changed: {REFUSED[name]}")
    return tuple(f"{name}={value}" for name, value in found.items())


def check_copyable(options: Sequence[str]) -> None:
    """See to it that a simulation with these options can be copied.

    Raises:
        TypeError: it writes files, which copies would write as well, or it runs in several threads.
    """
    for option in options:
        name = option.partition("=")[0]
        if name.endswith("threads"):
            raise TypeError(
                f"an environment with SUMO's option {name} cannot be copied: threads are not copied"
            )
        if "output" in name or "log" in name or name.startswith("--save-") or name == "--additional-files":
            raise TypeError(
                f"an environment with SUMO's option {name} cannot be copied: its copies would write to the same files"
            )
