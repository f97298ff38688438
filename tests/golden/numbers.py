"""The numbers of the published folders apart from words: effects, means, slopes, gates, claims, further arms.

    python tests/golden/regenerate.py numbers     # numbers.parquet, a minute

One row is one number: folder, table, key (what it is of, by "|") and name. Restructuring leaves them as they are to
1e-9 relative; a correction of the analysis changes them in the commit that announces it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.analysis.analysis import Analysis, analyse
from experiments.analysis.scores import CRASH_KINDS
from experiments.study.arms import ALL_TRAFFICS, ARMS, DOSE_ARMS, DOSES, EXTRA_ARMS, TRAFFICS
from experiments.study.store import load
from sumo_env.tasks import TASKS

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


def numbers(analysis: Analysis) -> Iterator[Number]:
    """All numbers of an analysis that a page, a figure or a claim uses."""
    effects, means = analysis.effects, analysis.means
    main = (
        (effects["arm"] == "treatment") & (effects["against"] == "control") & (effects["scenarios"] == "own")
    )
    planned = effects[main & effects["outcome"].isin(OUTCOMES)]
    tested = {(r.outcome, r.term) for r in planned.itertuples() if r.family}
    for row in _records(planned):
        names = [*ESTIMATE, "se", *MEANS]
        names += ["p_adjusted"] if (row["outcome"], row["term"]) in tested else []
        if row["outcome"] == "crashed" and row["term"] == "regular":
            names += ["equivalence_p_adjusted"]
        yield from _named("effect", row, (*WHERE, "outcome", "term"), names)
    own = (means["arm"] == "treatment") & (means["against"] == "control") & (means["scenarios"] == "own")
    scopes = means["scope"].isin([*TASKS, "all tasks"])
    for row in _records(means[own & scopes & means["outcome"].isin(OUTCOMES)]):
        yield from _named("mean", row, ("backend", "scope", "outcome", "term"), ESTIMATE)
    variants = own & ~scopes & (means["outcome"] == "crashed") & (means["term"] == "risky")
    for row in _records(means[variants]):
        yield from _named("variant", {**row, "variant": row["scope"]}, ("backend", "variant"), ESTIMATE)
    for row in _records(means[own & means["outcome"].isin(CRASH_KINDS) & scopes]):
        where = ("backend", "scope", "kind", "term")
        yield from _named("crash kind", {**row, "kind": row["outcome"]}, where, (*ESTIMATE, *MEANS))
    for row in analysis.slopes.to_dict("records"):
        yield from _named("slope", row, ("backend", "task", "outcome", "quantity"), (*ESTIMATE, "p_adjusted"))
    for row in analysis.gates[analysis.gates["arm"].isin(ARMS)].to_dict("records"):
        key = "|".join(map(str, [row[k] for k in (*WHERE, "arm", "seed")]))
        yield "gate", key, f"passed {row['failed']}", _flag(row["passed"])
    for row in analysis.claims.to_dict("records"):
        outcome = "primary" if row["name"] == "fewer crashes" else row["outcome"]
        quantity = "equivalence" if row["quantity"] == "equivalent" else row["quantity"]
        key = "|".join([row["backend"], outcome, quantity])
        yield "claim", key, "verdict", VERDICTS[row["verdict"]]
        for name in ("right", "wrong", "open", "expected"):
            yield "claim", key, name, float(row[name])
    yield from _further(effects, means)
    yield from _doses(analysis.policies)
    rows = analysis.policies[analysis.policies["arm"].isin(["", *ARMS])]
    for row in rows[rows["traffic"].isin(TRAFFICS)].to_dict("records"):
        key = "|".join(str(row[k] or None) for k in (*WHERE, "policy", "arm", "traffic"))
        for name in ("crashed", "return", "mean_speed", "near_misses", "distance"):
            yield "policy", key, name, row[name]
    for row in analysis.placebo.to_dict("records"):
        key = f"{row['backend']}|{row['outcome']}"
        yield "placebo", key, "comparisons", float(row["comparisons"])
        yield "placebo", key, "rejected", float(row["rejected"])
        if row["outcome"] == "crashed":
            yield "placebo", key, "estimate", row["estimate"]


def _records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows by the names of the fixture."""
    names = {"mean_arm": "mean_treatment", "mean_against": "mean_control"}
    names["equivalent_p_adjusted"] = "equivalence_p_adjusted"
    return frame.rename(columns=names).to_dict("records")


