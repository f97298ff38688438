"""Where a result comes from: versions, machine, revision. Stored with every cell, not part of its name."""

import importlib.metadata
import os
import platform
import subprocess
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

PACKAGES = ["sumo-risky-driving", "libsumo", "highway-env", "gymnasium", "numpy"]
PACKAGES += ["numba", "torch", "pandas", "pyarrow"]


@cache
def provenance() -> dict[str, Any]:
    """Versions of Python and the packages, processor, and git revision (None outside a checkout)."""
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": cpu(),
        "cores": os.cpu_count(),
        "git": revision(Path(__file__).resolve().parents[2]),
        "packages": {name: _version(name) for name in PACKAGES},
    }


def cpu() -> str:
    """Name of the processor, with its family and model, since one name may be that of several kinds."""
    with suppress(OSError, KeyError):  # not Linux, or not x86
        lines = Path("/proc/cpuinfo").read_text().partition("\n\n")[0].splitlines()
        said = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
        return f"{said['model name']} (family {said['cpu family']}, model {said['model']})"
    return platform.processor() or platform.machine()


def revision(directory: Path) -> str | None:
    """Commit of a checkout, with "-dirty" for changed tracked files; None without git or a checkout."""
    command = ["git", "-C", str(directory), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout.strip() or None if result.returncode == 0 else None


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
