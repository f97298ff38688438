"""One thread a process: processes do the parallel work, and sums must not depend on the number of cores."""

from __future__ import annotations

import os

VARIABLES = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)


def limit_threads() -> None:
    """Tell every numerical library to use one thread; call it before any of them is imported."""
    for name in VARIABLES:
        os.environ[name] = "1"
