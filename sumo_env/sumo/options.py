"""Options of SUMO that a user adds, such as output files."""

from __future__ import annotations

from collections.abc import Sequence
from pkgutil import resolve_name
from typing import Any

from sumo_env.config import ConfigError

# Options that cannot be changed, and why; the environment sets them itself or could not do its work with them.
REFUSED = {
    "--configuration-file": "the environment configures SUMO; pass single options",
    **dict.fromkeys(
        ("--net-file", "--route-files"),
        "roads and vehicles are the task's: use SumoDrivingEnv(network=..., routes=...)",
    ),
    **dict.fromkeys(("--begin", "--end"), "episodes begin and end with reset() and 'duration'"),
    "--step-length": "use the config key 'simulation_frequency'",
    **dict.fromkeys(
        ("--collision.action", "--collision.check-junctions", "--collision.mingap-factor", "--time-to-teleport",
         "--lanechange.duration"),
        "crash records and the ego rely on the value that it has",
    ),
    "--lateral-resolution": "the lane changes of the ego do not work with SUMO's sublane model",
    "--load-state": "an episode begins with a scenario: reset(options={'scenario': ...})",
    **dict.fromkeys(
        ("--remote-port", "--num-clients", "--gui", "--start"),
        "SUMO runs inside the process, without a window; export() writes an episode for sumo-gui",
    ),
}  # fmt: skip


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


def make(name: str, options: tuple[str, ...]) -> Any:
    """A simulator of the class ``module:name``."""
    simulator = resolve_name(name)
    return simulator(options=options) if options else simulator()
