"""What stored records and tables look like: said here once, and asked wherever they are read.

Checksums say that nothing has changed since somebody wrote a cell. These checks say that it is what this package
writes: every column with its type and range, every scenario once, every name one that there is.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from itertools import chain
from typing import Any, NamedTuple, get_args

import numpy as np
import pandas as pd
from pandas.api import types

from agents.schema import Wrong, check, shortened
from experiments.backends import SIMULATORS
from experiments.study.design.arms import EVERY_ARM, NUMBERED, PAIRS, gate_traffics
from experiments.study.design.grid import LEARNER, RESULT_SCHEMA, cell_name
from experiments.study.design.traffic import ALL, TRAFFICS
from experiments.support.files import is_name
from sumo_env.contacts.crash import CrashType
from sumo_env.tasks import TASKS

EPISODES, GATES = "episodes.parquet", "gates.parquet"
ACTIONS = 5
COUNT = NUMBERED
CONFIG = {"policy_frequency?": range(1, 1000)}  # of it alone the time of an episode depends
KEY = {
    **{
        "kind": ("agent", "baseline", "test"),
        "backend": tuple(SIMULATORS),
        "task": tuple(TASKS),
        "policy": str,
    },
    **{"arm": (None, *EVERY_ARM, *PAIRS), "profile": dict, "env_config": CONFIG, "dynamics": str | None},
    "eval": {"episodes": COUNT[1:], "gate_episodes": COUNT, "first_scenario?": COUNT},
}
TEST = {"backend": tuple(SIMULATORS), "traffics": [tuple(ALL)], "episodes": COUNT[1:], "env_config": CONFIG}
PAIR = {"agents": [str], "weight": str, "rule?": [int | float], "estimator_sha256?": str}
NUMBERS, OR_NONE = (
    [int | float],
    [int | float | None],
)  # None: of a part of a training in which no episode has ended
RECORD = {
    **{
        "schema": (RESULT_SCHEMA,),
        "key": KEY,
        "versions": dict,
        "files": {EPISODES: str},
        "provenance?": {"packages?": dict},
    },
    "timing?": {"finished?": str, "train_seconds?": int | float, "test_seconds?": int | float},
    "learner?": {"curve?": {"step": NUMBERS, "return": OR_NONE, "crashed": OR_NONE}},
}
OF_AGENT = {"timing": {"finished": str}, "learner": dict}
# Of one that has learnt Q-values.
VALUES = {"episodes": COUNT[1:], **dict.fromkeys(("expected", "got", "size"), int | float)}
OF_Q = {
    "learner": {
        "probe_q": [OR_NONE * 3],
        "q_bound": int | float,
        "goals_clipped?": [NUMBERS * 2],
        "values?": VALUES,
    }
}


class Column(NamedTuple):
    """Of a table: type and range of its values, whether they may be missing, and those that are possible."""

    type: str
    low: float = -math.inf
    high: float = math.inf
    missing: bool = False
    among: tuple[str, ...] = ()


MOST = 1e12  # any quantity of an episode is below
TEXT, TRUTH, COUNTED = Column("str"), Column("bool"), Column("int64", 0)
NUMBER, AMOUNT = Column("float64", -MOST, MOST), Column("float64", 0, MOST)
OF_CRASH, TEXT_OF_CRASH = NUMBER._replace(missing=True), Column("str", missing=True)
# Columns of episodes.parquet, one row a test episode.
COLUMNS = {
    "traffic": TEXT._replace(among=tuple(ALL)),  # "regular", "risky", or another of `traffic.ALL`
    "scenario": COUNTED,  # number of the scenario, the same seed in both traffics
    "return": NUMBER,  # undiscounted sum of rewards
    "length": Column("int64", 1),  # policy steps
    "crashed": TRUTH,
    "arrived": TRUTH,
    "truncated": TRUTH,  # the time limit ended it
    "mean_speed": NUMBER,  # [m/s], mean over the steps
    "distance": NUMBER,  # [m]
    "min_ttc": Column("float64", 0),  # [s] smallest time-to-collision, inf if there was none
    "near_misses": COUNTED,  # steps with a time-to-collision below 1.5 s and no crash
    "density": AMOUNT,  # other vehicles within 200 m, mean over the steps
    "stopped": Column("float64", 0, 1),  # share of the steps with less than 1 m/s
    **{f"action_{number}": COUNTED for number in range(ACTIONS)},  # how often each action was chosen
    "crash_time": AMOUNT._replace(
        missing=True
    ),  # [s] since the start; this and the following only with a crash
    "crash_other": TEXT_OF_CRASH,
    "crash_x": OF_CRASH,  # [m] the ego's centre
    "crash_y": OF_CRASH,
    "crash_relative_x": OF_CRASH,  # [m] the other's centre in the ego's frame
    "crash_relative_y": OF_CRASH,
    "crash_relative_heading": OF_CRASH,  # [rad]
    "crash_closing_speed": OF_CRASH,  # [m/s]
    "crash_type": TEXT_OF_CRASH._replace(among=get_args(CrashType)),
    "crash_detected_by": TEXT_OF_CRASH._replace(among=("sumo", "geometry", "both", "highway-env")),
    "actions": TEXT_OF_CRASH,  # the actions one after the other, a digit each; cells of earlier versions lack them
}
# Columns of gates.parquet.
JUDGED = ("traffic", "scenario", "return", "length", "crashed", "mean_speed", "distance", "near_misses")
GATE_COLUMNS = (*JUDGED, *(f"action_{number}" for number in range(ACTIONS)))
NEEDED = {EPISODES: tuple(COLUMNS)[:-1], GATES: GATE_COLUMNS}
IS_OF: dict[str, Callable[[Any], bool]] = {
    "int": types.is_integer_dtype,
    "uint": types.is_integer_dtype,
    "float": types.is_numeric_dtype,
    "bool": types.is_bool_dtype,
    "str": lambda kind: types.is_string_dtype(kind) or types.is_object_dtype(kind),
}


def check_record(name: str, record: Any) -> None:
    """That this can be cell.json of the cell of this name. Raises Wrong, which names the entry."""
    check(record, {"files": dict})
    if odd := [
        name for name, digest in record["files"].items() if not (is_name(name) and isinstance(digest, str))
    ]:
        raise Wrong(f"it names files elsewhere: {odd[:3]}")
    check(record, RECORD)
    key = record["key"]
    levels = list(TASKS[key["task"]].levels)
    check(key, {"level_name": tuple(levels)}, "key")
    check(key, {"level": (levels.index(key["level_name"]) + 1,)}, "key")
    if "finished" in (timing := record.get("timing", {})):
        datetime.fromisoformat(timing["finished"])
    is_agent = key["kind"] != "baseline"
    arms = tuple(PAIRS if "pair" in key else EVERY_ARM) if is_agent else (None,)
    check(key, {"arm": arms, "seed": COUNT if is_agent else (None,)}, "key")
    if key["kind"] == "test":
        check(key, {"test_on": TEST, "pair?": PAIR}, "key")
    elif "test_on" in key:
        raise Wrong("key.test_on is for further tests alone")
    if key["kind"] != "test" and key["eval"]["gate_episodes"]:
        check(record, {"files": {GATES: str}})
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


def check_columns(table: pd.DataFrame, columns: Mapping[str, Column], needed: Iterable[str]) -> None:
    """That columns are there, with values of their types and ranges. Raises Wrong, with the row and the column."""
    for name in needed:
        if name not in table:
            raise Wrong(f"it has no column {name!r}")
    for name, column in columns.items():
        if name not in table:
            continue
        values = table[name]
        absent = values.isna().to_numpy()
        kind = column.type.rstrip("0123456789")
        if not (IS_OF[kind](values.dtype) or (column.missing and absent.all())):
            raise Wrong(f"column {name!r} must be of type {column.type}, not {values.dtype}")
        if values.dtype == object and kind == "str":
            texts = values.map(lambda value: isinstance(value, str)).to_numpy(dtype=bool)
            _all(texts | absent, f"column {name!r} has {{}}", values)
        good = ~absent
        if kind in ("int", "uint", "float"):
            numbers = values.to_numpy(dtype=float, na_value=np.nan)
            good = (column.low <= numbers) & (numbers <= column.high)
        elif column.among:
            good &= values.isin(column.among).to_numpy(dtype=bool)
        _all(good | (absent & column.missing), f"column {name!r} has {{}}", values)


def check_episodes(file: str, table: pd.DataFrame) -> None:
    """That episodes.parquet and gates.parquet can be what tests have written; all others pass. Raises Wrong."""
    if file not in NEEDED:
        return
    check_columns(table, COLUMNS, NEEDED[file])
    counted, length = table[list(GATE_COLUMNS[-ACTIONS:])].sum(axis=1), table["length"]
    _all(counted == length, "has {} actions, and its length is another number", counted)
    _all(table["near_misses"] <= length, "has {} near misses, more than steps", table["near_misses"])
    if file == EPISODES:
        for name in (column for column in COLUMNS if column.startswith("crash_")):
            _all(table[name].notna() == table["crashed"], f"{name} {{}} does not fit crashed", table[name])
    if "actions" in table:
        told = table["actions"].fillna("")
        fits = (told.str.len() == length) & told.str.fullmatch("[0-4]*")
        _all(fits | table["actions"].isna(), "actions {} are not one digit a step", told)


def _all(good: np.ndarray | pd.Series, message: str, values: pd.Series) -> None:
    if not good.all():
        row = int(np.flatnonzero(~np.asarray(good, dtype=bool))[0])
        [value] = values.iloc[row : row + 1].tolist()
        raise Wrong(f"row {row}: {message.format(shortened(value))}")


def check_rows(key: Mapping[str, Any], file: str, table: pd.DataFrame) -> None:
    """That a cell's table has each of its scenarios once, in each of its traffics. Raises Wrong, with the scenario."""
    if file == EPISODES:
        asked = {"traffics": TRAFFICS, "episodes": key["eval"]["episodes"], **(key.get("test_on") or {})}
        frequency = (asked.get("env_config") or key["env_config"]).get("policy_frequency", 1)
        is_before_end = table["crash_time"].fillna(0.0) <= (table["length"] + 1) / frequency
        _all(is_before_end, "crash_time {} is after the end of the episode", table["crash_time"])
    elif file == GATES:
        asked = {"traffics": gate_traffics(key["arm"]), "episodes": key["eval"]["gate_episodes"]}
    else:
        return
    first = key["eval"].get("first_scenario", 0)
    numbers = range(first, first + asked["episodes"])  # of a record, which may ask for any number
    wanted = ((traffic, number) for traffic in asked["traffics"] for number in numbers)
    rows = Counter(zip(table["traffic"].tolist(), table["scenario"].tolist(), strict=True))
    for traffic, number in chain((row for row in wanted if rows.pop(row, 0) != 1), rows):
        raise Wrong(
            f"it has {len(table)} rows, and its record asks for {len(asked['traffics']) * len(numbers)}: look at "
            f"scenario {number} in {traffic} traffic"
        )
