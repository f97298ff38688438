"""The numbers of the published folders apart from words: effects, means, slopes, gates, claims, policies, placebo.

    python tests/golden/regenerate.py numbers     # numbers.parquet, a minute

One row is one number: folder, table, key (what it is of, by "|") and name. Restructuring leaves them as they are to
1e-9 relative; a correction of the analysis changes them in the commit that announces it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from experiments.analysis.analysis import Analysis, analyse
from experiments.study.results.store import load

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results"
FOLDERS = (
    "standard",
    "replica",
    "paper",
    "paper-v0",
    "linear",
)  # in numbers.parquet; the second study still grows
PUBLISHED = (*FOLDERS, "second", "first-clock", "crash-reward", "pairs")
FILE = Path(__file__).with_name("numbers.parquet")
DIGITS = 12
EFFECT = ["backend", "tested_on", "scenarios", "arm", "against", "outcome", "term"]
ESTIMATE = ["estimate", "low", "high", "p"]
MEANS = ["mean_arm", "mean_against"]
# The frames of an analysis: what a row is of, and its numbers that a page, a figure or a claim uses.
TABLES = {
    "effects": (
        [*EFFECT, "task", "level"], [*ESTIMATE, "se", *MEANS, "p_adjusted"]
    ),
    "means": ([*EFFECT, "scope"], [*ESTIMATE, *MEANS]),
    "slopes": (["backend", "task", "outcome", "quantity"], [*ESTIMATE, "p_adjusted"]),
    "gates": (["backend", "task", "level", "arm", "seed", "failed"], ["passed"]),
    "claims": (["backend", "name", "verdict"], ["right", "wrong", "open", "expected"]),
    "policies": (
        ["backend", "task", "level", "policy", "arm", "traffic"],
        ["crashed", "return", "mean_speed", "near_misses", "distance"],
    ),
    "placebo": (["backend", "outcome"], ["comparisons", "rejected", "estimate"]),
}  # fmt: skip


def numbers(analysis: Analysis, folder: str) -> pd.DataFrame:
    """The numbers of the analysis of one folder, a row each."""
    tables = []
    for table, (key, names) in TABLES.items():
        frame = getattr(analysis, table)
        values = frame[names].astype(float).set_axis(frame[key].astype(str).agg("|".join, axis=1))
        tables.append(values.rename_axis("key").melt(var_name="name", ignore_index=False).assign(table=table))
    found = pd.concat(tables).reset_index().assign(folder=folder)
    assert not found.duplicated(["table", "key", "name"]).any()
    return found.assign(value=[float(f"{x:.{DIGITS}g}") for x in found["value"]])


def write() -> None:
    """Write the fixture anew."""
    found = pd.concat(numbers(analyse(load(ROOT / "results" / folder)), folder) for folder in FOLDERS)
    order = ["folder", "table", "key", "name"]
    found.sort_values(order)[[*order, "value"]].to_parquet(FILE, index=False, compression="zstd")


def golden(folder: str) -> pd.DataFrame:
    """The stored numbers of one folder."""
    return pd.read_parquet(FILE).query("folder == @folder")


def differences(then: pd.DataFrame, now: pd.DataFrame, relative: float = 1e-9) -> pd.DataFrame:
    """The numbers of a folder that are otherwise now; -1e99 where there is none."""
    index = ["folder", "table", "key", "name"]
    golden, new = (values.set_index(index)["value"] for values in (then, now))
    every = golden.index.union(new.index)
    golden, new = (values.reindex(every, fill_value=-1e99) for values in (golden, new))
    # Differences that are 0 in truth are rounding errors of the rates that they are of.
    same = np.isclose(new, golden, rtol=relative, atol=1e-12, equal_nan=True)
    return pd.DataFrame({"golden": golden, "now": new})[~same]
