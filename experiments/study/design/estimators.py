"""Where the estimators of the dose of risk lie, and which of them a cell means."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agents.plugins import sha256

if TYPE_CHECKING:
    from experiments.study.design.cell import Cell

FOLDER = Path(__file__).resolve().parents[3] / "results" / "estimators"


def digest(cell: Cell) -> str:
    """SHA-256 of the estimator of a cell's task and level. Raises ValueError where there is none."""
    if not (found := known_digest(cell)):
        name = f"{cell.task}-{cell.level_name}"
        file = FOLDER / f"{name}.npz"
        raise ValueError(f"two agents need an estimator {file}: python experiments/estimators.py {name}")
    return found


def known_digest(cell: Cell) -> str:
    """SHA-256 of the estimator of a cell's task and level; empty where there is none yet."""
    file = FOLDER / f"{cell.task}-{cell.level_name}.npz"
    return sha256(file) if file.exists() else ""


def file_of(wanted: str) -> Path:
    """The file with this SHA-256. Raises ValueError where there is none."""
    for path in sorted(FOLDER.glob("*.npz")):
        if sha256(path) == wanted:
            return path
    raise ValueError(
        f"no estimator in {FOLDER} has the SHA-256 {wanted}: take the one that the cell was named with"
    )
