"""One thread a process: processes do the parallel work, and sums must not depend on the number of cores."""

from __future__ import annotations

import os
from pathlib import Path

VARIABLES = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)
KERNELS = "OPENBLAS_CORETYPE"  # the variable that names the kernels of OpenBLAS


def limit_threads() -> None:
    """Tell every numerical library to use one thread; call it before any of them is imported.

    And let numpy's OpenBLAS use the quickest kernels, unless the user's environment names others.
    """
    for name in VARIABLES:
        os.environ[name] = "1"
    if (kernels := quickest_kernels()) is not None:
        os.environ.setdefault(KERNELS, kernels)


def quickest_kernels() -> str | None:
    """OpenBLAS's kernels for AVX-512 where the processor has it, None for what OpenBLAS chooses by itself.

    That is AVX-512 as well on Intel's processors and those of AMD's that it knows by name, and products take
    1.6 times as long without.
    """
    return "SkylakeX" if _has_avx512() else None


def _has_avx512() -> bool:
    """Whether Linux says that the processor has all of AVX-512 that OpenBLAS's kernels for Skylake-X use."""
    try:
        information = Path("/proc/cpuinfo").read_text()
    except OSError:
        return False
    flags = next((line for line in information.splitlines() if line.startswith("flags")), "").split()
    return {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"} <= set(flags)
