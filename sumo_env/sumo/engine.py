"""SUMO as a module: libsumo, or traci, which talks with SUMO's own window. No other module imports either.

libsumo supports one simulation per process; so does this package's use of traci.
"""

import contextlib
import io
import subprocess
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from sumolib.miscutils import getFreeSocketPort

from sumo_env.simulator import SimulatorError

try:
    # without its warning about versions of pyarrow, which SUMO needs for Parquet output alone
    with contextlib.redirect_stdout(io.StringIO()):
        import libsumo
except ImportError as error:
    reason = (
        "SUMO is here, but this system cannot load it. It needs about 1 GB of address space (ulimit -v), and on Linux "
        "libraries that slim systems lack: apt-get install libx11-6 libxext6 libxrender1 libgl1 libatomic1"
        if find_spec("libsumo")
        else "SUMO is missing. Install it with 'pip install libsumo==1.28.0' (the wheel brings SUMO along; no "
        "system-wide SUMO is needed)"
    )
    raise ImportError(f"{reason}. Python says: {error}") from error


class Engine(NamedTuple):
    """What a `Session` drives."""

    module: Any  # libsumo, or traci, which has the same functions
    start: Callable[[list[str]], Any]  # loads SUMO for the first time, with a command
    program: str  # the first word of this command
    options: Mapping[str, str]  # that a user's own may replace
    errors: tuple[type[Exception], ...]  # that the module raises
    gone: tuple[type[Exception], ...] = ()  # errors that say that the user has ended SUMO


LIBSUMO = Engine(libsumo, libsumo.start, "sumo", {}, (libsumo.TraCIException, libsumo.FatalTraCIError))


def window() -> Engine:
    """SUMO's own window, by the extra ``[gui]``; `user_options.check_live` says whether it is there."""
    import sumo
    import traci

    def start(command: list[str]) -> None:
        """As ``traci.start``, which begins again for minutes where there is no display."""
        port = getFreeSocketPort()
        process = subprocess.Popen([*command, f"--remote-port={port}"])
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # it tells every attempt
                traci.connect(port, 6000, proc=process, waitBetweenRetries=0.1, label="default")
        except (traci.TraCIException, traci.FatalTraCIError):
            process.kill()
            raise SimulatorError(
                "sumo-gui has opened no window; what it says is above. It needs a display (the variable DISPLAY)"
            ) from None
        traci.switch("default")

    # a simulated second takes 1000 ms
    options = {"start": "true", "quit-on-end": "true", "window-size": "1000,700", "delay": "1000"}
    program, gone = Path(sumo.SUMO_HOME) / "bin" / "sumo-gui", (traci.FatalTraCIError, OSError)
    return Engine(traci, start, str(program), options, (traci.TraCIException,), gone)


def version() -> str:
    """SUMO's version, such as ``SUMO 1.28.0``."""
    return str(libsumo.getVersion()[1])
