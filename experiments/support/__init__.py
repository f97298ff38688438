"""What every command needs, whatever it measures."""

import os

VARIABLES = [f"{library}_NUM_THREADS" for library in ("OMP", "MKL", "OPENBLAS", "NUMEXPR", "NUMBA")]


def limit_threads() -> None:
    """Tell every numerical library to use one thread; call it before any of them is imported."""
    for name in VARIABLES:
        os.environ[name] = "1"
