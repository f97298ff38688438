"""Stored episodes of all kinds: a byte that has changed is never believed."""

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from experiments.rare import Options, question
from experiments.study.compute import rare, takeover
from experiments.study.compute.batches import Batch
from experiments.study.compute.entrants import entrant_of
from experiments.study.results.parquet import Damaged, packed
from experiments.study.results.schema import EPISODES, GATES
from experiments.study.results.store import Store
from experiments.validation import episodes
from tests.experiments import synthetic

FLIPS = 200
Read = Callable[[], list[pd.DataFrame]]


def made_up(columns: dict[str, str], known: dict[str, Any]) -> pd.DataFrame:
    """Rows with these values in some columns, and any in the others."""
    n, random = len(next(iter(known.values()))), np.random.default_rng(0)
    values = {
        name: "a word" if kind == "str" else random.uniform(0, 100, n) for name, kind in columns.items()
    }
    return pd.DataFrame({**values, **known})[[*columns]].astype(columns)


def a_cell(folder: Path) -> tuple[Path, Read]:
    cell = synthetic.write(folder, {"u-turn": (1,)}, tests=5, seeds=1, baselines=("idle",))[-1]
    store = Store(folder)
    return folder / "cells" / f"{cell.name}.parquet", lambda: [
        pd.DataFrame([store.record(cell.name)]),
        *(store.tables(cell.name)[name] for name in (EPISODES, GATES)),
    ]


def written(batch: Batch) -> tuple[Path, Read]:
    batch.write(made_up(dict(batch.columns), dict(batch.episodes)))
    return batch.path, lambda: [batch.read()]


def a_batch(folder: Path) -> tuple[Path, Read]:
    asked = question(Options(("slower",), "u-turn"), "slower")
    return written(rare.Batch(folder, asked, "pilot", ((0.1, 0.1), (0.1, 1.0)), 10, 0))


def moments(folder: Path) -> tuple[Path, Read]:
    drivers = {name: entrant_of(policy, "u-turn", "3") for name, policy in (("a", "slower"), ("b", "sumo"))}
    asked = takeover.Question("u-turn", "3", {}, "risky", drivers, takeover.BOUNDS, "")
    return written(takeover.Batch(folder, asked, 0, 0, 10))


def a_part(folder: Path) -> tuple[Path, Read]:
    return written(episodes.Part(folder, episodes.Engine("sumo", "sumo"), "u-turn", 1, "risky", range(5)))


@pytest.fixture(params=[a_cell, a_batch, moments, a_part])
def stored(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Read]:
    return request.param(tmp_path)


def flipped(content: bytes) -> Iterator[bytes]:
    random = np.random.default_rng(1)
    for place, bit in zip(
        random.integers(len(content), size=FLIPS), random.integers(8, size=FLIPS), strict=True
    ):
        yield content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :]


def test_a_changed_byte_is_noticed_or_changes_nothing(stored: tuple[Path, Read]) -> None:
    path, read = stored
    whole, before, noticed = path.read_bytes(), read(), 0
    for number, content in enumerate(flipped(whole)):
        path.write_bytes(content)
        os.utime(path, ns=(number, number))  # a file that was read before is known by its time
        try:
            found = read()
        except Damaged:
            noticed += 1
            continue
        for old, new in zip(before, found, strict=True):
            pd.testing.assert_frame_equal(old, new)
    assert noticed > FLIPS / 3
    for content in (b"", whole[: len(whole) // 2], whole + whole[-8:]):
        path.write_bytes(content)
        with pytest.raises(Damaged):
            read()


def test_rows_that_are_not_those_asked_for_are_named_and_driven_again(tmp_path: Path, capsys) -> None:
    file = episodes.Part(tmp_path, episodes.Engine("sumo", "sumo"), "u-turn", 1, "risky", range(5))
    file.write(whole := made_up(episodes.COLUMNS, dict(file.episodes)))
    assert file.done() and not capsys.readouterr().out
    for rows in (whole.iloc[:-1], whole.iloc[::-1], whole.drop(columns="density")):
        with pytest.raises(ValueError):
            file.write(rows)
        file.path.write_bytes(packed(pa.Table.from_pandas(rows, preserve_index=False), file.name))
        assert not file.done()
        assert re.search(rf"{re.escape(file.path.name)} is damaged .*driven again", capsys.readouterr().out)


def test_episodes_of_another_task_are_not_taken(tmp_path: Path) -> None:
    """Two policies have the same scenarios: a batch of one is none of the other, whatever its file is called."""
    slower, idle = (
        rare.Batch(tmp_path, question(Options((policy,), "u-turn"), policy), "pilot", ((0.1, 0.1),), 5, 0)
        for policy in ("slower", "idle")
    )
    assert slower.episodes == idle.episodes
    slower.write(made_up(rare.COLUMNS, dict(slower.episodes)))
    idle.path.write_bytes(slower.path.read_bytes())
    assert slower.done() and not idle.done()
