"""What every command needs, whatever it measures.

errors      what a user can put right, in one line
files       whole or not at all
provenance  versions, machine, revision
"""

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
