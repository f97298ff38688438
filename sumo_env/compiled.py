"""How the numerical kernels of this package are compiled: once for a machine, at their first call.

The machine code is kept beside the sources or, where an installation is read-only, in the user's cache
directory. A kernel that calls a kernel of *another* module is not compiled anew when only that other module
changes: after editing one of them remove the caches (``__pycache__/*.nbi``), as `make test` does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile `function` with numba at its first call; to a type checker it stays what it was.

    Integers and floats are different types: an argument documented as float must be passed as a float,
    otherwise the function is compiled a second time.
    """
    try:
        return njit(cache=True)(function)
    except RuntimeError as error:
        if "no locator available" not in str(error):
            raise
        return njit(function)  # neither the package nor a home directory is writable: compile in each process
