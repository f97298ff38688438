"""One thread for numpy's matrix products: the bits of a product depend on how many share it."""

from __future__ import annotations

import ctypes
from functools import cache
from importlib import import_module


@cache
def one_thread() -> None:
    """Let the OpenBLAS that numpy brings along use one thread from now on; another BLAS is left as it is."""
    # The part of numpy that is linked with it: names are looked up in what a library depends on, too.
    library = ctypes.CDLL(import_module("numpy._core._multiarray_umath").__file__)
    for name in ("scipy_openblas_set_num_threads64_", "openblas_set_num_threads"):
        if hasattr(library, name):
            getattr(library, name)(1)
            return
