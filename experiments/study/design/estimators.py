"""Where the estimators of the dose of risk lie, which of them a cell means, and the rule by which a belief acts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agents.plugins import sha256

if TYPE_CHECKING:
    from experiments.study.design.grid import Cell

FOLDER = Path(__file__).resolve().parents[3] / "results" / "estimators"
# Sharpness and threshold, see `agents.belief.sharpened`; chosen by a pilot (docs/earlier-studies.md).
RULE = (3.0, 0.3)


def digest(cell: Cell) -> str:
    """SHA-256 of the estimator of a cell's task and level. Raises ValueError where there is none."""
    return sha256(FOLDER / f"{cell.task}-{cell.level_name}.npz")


def file_of(wanted: str) -> Path:
    """The file with this SHA-256. Raises ValueError where there is none."""
    for path in sorted(FOLDER.glob("*.npz")):
        if sha256(path) == wanted:
            return path
    raise ValueError(
        f"no estimator in {FOLDER} has the SHA-256 {wanted}: take the one that the cell was named with"
    )
