"""What is stored is checked where it is read: right checksums do not make wrong contents right."""

import io
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from experiments.study.design.cell import cell_name
from experiments.study.results import parquet
from experiments.study.results.loaded import load
from experiments.study.results.schema import SCHEMA, as_table
from experiments.study.results.store import Store


def rewritten(
    path: Path, of_record: Callable[[dict[str, Any]], object], of_rows: Callable[[pd.DataFrame], pd.DataFrame]
) -> str:
    """Change a stored cell as somebody else could, with its right checksum and name; returns the name."""
    [record], rows = parquet.records(path).values(), parquet.unpacked(path, SCHEMA)[0].to_pandas()
    record = json.loads(json.dumps(record))
    of_record(record)
    rows = of_rows(rows)
    try:
        name = cell_name(record["key"], record["versions"])
    except Exception:  # it has none
        name = path.stem
    if "cell" in rows:
        rows["cell"] = name
    text, data = json.dumps({name: record}), io.BytesIO()
    try:
        table = as_table(rows, SCHEMA if rows.shape[1] == len(SCHEMA) else None)
    except ValueError:
        table = as_table(rows, None)
    with pq.ParquetWriter(data, table.schema, store_schema=False) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({"records": text, "sha256": parquet.digest(table, text)})
    path.unlink()
    (path.parent / f"{name.replace('/', '')}.parquet").write_bytes(data.getvalue())
    return name.replace("/", "")


RECORDS: list[tuple[Callable[[dict[str, Any]], object], str]] = [
    (lambda r: r["key"].update(task="rush"), "is of the task 'rush'"),
    (lambda r: r["key"].pop("eval"), "eval"),
    (lambda r: r.update(schema=99), "was written by version 99"),
    (lambda r: r["files"].pop("gates.parquet"), "without a record"),
]
ROWS: list[tuple[Callable[[pd.DataFrame], pd.DataFrame], str]] = [
    (lambda t: t.drop(columns="crashed"), "has other columns"),
    (lambda t: t.assign(more=1), "has other columns"),
    (lambda t: t.assign(scenario="first"), "has other columns"),
    (lambda t: t.assign(**{"return": np.inf}), "finite"),
    (lambda t: t.assign(near_misses=None), "has other columns"),
    (lambda t: t.iloc[:0], "0 rows"),
    (lambda t: t[t["scenario"] % 2 == 0], "scenario 1"),
    (lambda t: pd.concat([t, t]), "scenario 0"),
    (lambda t: pd.concat([t, t.assign(scenario=t["scenario"] + 50)]), "scenario 50"),
    (lambda t: t.assign(traffic="storm"), "scenario 0"),
]


@pytest.mark.parametrize(("of_record", "of_rows", "said"), [
    *((change, lambda rows: rows, said) for change, said in RECORDS),
    *((lambda record: None, change, said) for change, said in ROWS),
])  # fmt: skip
def test_wrong_contents_are_named(of_record: Any, of_rows: Any, said: str, results: Path) -> None:
    name = min(Store(results).agents())
    other = rewritten(results / "cells" / f"{name}.parquet", of_record, of_rows)
    found = load(results)
    assert re.search(rf"parquet (is damaged \(.*)?{re.escape(said)}", found.damaged[other])
    assert other not in found.cells
