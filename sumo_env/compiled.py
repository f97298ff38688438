"""How the numerical kernels of this package are compiled: once for a machine, at their first call.

The machine code is kept in ``__pycache__`` beside the sources or, where an installation is read-only, in the
user's cache directory. numba compiles a function anew when its own file has changed, but not when a kernel of
another file that it calls has; so machine code older than the newest file with kernels is dropped at import.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile `function` with numba at its first call; to a type checker it stays what it was.

    Integers and floats are different types: an argument documented as float must be passed as a float,
    otherwise the function is compiled a second time.
    """
    return _compiled(function, counts=True)


def borrowing(function: Function) -> Function:
    """As `compiled`, for functions that make no arrays and return none; one that does is not compiled.

    References to the arrays that such a function is given are not counted there. Counting them takes as long as ten
    operations whenever an array is handed on or a row of it is taken, an eighth of the time of small tasks.
    """
    return _compiled(function, counts=False)


def _compiled(function: Function, counts: bool) -> Function:
    options: dict[str, Any] = {"_nrt": counts}  # else the function has what the first one to call it has
    try:
        return cast(Function, numba.njit(cache=True, **options)(function))
    except RuntimeError as error:
        if "no locator available" not in str(error):
            raise
        return cast(Function, numba.njit(**options)(function))  # no directory is writable: compile in each process


def drop_outdated(package: Path) -> int:
    """Delete the indexes of machine code under `package` older than a file with kernels; returns how many."""
    indexes = [path for path in package.rglob("__pycache__/*.nbi") if os.access(path.parent, os.W_OK)]
    sources = {path.parent.parent / f"{path.name.split('.')[0]}.py" for path in indexes}
    newest = max((source.stat().st_mtime for source in sources if source.exists()), default=0.0)
    outdated = [path for path in indexes if path.stat().st_mtime < newest]
    for path in outdated:
        path.unlink(missing_ok=True)  # another worker may have been quicker
    return len(outdated)


drop_outdated(Path(__file__).parent)
