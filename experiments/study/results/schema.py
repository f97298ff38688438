"""What stored results are: the columns of test episodes as one Arrow schema, and whose they are.

`check_record` and `check_table` are asked when something is written and again when it is read, so that what is stored
can be read.
"""

from collections import Counter
from collections.abc import Collection, Mapping
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from experiments.study.design.arms import gate_traffics
from experiments.study.design.cell import RESULT_SCHEMA, cell_name, test_of
from experiments.study.design.levels import tasks_known

# What a cell leaves behind, as its record calls it under "files".
EPISODES, GATES, TRAINING, WEIGHTS = "episodes.parquet", "gates.parquet", "training.parquet", "weights.npz"
PURPOSES = {EPISODES: "test", GATES: "gate"}
ACTIONS = 5
# Columns of a test episode, with their types; without a crash those that begin with crash_ are missing.
COLUMNS: dict[str, str] = {
    "traffic": "str",  # "regular", "risky", or another of `traffic.ALL`
    "scenario": "int64",  # number of the scenario, the same seed in both traffics
    "return": "float64",  # undiscounted sum of rewards
    "length": "int64",  # policy steps
    "crashed": "bool",
    "arrived": "bool",
    "truncated": "bool",  # the time limit ended it
    "mean_speed": "float64",  # [m/s], mean over the steps
    "distance": "float64",  # [m]
    "min_ttc": "float64",  # [s] smallest time-to-collision, inf if there was none
    "near_misses": "int64",  # steps with a time-to-collision below 1.5 s and no crash
    "density": "float64",  # other vehicles within 200 m, mean over the steps
    "stopped": "float64",  # share of the steps with less than 1 m/s
    **{f"action_{number}": "int64" for number in range(ACTIONS)},  # how often each action was chosen
    "crash_time": "float64",  # [s] since the start
    "crash_other": "str",
    "crash_x": "float64",  # [m] the ego's centre
    "crash_y": "float64",
    "crash_relative_x": "float64",  # [m] the other's centre in the ego's frame
    "crash_relative_y": "float64",
    "crash_relative_heading": "float64",  # [rad]
    "crash_closing_speed": "float64",  # [m/s]
    "crash_type": "str",
    "crash_detected_by": "str",  # "sumo", "geometry", "both" or "highway-env"
    "actions": "str",  # the actions one after the other, a digit each
}
OF_CRASH = tuple(name for name in COLUMNS if name.startswith("crash_"))
FINITE = tuple(
    name for name, kind in COLUMNS.items() if kind == "float64" and name not in (*OF_CRASH, "min_ttc")
)


def schema_of(columns: Mapping[str, str], missing: Collection[str] = ()) -> pa.Schema:
    """The schema of columns by name and type ("str", or as numpy calls it); missing: those that may lack values."""
    return pa.schema(
        pa.field(name, pa.string() if kind == "str" else pa.from_numpy_dtype(np.dtype(kind)), name in missing)
        for name, kind in columns.items()
    )


# A row a test episode: whose, what for ("test", or "gate" for what an agent is judged on before), and COLUMNS.
SCHEMA = schema_of({"cell": "str", "purpose": "str", **COLUMNS}, OF_CRASH)


class OtherVersion(ValueError):
    """A file that is whole, and that this version, or without a task of the user's own, does not read."""


def check_record(name: str, record: Any) -> None:
    """That this is the record of the cell of this name, the hash of its key. Raises ValueError, or KeyError."""
    if (schema := record["schema"]) != RESULT_SCHEMA:
        raise OtherVersion(
            f"was written by version {schema} of such files, and this is {RESULT_SCHEMA}: results/FROZEN.md names the "
            "commits that read published ones"
        )
    if (task := record["key"]["task"]) not in tasks_known():
        raise OtherVersion(f"is of the task {task!r}, which is not here: name its file, --tasks FILE:TASK")
    if (own := cell_name(record["key"], record["versions"])) != name:
        raise ValueError(f"its content is that of {own}")


def table_of(name: str, tables: Mapping[str, pd.DataFrame]) -> pa.Table:
    """The test episodes of a cell, and those that its gates are judged on, as rows of SCHEMA. Raises ValueError."""
    return pa.concat_tables(
        as_table(tables[file].assign(cell=name, purpose=purpose), SCHEMA)
        for file, purpose in PURPOSES.items()
        if file in tables
    )


def as_table(rows: pd.DataFrame, schema: pa.Schema | None) -> pa.Table:
    """Rows with the columns of a schema. Raises ValueError where one is not there, of another type, or lacks values."""
    try:
        return pa.Table.from_pandas(rows, schema=schema, preserve_index=False)
    except (ValueError, KeyError, TypeError) as error:  # pyarrow's are among them
        raise ValueError(str(error).partition("\n")[0]) from None


def check_table(table: pa.Table, records: Mapping[str, Mapping[str, Any]]) -> dict[Any, pd.DataFrame]:
    """By cell and purpose the rows of a table of SCHEMA: the episodes of these records' cells, or ValueError."""
    rows = table.to_pandas()
    for column in FINITE:
        if not np.isfinite(rows[column]).all():
            raise ValueError(f"{column} is not always a finite number")
    found = dict(list(rows.groupby(["cell", "purpose"], sort=False)))
    odd = dict(found)
    for name, record in records.items():
        for file, purpose in PURPOSES.items():
            if file in record["files"]:
                check_rows(record["key"], file, odd.pop((name, purpose), rows.iloc[:0]))
    if odd:
        raise ValueError(f"it has rows of {next(iter(odd))}, without a record")
    return found


def check_rows(key: Mapping[str, Any], file: str, rows: pd.DataFrame) -> None:
    """That a cell has each of its scenarios once, in each of its traffics. Raises ValueError, with the scenario."""
    if file == EPISODES:
        asked = {**key["eval"], **test_of(key)}
    else:
        asked = {"traffics": gate_traffics(key["arm"]), "episodes": key["eval"]["gate_episodes"]}
    first = key["eval"]["first_scenario"]
    numbers = range(first, first + asked["episodes"])  # of a record, which may ask for any number
    wanted = ((traffic, number) for traffic in asked["traffics"] for number in numbers)
    there = Counter(zip(rows["traffic"].tolist(), rows["scenario"].tolist(), strict=True))
    for traffic, number in chain((row for row in wanted if there.pop(row, 0) != 1), there):
        raise ValueError(
            f"{file} has {len(rows)} rows, and its record asks for {len(asked['traffics']) * len(numbers)}: look at "
            f"scenario {number} in {traffic} traffic"
        )