def _further(effects: pd.DataFrame, means: pd.DataFrame) -> Iterator[Number]:
    """Further arms and transfer, by setting and over all tasks."""
    single = effects.assign(scope=effects["task"] + " " + effects["level_name"])
    both = pd.concat([single, means[(means["scope"] == "all tasks")]])
    fixed = (both["against"] == "control") | ((both["arm"] == "dense") & (both["against"] == "treatment"))
    shown = both["outcome"].isin(["crashed", "return"])
    for row in _records(both[both["arm"].isin(EXTRA_ARMS) & fixed & shown]):
        key = ("backend", "arm", "against", "scope", "outcome", "term")
        yield from _named("arm", row, key, (*ESTIMATE, *MEANS))
    for row in _records(both[both["scenarios"] != "own"]):
        away = row["tested_on"] == row["scenarios"]
        row["tested_on"] = row["scenarios"]
        where = ("backend", "tested_on", "scope", "term")
        yield from _named("transfer" if away else "at home", row, where, (*ESTIMATE, *MEANS))


def _doses(policies: pd.DataFrame) -> Iterator[Number]:
    """Crash rates by the dose of the training and of the test."""
    trained = policies[policies["arm"].isin(DOSE_ARMS)]
    for _, rows in trained.groupby(["backend", "task", "level"], sort=False):
        if rows["arm"].nunique() < 3:
            continue
        for row in rows.to_dict("records"):
            doses = [str(DOSES[row["arm"]]), str(ALL_TRAFFICS[row["traffic"]])]
            yield "dose", "|".join([str(row[k]) for k in WHERE] + doses), "rate", row["crashed"]


KEPT = ("agents that pass the gates", "settings that were learnt", "every setting alike")


def _named(table: str, row: Mapping[str, Any], key: Sequence[str], names: Sequence[str]) -> Iterator[Number]:
    where = "|".join(str(row[k]) for k in key)
    for name in names:
        yield table, where, name, row.get(name)


def _flag(value: bool | None) -> float | None:
    return None if value is None else float(value)


def table(rows: Iterable[Number], folder: str) -> pd.DataFrame:
    """The numbers of one folder."""
    frame = pd.DataFrame(rows, columns=["table", "key", "name", "value"]).astype({"value": float})
    assert not frame.duplicated(["table", "key", "name"]).any()
    return frame.assign(value=[float(f"{x:.{DIGITS}g}") for x in frame["value"]]).assign(folder=folder)


def write() -> None:
    """Write the fixture anew."""
    tables = [table(numbers(analyse(load(ROOT / "results" / folder))), folder) for folder in FOLDERS]
    order = ["folder", "table", "key", "name"]
    pd.concat(tables, ignore_index=True).sort_values(order)[[*order, "value"]].to_parquet(
        FILE, index=False, compression="zstd"
    )


def differences(now: pd.DataFrame, relative: float = 1e-9) -> list[str]:
    """What the numbers of a folder are otherwise now, a line each."""
    folder = now["folder"].iloc[0]
    index = ["table", "key", "name"]
    stored = pd.read_parquet(FILE)
    stored = stored[stored["folder"] == folder]
    then = stored.set_index(index)["value"]
    now = now.set_index(index)["value"]
    lines = [f"{row} is no longer there" for row in then.index.difference(now.index)]
    lines += [f"{row} is new" for row in now.index.difference(then.index)]
    both = then.index.intersection(now.index)
    old, new = then.loc[both], now.loc[both]
    # Differences that are 0 in truth are rounding errors of the rates that they are of.
    same = ((old - new).abs() <= relative * old.abs() + 1e-12) | (old.isna() & new.isna())
    return lines + [f"{row}: {old[row]:.12g} was, {new[row]:.12g} is" for row in both[~same.to_numpy()]]
