"""Options of SUMO that a user adds, such as output files."""

from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version

from sumo_env.config import ConfigError
from sumo_env.sumo.paths import is_output

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
OUTPUT_DIR = "output-dir"  # no option of SUMO: the folder for its outputs
LIVE = "sumo-gui"  # likewise: that SUMO runs in its own window


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
    needed = version("libsumo")
    for package in ("eclipse-sumo", "traci"):
        try:
            found = version(package)
        except PackageNotFoundError:
            found = "missing"
        if found != needed:
            raise ImportError(
                f"live='sumo-gui' needs eclipse-sumo and traci {needed}, as libsumo has it, but {package} is {found}: "
                f"pip install eclipse-sumo=={needed} traci=={needed} (in a clone of this project: pip install '.[gui]')"
            )
    return True


def check_options(options: Sequence[str], of_files: bool) -> dict[str, str]:
    """The options by their names without dashes; they are given as ``--name=value``, or as ``--name``, ``value``.

    of_files: whether SUMO loads the traffic of its own files.

    Raises:
        ConfigError: not a list of strings, no long name, an option that cannot be changed, or one that has no effect.
    """
    if not isinstance(options, list | tuple) or not all(isinstance(option, str) for option in options):
        raise ConfigError(f'sumo_options must be a list of strings such as ["--scale", "2"], not {options!r}')
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
                f"SUMO's option {name} is the environment's own: files are those of SumoDrivingEnv, times those of the "
                "configuration, and SUMO's seed is that of reset()"
            )
        if not of_files and name.startswith(OF_FILES):
            raise ConfigError(
                f"SUMO's option {name} has no effect here, where the task places every vehicle, by the seed of "
                "reset(): it is for SumoDrivingEnv, which drives SUMO's files"
            )
    named = {name.removeprefix("--"): value for name, value in found.items()}
    if without := [name for name, value in named.items() if value == "true" and is_output(name)]:
        raise ConfigError(f"sumo_options: --{without[0]} needs a file")
    return named


def check_outputs(outputs: Iterable[tuple[str, str]]) -> None:
    """That outputs of a configuration, as (option, value), are files, and go where the others go.

    Raises:
        ConfigError: one opens a connection, or ignores the folder that is asked for.
    """
    for option, value in outputs:
        if option == "vtk-output":
            raise ConfigError(f"{option}={value!r} would not go to output_dir: take it as a sumo_option")
        if is_connection(value):
            raise ConfigError(f"{option}={value!r} opens a connection to another program: name a file")


def is_connection(name: str) -> bool:
    """As SUMO decides: a colon, but for the letter of a drive of Windows."""
    return name.find(":") > 1 or name.startswith("[")


def check_copyable(options: Iterable[str]) -> None:
    """See to it that a simulation with these options can be copied.

    Raises:
        TypeError: it writes files, which copies would write as well, or it runs in several threads.
    """
    for name in options:
        writes = "output" in name or "log" in name or name.startswith("save-")
        if writes or name == "additional-files" or name.endswith("threads"):
            raise TypeError(
                f"an environment with SUMO's option --{name} cannot be copied: copies would write to the same files, "
                "and have none of the threads"
            )
