"""Records, tables and agents that are odd rather than broken, with right checksums; SUMO's files: judged.toml."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from agents.files import load_arrays, save_arrays

HUGE = 10**9
Act = Callable[[], object]


def deep(value: Mapping[str, Any], path: str, new: Any) -> None:
    """Set an entry, "a.b.c", of nested dicts."""
    *parts, last = path.split(".")
    for part in parts:
        value = value.setdefault(part, {})  # type: ignore[attr-defined]
    value[last] = new  # type: ignore[index]


# Entries of an agent's record, and odd values of each; ~ in text stands for a number that JSON writes as 1e999.
RECORDS: dict[str, tuple[Any, ...]] = {
    "schema": (99, 0, -1, []),
    "versions": ([], "1", {"libsumo": 5}, {"libsumo": None}),
    "key": ([],),
    "key.kind": ("teacher", 3, None),
    "key.backend": ("carla", ["sumo"]),
    "key.task": ("racing", None),
    "key.level": (99, 0, "1", 2.5),
    "key.level_name": ("999", 50),
    "key.arm": ("placebo", 1, None),
    "key.profile": (None, []),
    "key.env_config": ("x", None),
    "key.dynamics": (3,),
    "key.eval": ({}, {"episodes": "many", "gate_episodes": 100}, {"episodes": 50, "gate_episodes": 100}),
    "key.policy": (
        None,
        7,
        "x" * 300,
        "../../x",
        "a/b",
        "x\n",
        "\u202etxt",
        "<script>alert(1)</script>",
        "",
    ),
    "key.eval.episodes": (HUGE - 1, 10**400, 2.0, True),
    "key.eval.gate_episodes": (HUGE - 1, -1),
    "key.eval.first_scenario": (HUGE - 1, -1, "0"),
    "key.seed": (HUGE - 1, 10**30, True, "0", -1, None, 0.5),
    "key.env_config.vehicles_count": (HUGE, -1, "many"),
    "key.env_config.policy_frequency": (0, -1, "often", 1e-9, None),
    "key.env_config.duration": (HUGE, 0, -5),
    "key.env_config.simulation_frequency": (10**7, 0),
    "key.env_config.screen_width": (10**6, 0),
    "key.env_config.other_vehicles_type": ("os.system", "antigravity.fly"),
    "key.env_config.observation": ({"type": "os.system"}, []),
    "key.env_config.sumo_options": (["--message-log=/dev/null"],),
    "key.profile.preset": ([], {"a": 1}, 3),
    "key.profile.network": ("os.system", "../evil.py:Net", 3),
    "key.test_on": ({}, {"backend": "sumo"}),
    "timing": ([],),
    "timing.finished": ("tomorrow", "9999-99-99", 3),
    "timing.train_seconds": (-5, "~", True, 1e300),
    "provenance.packages": ([], None, {"numpy": [1]}),
    "learner": ([],),
    "learner.curve": (
        [],
        {"step": [1], "return": [], "crashed": []},
        {"step": ["1"], "return": [1], "crashed": [0]},
    ),
    "learner.q_bound": ("~", -3, True, "large"),
    "learner.probe_q": ([["~", 1, 1]], [[1, 1, 1]] * 3 + [[1, 2]], [], [[1, 2.0, "x"]], [[1]], "many"),
    "extra": ({"a": 1},),
    "files": ([], {"episodes.parquet": "0" * 64}, {"con": "0" * 64}, {"x" * 300: "0" * 64}, {}),
}
# Entries that are taken out.
NEEDED: tuple[str, ...] = ("schema", "key", "versions", "files", "timing", "learner")
NEEDED += tuple(
    path for path in RECORDS if path.startswith("key.") and path.count(".") == 1 and path != "key.test_on"
)


def _column(name: str, change: Callable[[pd.Series], Any]) -> Callable[[pd.DataFrame], Any]:
    return lambda table: table.assign(**{name: change(table[name])})


def _named_twice(table: pd.DataFrame) -> pa.Table:
    arrow = pa.Table.from_pandas(table, preserve_index=False)
    return arrow.append_column("return", arrow["return"])


def _bomb(table: pd.DataFrame) -> pa.Table:
    """A file of some kilobytes with 100 million rows."""
    arrow = pa.Table.from_pandas(table.iloc[:1], preserve_index=False)
    return pa.concat_tables([arrow] * 10_000).combine_chunks().take(pa.array(np.zeros(5_000_000, np.int32)))


# Tables of test episodes.
TABLES: dict[str, Callable[[pd.DataFrame], Any]] = {
    "float32": _column("return", lambda c: c.astype("float32")),
    "int8": _column("length", lambda c: c.astype("int8")),
    "uint64": _column("scenario", lambda c: c.astype("uint64") + np.uint64(2**63)),
    "float scenario": _column("scenario", lambda c: c.astype(float)),
    "half scenarios": _column("scenario", lambda c: c + 0.5),
    "nullable": _column("length", lambda c: c.astype("Int64")),
    "nullable with none": _column("length", lambda c: c.astype("Int64").mask(c.index == 3)),
    "category": _column("traffic", lambda c: c.astype("category")),
    "truth as numbers": _column("crashed", lambda c: c.astype(int)),
    "truth as text": _column("crashed", lambda c: c.astype(str)),
    "truth with none": _column("crashed", lambda c: c.astype("boolean").mask(c.index == 3)),
    "dates": _column("return", lambda c: pd.to_datetime(c, unit="s")),
    "spans": _column("return", lambda c: pd.to_timedelta(c, unit="s")),
    "lists": _column("return", lambda c: c.map(lambda v: [v])),
    "complex text": _column("return", lambda c: c.map(lambda v: f"{v}j")),
    "structs": _column("return", lambda c: c.map(lambda v: {"a": v})),
    "bytes": _column("traffic", lambda c: c.map(lambda v: v.encode())),
    "blanks": _column("traffic", lambda c: c + " "),
    "upper case": _column("traffic", lambda c: c.str.upper()),
    "nul": _column("traffic", lambda c: c + "\0"),
    "huge": _column("return", lambda c: c * 0 + 1e300),
    "far": _column("distance", lambda c: c * 0 - 1e300),
    "long": _column("length", lambda c: c * 0 + 2**62),
    "index": lambda t: t.set_index("scenario"),
    "two indices": lambda t: t.set_index(["traffic", "scenario"]),
    "column twice": _named_twice,
    "columns of numbers": lambda t: t.rename(columns={"return": "0"}),
    "column arm": lambda t: t.assign(arm="treatment"),
    "column seed": lambda t: t.assign(seed=0),
    "column kind": lambda t: t.assign(kind="agent"),
    "column of objects": lambda t: t.assign(more="x" * 1000),
    "many columns": lambda t: pd.concat(
        [t, pd.DataFrame(0, t.index, [f"c{k}" for k in range(5000)])], axis=1
    ),
    "capital column": lambda t: t.rename(columns={"return": "Return"}),
    "column with a blank": lambda t: t.rename(columns={"return": "return "}),
    "no columns": lambda t: t[[]],
    "bomb": _bomb,
    "crash without a type": _column("crash_type", lambda c: c.where(c.isna(), "")),
    "crash of no type": _column("crash_type", lambda c: c.where(c.isna(), "<b>ufo</b>")),
    "crash after the end": _column("crash_time", lambda c: c + 1e6),
}


def write_table(file: Path, changed: Any) -> None:
    """A frame or an arrow table."""
    if isinstance(changed, pd.DataFrame):
        changed.to_parquet(file)
    else:
        pq.write_table(changed, file, compression="zstd")


def archives(file: Path) -> dict[str, Act]:
    """Odd npz files."""
    arrays = load_arrays(file)
    name, weights = next((n, a) for n, a in arrays.items() if a.dtype.kind == "f" and a.ndim > 1)
    content = file.read_bytes()

    def put(**changes: Any) -> Act:
        return lambda: np.savez(file, **{**arrays, **changes})

    def raw(entry: str, data: bytes, how: int = zipfile.ZIP_STORED) -> Act:
        def act() -> None:
            with zipfile.ZipFile(file, "a", how) as archive:
                archive.writestr(entry, data)

        return act

    def header(shape: tuple[int, ...]) -> bytes:
        stream = io.BytesIO()
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f4", "fortran_order": False, "shape": shape})
        return stream.getvalue()

    def bomb() -> None:
        rest: dict[str, Any] = {key: value for key, value in arrays.items() if key != name}
        np.savez(file, **rest)
        with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(f"{name}.npy", header((3 * 2**30,)) + bytes(2**20))
            archive.filelist[-1].file_size = 12 * 2**30  # as the directory at its end says

    def headless() -> None:
        rest: dict[str, Any] = {key: value for key, value in arrays.items() if key != name}
        np.savez(file, **rest)
        with zipfile.ZipFile(file, "a") as archive:
            archive.writestr(f"{name}.npy", header((10**12,)))

    def plain() -> None:
        with file.open("wb") as stream:
            np.save(stream, weights)

    return {
        "big-endian": put(**{name: weights.astype(">f4")}),
        "fortran": put(**{name: np.asfortranarray(weights)}),
        "double": put(**{name: weights.astype(np.float64)}),
        "whole numbers": put(**{name: weights.astype(np.int64)}),
        "truth values": put(**{name: weights > 0}),
        "complex": put(**{name: weights.astype(complex)}),
        "objects": lambda: np.savez(file, allow_pickle=True, **{**arrays, name: weights.astype(object)}),
        "records": put(**{name: np.zeros(3, [("a", "f4")])}),
        "dates": put(**{name: np.zeros(3, "M8[s]")}),
        "one number": put(**{name: np.float32(1)}),
        "transposed": put(**{name: weights.T.copy()}),
        "an entry more": put(more=np.zeros(3)),
        "an entry elsewhere": raw("../../evil.npy", header((0,))),
        "an entry twice": raw(f"{name}.npy", header((0,))),
        "no array": raw(f"{name}x.npy", b"no array"),
        "a text file": raw("readme.txt", b"words"),
        "long name": raw("x" * 60_000, b""),
        "a plain array": plain,
        "something before": lambda: file.write_bytes(b"#!/bin/sh\n" * 100 + content),
        "something after": lambda: file.write_bytes(content + b"x" * 1000),
        "bomb": bomb,
        "header of a terabyte": headless,
        "sparse": lambda: os.truncate(file, 2**41),
        "link": lambda: (
            file.rename(file.with_suffix(".old")).with_suffix(".npz").symlink_to(f"{file.stem}.old")
        ),
        "unreadable": lambda: file.chmod(0),
    }


CARDS: dict[str, tuple[Any, ...]] = {
    "actions": (9999, 0, 4, True),
    "observations": ([9999, 9999, 9999], [], [3], [9999, 3], [-3, 5], [3, 5, 1, 1, 1, 1, 1, 1]),
    "time_observed": (9999, 15, -1, True),
    "network": ("os.system", "evil.py:Net", "attention", ""),
    "task": ("racing", ""),
    "config": ([], {"vehicles_count": HUGE}, {"nonsense": 1}),
    "cell": (3, "\x1b]0;evil\x07"),
    "regular": ({}, {"episodes": 0, "crash_rate": [], "return": [], "speed": []}),
    "risky.crash_rate": ([7], [1.5, 1, 2], ["0", "0", "1"], [0.9, 0.1, 0.2], ["~", 1, 1]),
}


def odd_cards(file: Path) -> dict[str, Act]:
    """Cards that do not fit their agent."""
    arrays = load_arrays(file)
    cards = json.loads(str(arrays["cards"]))
    label = next(iter(cards))
    ways: dict[str, Act] = {}

    def write(cards: Any) -> None:
        text = json.dumps(cards).replace('"~"', "1e999")
        save_arrays(file, {**arrays, "cards": np.array(text)})

    def entry(path: str, value: Any) -> None:
        changed = json.loads(json.dumps(cards))
        deep(changed[label], path, value)
        write(changed)

    for path, values in CARDS.items():
        for value in values:
            ways[f"{path}={str(value)[:40]}"] = partial(entry, path, value)
    for name in ("a", "a/b/c", "../x", "", "\ud800/x"):
        ways[f"agent {name!r} more"] = partial(write, {**cards, name: cards[label]})
    ways["cards twice"] = lambda: write([cards, cards])
    return ways
