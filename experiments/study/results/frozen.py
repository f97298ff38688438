"""Result folders of earlier versions, which are published and stay as they are.

cells.parquet has the name and the record of each cell, episodes.parquet and gates.parquet the rows of all cells behind
a column `cell`, weights/ the weights that are kept. The cells have no `actions` before there were some.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import pandas as pd

from agents.schema import Wrong, parsed
from experiments.support.errors import UserError
from experiments.support.files import opened

CELLS = "cells.parquet"


def records(directory: Path) -> dict[str, dict[str, Any]]:
    """The record of each cell by name; none where the folder is of this version. Raises UserError."""
    return _records(directory / CELLS) if (directory / CELLS).exists() else {}


def tables(directory: Path, file: str) -> dict[str, pd.DataFrame]:
    """The tables of this name by cell. Raises UserError."""
    return _tables(directory / file) if (directory / file).exists() else {}


@lru_cache(16)
def _records(path: Path) -> dict[str, dict[str, Any]]:
    index = _read(path)
    return {name: parsed(text) for name, text in zip(index["cell"], index["record"], strict=True)}


@lru_cache(8)
def _tables(path: Path) -> dict[str, pd.DataFrame]:
    return {
        str(name): rows.drop(columns="cell").reset_index(drop=True)
        for name, rows in _read(path).groupby("cell", sort=False)
    }


def _read(path: Path) -> pd.DataFrame:
    try:
        return read_table(path)
    except Wrong as error:
        raise UserError(
            f"{path} is damaged ({error}): restore it from a copy (git checkout {path})"
        ) from None


def read_table(path: Path) -> pd.DataFrame:
    """A parquet file. Raises Wrong, whatever pyarrow stumbles over; FileNotFoundError."""
    try:
        with opened(path) as file:
            return pd.read_parquet(file)
    except FileNotFoundError:
        raise
    except Exception as error:
        raise Wrong(f"it is no table: {str(error).partition(chr(10))[0]}") from None
