"""Where the estimators of the dose of risk lie, and which of them a cell means."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from agents.plugins import sha256
from experiments.support.errors import UserError

if TYPE_CHECKING:
    from experiments.study.design.cell import Cell

FOLDER = Path(__file__).resolve().parents[3] / "results" / "estimators"


def digest(setting: str) -> str:
    """SHA-256 of the estimator of a setting, such as "u-turn-3"; empty where there is none yet."""
    file = FOLDER / f"{setting}.npz"
    return sha256(file) if file.exists() else ""


def to_train(cells: Iterable[Cell]) -> str:
    """The command that trains the estimators that cells mean and that are not there; empty if all are."""
    missing = [cell for cell in cells if (cell.pair or {}).get("estimator_sha256") == ""]
    names = dict.fromkeys(f"{cell.task}-{cell.level_name}" for cell in missing)
    return f"python experiments/estimators.py {' '.join(names)}" if names else ""


def check_there(cells: Iterable[Cell]) -> None:
    """Raise UserError where an estimator has to be trained first."""
    if command := to_train(cells):
        raise UserError(f"two agents together need estimators that are not there: {command}")


def file_of(wanted: str) -> Path:
    """The file with this SHA-256. Raises ValueError where there is none."""
    for path in sorted(FOLDER.glob("*.npz")):
        if sha256(path) == wanted:
            return path
    raise ValueError(
        f"no estimator in {FOLDER} has the SHA-256 {wanted}: take the one that the cell was named with"
    )
