"""How the kernels of this package are compiled: once for a machine, at their first call.

Numba keeps the machine code in ``__pycache__`` beside the sources or, where that is read-only, in the user's cache
directory (or in ``NUMBA_CACHE_DIR``). It compiles a function again when the function's own file has changed, but not
when a function of another file that it calls has; therefore machine code that is older than the newest file of what
kernels use is dropped before it is loaded.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from sumo_env.contacts import rectangles
from sumo_env.spaces import approach
from sumo_env.tasks import base

try:
    import numba
    from numba.extending import register_jitable
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "the environments replica/* are compiled with numba, which is not installed: "
        "pip install numba (or, in a clone of this project, pip install '.[replica]')",
        name=error.name,
    ) from None

AS_PYTHON = bool(numba.config.DISABLE_JIT)  # type: ignore[attr-defined]  # see `numpy_loops`
Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile `function` with numba at its first call; to a type checker it stays what it was.

    Other threads of Python run during a call.
    """
    return _compiled(function, counts=True)


def inlined(function: Function) -> Function:
    """As `compiled`, for functions that make no arrays and return none.

    Inlined and without reference counting: passing some eighty numbers that describe arrays costs more than physics.
    """
    return _compiled(function, counts=False)


def record_type(fields: list[Any]) -> np.dtype[Any]:
    """A type of records whose fields are attributes where kernels run as Python, as they are in compiled kernels."""
    kind = np.dtype(fields, align=True)
    return np.dtype((np.record, kind)) if AS_PYTHON else kind


def _compiled(function: Function, counts: bool) -> Function:
    if AS_PYTHON:
        return function
    options: dict[str, Any] = {"_nrt": counts, "nogil": counts, "forceinline": not counts}
    try:
        kept = numba.njit(cache=True, **options)(function)
        _drop_stale(kept.stats.cache_path)
        return cast(Function, kept)
    except (RuntimeError, OSError) as error:
        if isinstance(error, RuntimeError) and "no locator available" not in str(error):
            raise
        # no directory is writable, or stale machine code cannot be removed: compile in each process
        return cast(Function, numba.njit(**options)(function))


@cache
def _drop_stale(folder: str) -> None:
    """Remove machine code in a directory of Numba's that is older than the newest source."""
    for index in Path(folder).glob("*.nbi"):
        with suppress(FileNotFoundError):  # another process, which imports this as well, was faster
            if index.stat().st_mtime < _newest:
                index.unlink()


def _is_kept(function: Any) -> bool:
    """Whether machine code of a kernel is on the disk."""
    folder = function.stats.cache_path
    return folder is not None and any(Path(folder).glob(f"*.{function.__name__}-*.nbi"))


@contextmanager
def _alone(folder: str | None) -> Iterator[None]:
    """Hold the lock of a directory of machine code, where there are locks: other processes wait."""
    with ExitStack() as opened:
        with suppress(ImportError, OSError):
            import fcntl  # not on Windows

            if folder is not None:
                file = opened.enter_context(open(Path(folder) / "compiling.lock", "w"))
                fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextmanager
def compile_notice(function: Any) -> Iterator[None]:
    """Say that kernels are compiled, and how long it took, unless the machine code of `function` is on the disk.

    Of several processes one compiles, and the others wait until they can load it.
    """
    if AS_PYTHON or _is_kept(function):
        yield
        return
    with _alone(function.stats.cache_path):
        if _is_kept(function):
            yield
            return
        start = time.perf_counter()
        notice = "sumo_env: Numba compiles highway-env's physics, once for this installation: about half a minute ..."
        print(notice, file=sys.stderr, flush=True)
        yield
        print(f"sumo_env: compiled in {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)


_BENEATH = (
    rectangles.extents,
    rectangles.reach_of,
    rectangles.separation,
    rectangles.corner_distance,
    approach.approach,
    base.lmap,
)
for _function in _BENEATH:  # plain Python, which functions call that kernels call
    register_jitable(_function)

_rooms = [Path(__file__).parents[1] / name for name in ("replica", "tasks", "contacts", "spaces")]
_newest = max(source.stat().st_mtime for room in _rooms for source in room.glob("*.py"))
