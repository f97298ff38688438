"""What stored results are: the columns of test episodes as one Arrow schema, and the entries of a cell's record.

`table_of` makes a cell's episodes a table of SCHEMA and `check_table` says whether one can be what this package writes:
both are asked when something is written and again when it is read, so that what is stored can be read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from datetime import datetime
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from agents.schema import Wrong, check, shortened
from experiments.backends import SIMULATORS
from experiments.study.design.arms import EVERY_ARM, NUMBERED, PAIRS, gate_traffics
from experiments.study.design.grid import LEARNER, RESULT_SCHEMA, cell_name
from experiments.study.design.traffic import ALL, TRAFFICS
from experiments.support.files import is_name
from sumo_env.tasks import TASKS

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
ARROW = {"str": pa.string(), "bool": pa.bool_(), "int64": pa.int64(), "float64": pa.float64()}
# A row a test episode: whose, what for ("test", or "gate" for what an agent is judged on before), and COLUMNS.
SCHEMA = pa.schema(
    pa.field(name, ARROW[kind], nullable=name in OF_CRASH)
    for name, kind in {"cell": "str", "purpose": "str", **COLUMNS}.items()
)

CONFIG = {"policy_frequency?": range(1, 1000)}  # of it alone the time of an episode depends
KEY = {
    "kind": ("agent", "baseline", "test"),
    "backend": tuple(SIMULATORS),
    "task": str,  # one of TASKS, which a user may add to
    "policy": str,
    "arm": (None, *EVERY_ARM, *PAIRS),
    "profile": dict,
    "env_config": CONFIG,
    "dynamics": str | None,
    "eval": {"episodes": NUMBERED[1:], "gate_episodes": NUMBERED, "first_scenario?": NUMBERED},
}
TEST = {
    "backend": tuple(SIMULATORS),
    "traffics": [tuple(ALL)],
    "episodes": NUMBERED[1:],
    "env_config": CONFIG,
}
RULE = {"careful_steps?": range(1000), "unsure?": [int | float] * 2, "weighed?": [int | float] * 2}
PAIR = {"agents": [str] * 2, "belief": ("own", "another", "none"), "rule": RULE, "estimator_sha256?": str}
# None: of a part of a training in which no episode has ended
NUMBERS, OR_NONE = [int | float], [int | float | None]
RECORD = {
    "schema": (RESULT_SCHEMA,),
    "key": KEY,
    "versions": dict,
    "files": {EPISODES: str},
    "provenance?": {"packages?": dict},
    "timing?": {"finished?": str, "train_seconds?": int | float, "test_seconds?": int | float},
    "learner?": {"curve?": {"step": NUMBERS, "return": OR_NONE, "crashed": OR_NONE}},
}
OF_AGENT = {"timing": {"finished": str}, "learner": dict}
# Of one that has learnt Q-values.
VALUES = {"episodes": NUMBERED[1:], **dict.fromkeys(("expected", "got", "size"), int | float)}
OF_Q = {
    "learner": {
        "probe_q": [OR_NONE * 3],
        "q_bound": int | float,
        "goals_clipped?": [NUMBERS * 2],
        "values?": VALUES,
    }
}


def check_record(name: str, record: Any) -> None:
    """That this can be the record of the cell of this name. Raises Wrong, which names the entry."""
    check(record, RECORD)
    if not is_name(name):
        raise Wrong("the name of a cell leads elsewhere")
    key = record["key"]
    check(key, {"task": tuple(TASKS)}, "key")
    levels = list(TASKS[key["task"]].levels)
    check(key, {"level_name": tuple(levels)}, "key")
    check(key, {"level": (levels.index(key["level_name"]) + 1,)}, "key")
    if "finished" in (timing := record.get("timing", {})):
        datetime.fromisoformat(timing["finished"])
    is_agent = key["kind"] != "baseline"
    arms = tuple(PAIRS if "pair" in key else EVERY_ARM) if is_agent else (None,)
    check(key, {"arm": arms, "seed": NUMBERED if is_agent else (None,)}, "key")
    if key["kind"] == "test":
        check(key, {"test_on": TEST, "pair?": PAIR}, "key")
    elif "test_on" in key:
        if is_agent:
            raise Wrong("key.test_on is for further tests alone")
        check(key, {"test_on": TEST}, "key")
    if (GATES in record["files"]) != ("test_on" not in key and key["eval"]["gate_episodes"] > 0):
        raise Wrong(f"{GATES} is of the cells that are judged alone")
    if key["kind"] == "agent":
        check(record, OF_AGENT)
    if key["kind"] == "agent" and key["policy"] == LEARNER:
        check(record, OF_Q)
        if not record["learner"]["probe_q"] or record["learner"]["q_bound"] < 0:
            raise Wrong("learner.probe_q is empty, or learner.q_bound below 0")
    if len({len(values) for values in record.get("learner", {}).get("curve", {}).values()}) > 1:
        raise Wrong("learner.curve has columns of several lengths")
    if (own := cell_name(key, record["versions"])) != name:
        raise Wrong(f"its content is that of {own}")


def table_of(name: str, tables: Mapping[str, pd.DataFrame]) -> pa.Table:
    """The test episodes of a cell, and those that its gates are judged on, as rows of SCHEMA. Raises Wrong."""
    parts = []
    for file, purpose in PURPOSES.items():
        if file in tables:
            parts.append(as_table(tables[file].assign(cell=name, purpose=purpose), SCHEMA))
    return pa.concat_tables(parts)


def as_table(rows: pd.DataFrame, schema: pa.Schema | None) -> pa.Table:
    """Rows with the columns of a schema. Raises Wrong where one is not there, of another type, or lacks values."""
    try:
        return pa.Table.from_pandas(rows, schema=schema, preserve_index=False)
    except (ValueError, KeyError, TypeError) as error:  # pyarrow's are among them
        raise Wrong(str(error).partition("\n")[0]) from None


def check_table(table: pa.Table, records: Mapping[str, Mapping[str, Any]]) -> None:
    """That a table of SCHEMA has the episodes of the cells with these records, each once, and no more. Raises Wrong."""
    table.validate(full=True)
    rows = table.to_pandas()
    for column in FINITE:
        _all(np.isfinite(rows[column]), f"{column} is {{}}", rows[column])
    counted = rows[[f"action_{number}" for number in range(ACTIONS)]].sum(axis=1)
    _all(counted == rows["length"], "has {} actions, and its length is another number", counted)
    _all(rows["length"] > 0, "length is {}", rows["length"])
    _all(rows["actions"].str.len() == rows["length"], "actions {} are not one digit a step", rows["actions"])
    for column in OF_CRASH:
        _all(rows[column].notna() == rows["crashed"], f"{column} {{}} does not fit crashed", rows[column])
    found = dict(list(rows.groupby(["cell", "purpose"], sort=False)))
    for name, record in records.items():
        for file, purpose in PURPOSES.items():
            if file in record["files"]:
                check_rows(record["key"], file, found.pop((name, purpose), rows.iloc[:0]))
    if found:
        raise Wrong(f"it has rows of {next(iter(found))}, without a record")


def check_rows(key: Mapping[str, Any], file: str, rows: pd.DataFrame) -> None:
    """That a cell has each of its scenarios once, in each of its traffics. Raises Wrong, with the scenario."""
    if file == EPISODES:
        asked = {"traffics": TRAFFICS, "episodes": key["eval"]["episodes"], **(key.get("test_on") or {})}
    else:
        asked = {"traffics": gate_traffics(key["arm"]), "episodes": key["eval"]["gate_episodes"]}
    first = key["eval"].get("first_scenario", 0)
    numbers = range(first, first + asked["episodes"])  # of a record, which may ask for any number
    wanted = ((traffic, number) for traffic in asked["traffics"] for number in numbers)
    there = Counter(zip(rows["traffic"].tolist(), rows["scenario"].tolist(), strict=True))
    for traffic, number in chain((row for row in wanted if there.pop(row, 0) != 1), there):
        raise Wrong(
            f"{file} has {len(rows)} rows, and its record asks for {len(asked['traffics']) * len(numbers)}: look at "
            f"scenario {number} in {traffic} traffic"
        )


def _all(good: np.ndarray | pd.Series, message: str, values: pd.Series) -> None:
    if not good.all():
        row = int(np.flatnonzero(~np.asarray(good, dtype=bool))[0])
        [value] = values.iloc[row : row + 1].tolist()
        raise Wrong(f"row {row}: {message.format(shortened(value))}")
