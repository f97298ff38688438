"""Where the estimators of the dose of risk lie, and which of them a cell means."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agents.plugins import sha256

if TYPE_CHECKING:
    from experiments.study.design.grid import Cell

FOLDER = Path(__file__).resolve().parents[3] / "results" / "estimators"


def digest(cell: Cell) -> str:
    """SHA-256 of the estimator of a cell's task and level. Raises ValueError where there is none."""
    name = f"{cell.task}-{cell.level_name}"
    if not (file := FOLDER / f"{name}.npz").exists():
        raise ValueError(f"two agents need an estimator {file}: python experiments/estimators.py {name}")
    return sha256(file)


def file_of(wanted: str) -> Path:
    """The file with this SHA-256. Raises ValueError where there is none."""
    for path in sorted(FOLDER.glob("*.npz")):
        if sha256(path) == wanted:
            return path
    raise ValueError(
        f"no estimator in {FOLDER} has the SHA-256 {wanted}: take the one that the cell was named with"
    )
