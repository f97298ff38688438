"""SUMO as a module: libsumo, or traci, which talks with SUMO's own window. No other module imports either.

libsumo supports one simulation per process; so does this package's use of traci.
"""

from __future__ import annotations

import contextlib
import io
from importlib.util import find_spec
from typing import Any, NamedTuple

try:
    # without its warning about versions of pyarrow, which SUMO needs for Parquet output alone
    with contextlib.redirect_stdout(io.StringIO()):
        import libsumo
except ImportError as error:
    reason = (
        "SUMO is here, but this system cannot load it. It needs about 1 GB of address space (ulimit -v), and on Linux "
        "libraries that slim containers lack: apt-get install libx11-6 libxext6 libxrender1 libgl1"
        if find_spec("libsumo")
        else "SUMO is missing. Install it with 'pip install libsumo==1.28.0' (the wheel brings SUMO along; no "
        "system-wide SUMO is needed)"
    )
    raise ImportError(f"{reason}. Python says: {error}") from error


class Engine(NamedTuple):
    """What a `Session` drives.

    Attributes:
        module: libsumo, or traci, which has the same functions.
        program: that the module starts, with options that every load needs.
        errors: what the module raises.
    """

    module: Any
    program: tuple[str, ...]
    errors: tuple[type[Exception], ...]


LIBSUMO = Engine(libsumo, ("sumo",), (libsumo.TraCIException, libsumo.FatalTraCIError))


def version() -> str:
    """SUMO's version, such as ``SUMO 1.28.0``."""
    return str(libsumo.getVersion()[1])
