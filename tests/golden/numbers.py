"""The numbers of the published folders apart from words: effects, means, slopes, gates, claims, further arms.

    python tests/golden/regenerate.py numbers     # numbers.parquet, a minute

One row is one number: folder, table, key (what it is of, by "|") and name. Restructuring leaves them as they are to
1e-9 relative; a correction of the analysis changes them in the commit that announces it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.analysis.analysis import analyse
from experiments.study.results import load

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("standard", "replica", "paper", "paper-v0", "linear")
FILE = Path(__file__).with_name("numbers.parquet")
DIGITS = 12
VERDICTS = {"holds": 1.0, "not decided": 0.0, "contradicted": -1.0}
ESTIMATE = ("estimate", "low", "high", "p")
MEANS = ("mean_treatment", "mean_control")
WHERE = ("backend", "task", "level")
OUTCOMES = ("return", "crashed", "crash_free_time", "crashes_per_100_km", "mean_speed", "near_misses")
Number = tuple[str, str, str, float | None]  # table, key, name, value


def numbers(analysis: Mapping[str, Any]) -> Iterator[Number]:
    """All numbers of an analysis that a page, a figure or a claim uses."""
    extra = analysis["exploratory"]
    tested = {(r["outcome"], r["term"]) for r in analysis["ate"] if r["family"]}
    for row in analysis["ate"]:
        names = [*ESTIMATE, "se", *MEANS]
        names += ["p_adjusted"] if (row["outcome"], row["term"]) in tested else []
        names += (
            ["equivalence_p_adjusted"] if row["outcome"] == "crashed" and row["term"] == "regular" else []
        )
        if row["outcome"] in OUTCOMES:
            yield from _named("effect", row, (*WHERE, "outcome", "term"), names)
    for row in analysis["pooled"]:
        if row["outcome"] in OUTCOMES:
            yield from _named("mean", row, ("backend", "scope", "outcome", "term"), ESTIMATE)
    for row in analysis["slopes"]:
        yield from _named("slope", row, ("backend", "task", "outcome", "quantity"), (*ESTIMATE, "p_adjusted"))
    for row in analysis["sensitivity"]:
        if row["variant"] in KEPT or row["variant"].startswith("without "):
            yield from _named("variant", row, ("backend", "variant"), ESTIMATE)
    for row in analysis["gates"]:
        failed = " ".join(row["failed"])
        yield (
            "gate",
            "|".join(map(str, [row[k] for k in (*WHERE, "arm", "seed")])),
            f"passed {failed}",
            _flag(row["passed"]),
        )
    for row in analysis["claims"]:
        key = "|".join([row["backend"], row["outcome"], row["quantity"]])
        yield "claim", key, "verdict", VERDICTS[row["verdict"]]
        for name in ("right", "wrong", "open", "expected"):
            yield "claim", key, name, float(row["counts"][name])
    for row in extra["arms"]:
        yield from _named(
            "arm", row, ("backend", "arm", "against", "scope", "outcome", "term"), (*ESTIMATE, *MEANS)
        )
    for row in extra["transfer"]:
        key = ("backend", "tested_on", "scope", "term")
        yield from _named("transfer", row, key, (*ESTIMATE, *MEANS))
        yield from _named(
            "at home", {**row["at_home"], "tested_on": row["tested_on"]}, key, (*ESTIMATE, *MEANS)
        )
    for row in extra["doses"]:
        yield from _named("dose slope", {**row, **row["slope"]}, WHERE, ESTIMATE)
        for dose, rates in zip(row["doses"], row["rates"], strict=True):
            for test, rate in zip(row["tests"], rates, strict=True):
                yield "dose", "|".join([str(row[k]) for k in WHERE] + [str(dose), str(test)]), "rate", rate
    for row in extra["crash_types"]:
        yield from _named("crash kind", row, ("backend", "scope", "kind", "term"), (*ESTIMATE, *MEANS))
    for row in analysis["policies"]:
        key = "|".join(str(row[k]) for k in (*WHERE, "policy", "arm", "traffic"))
        for name in ("crashed", "return", "mean_speed", "near_misses", "distance"):
            yield "policy", key, name, row["mean"][name]
    for row in analysis["placebo"]:
        key = f"{row['backend']}|{row['outcome']}"
        yield "placebo", key, "comparisons", float(row["comparisons"])
        yield "placebo", key, "rejected", float(row["rejected"])
        if row["primary"]:
            yield "placebo", key, "estimate", row["primary"]["estimate"]


KEPT = ("agents that pass the gates", "settings that were learnt", "every setting alike")


def _named(table: str, row: Mapping[str, Any], key: Sequence[str], names: Sequence[str]) -> Iterator[Number]:
    where = "|".join(str(row[k]) for k in key)
    for name in names:
        yield table, where, name, row.get(name)


def _flag(value: bool | None) -> float | None:
    return None if value is None else float(value)


def table(folder: str) -> pd.DataFrame:
    """The numbers of one folder."""
    rows = list(numbers(analyse(load(ROOT / "results" / folder))))
    frame = pd.DataFrame(rows, columns=["table", "key", "name", "value"]).astype({"value": float})
    assert not frame.duplicated(["table", "key", "name"]).any()
    return frame.assign(value=[float(f"{x:.{DIGITS}g}") for x in frame["value"]]).assign(folder=folder)


def write() -> None:
    """Write the fixture anew."""
    frames = pd.concat([table(folder) for folder in FOLDERS], ignore_index=True)
    order = ["folder", "table", "key", "name"]
    frames.sort_values(order)[[*order, "value"]].to_parquet(FILE, index=False, compression="zstd")


def differences(folder: str, relative: float = 1e-9) -> list[str]:
    """What the analysis of a folder says otherwise now, a line each."""
    index = ["table", "key", "name"]
    stored = pd.read_parquet(FILE)
    then = stored[stored["folder"] == folder].set_index(index)["value"]
    now = table(folder).set_index(index)["value"]
    lines = [f"{row} is no longer there" for row in then.index.difference(now.index)]
    lines += [f"{row} is new" for row in now.index.difference(then.index)]
    both = then.index.intersection(now.index)
    old, new = then.loc[both], now.loc[both]
    # Differences that are 0 in truth are rounding errors of the rates that they are of.
    same = ((old - new).abs() <= relative * old.abs() + 1e-12) | (old.isna() & new.isna())
    return lines + [f"{row}: {old[row]:.12g} was, {new[row]:.12g} is" for row in both[~same.to_numpy()]]
