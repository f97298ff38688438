"""Result folders of earlier versions, which are published and stay as they are.

cells.parquet has the name and the record of each cell, episodes.parquet and gates.parquet the rows of all cells behind
a column `cell`, weights/ the weights that are kept. The cells have no `actions` before there were some.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import pandas as pd

from agents.schema import Wrong
from experiments.study.results.parquet import frame
from experiments.study.results.schema import PURPOSES
from experiments.support.files import is_name

CELLS = "cells.parquet"


@lru_cache(16)
def records(path: Path) -> dict[str, dict[str, Any]]:
    """The record of each cell by name, from the CELLS of a folder. Raises Wrong, or as pandas does."""
    index = frame(path)
    if not all(map(is_name, index["cell"])):
        raise Wrong("the name of a cell leads elsewhere")
    return {name: json.loads(text) for name, text in zip(index["cell"], index["record"], strict=True)}


@lru_cache(4)
def frames(path: Path) -> dict[str, dict[str, pd.DataFrame]]:
    """The tables of each cell by name, from the folder of these CELLS. Raises Wrong, or as pandas does."""
    found: dict[str, dict[str, pd.DataFrame]] = {}
    for file in PURPOSES:
        if path.with_name(file).exists():
            for name, rows in frame(path.with_name(file)).groupby("cell", sort=False):
                found.setdefault(str(name), {})[file] = rows.drop(columns="cell").reset_index(drop=True)
    return found
