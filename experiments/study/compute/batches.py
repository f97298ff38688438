"""Episodes in batches: each is driven once, and is a file of rows, so that a command goes on where it was stopped."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd

from experiments.study.compute.executors import open_executor
from experiments.study.compute.executors.local import TASKS_PER_PROCESS
from experiments.study.compute.progress import ProgressDisplay
from experiments.study.compute.run import Heartbeat, run
from experiments.study.results.part import PartFile
from experiments.support.errors import UserError
from experiments.support.files import canonical_json, sha256_bytes


@dataclass(frozen=True)
class Batch(ABC):
    """Some episodes (a `run.Task`). directory: of the results. columns: as of `PartFile`."""

    directory: Path
    silence: ClassVar[float] = 900.0
    columns: ClassVar[Mapping[str, str]]

    @property
    @abstractmethod
    def label(self) -> str:
        """What its name begins with."""

    @property
    @abstractmethod
    def key(self) -> Mapping[str, Any]:
        """All that decides the result, as plain values."""

    @property
    @abstractmethod
    def episodes(self) -> Mapping[str, Sequence[Any]]:
        """Which they are, as of `PartFile`."""

    @abstractmethod
    def drive(self, heartbeat: Heartbeat) -> pd.DataFrame:
        """Drive them."""

    @cached_property
    def name(self) -> str:
        """It says what is computed."""
        return f"{self.label}-{sha256_bytes(canonical_json(self.key).encode())[:12]}"

    @property
    def folder(self) -> Path:
        """Its working folder."""
        return self.directory / "work" / self.name

    @property
    def file(self) -> PartFile:
        """Where they are stored."""
        path = self.directory / "episodes" / f"{self.name}.parquet"
        return PartFile(path, self.name, self.columns, self.episodes)

    def done(self) -> bool:
        """Whether they are stored; those of a damaged file are driven again."""
        return self.file.done()

    def compute(self, heartbeat: Heartbeat) -> None:
        """Drive and store them."""
        self.file.write(self.drive(heartbeat))


def driven(batches: Sequence[Batch], executor: str, workers: int | None, kind: str) -> pd.DataFrame:
    """The rows of all batches of a directory, those included that were driven before.

    Raises:
        UserError: some failed.
    """
    directory = batches[0].directory
    there = {batch.name for batch in batches if batch.done()}
    failures = dict[str, str]()
    sizes = {batch.name: 1.0 for batch in batches}
    with closing(ProgressDisplay(directory / "work", sizes, there, kind)) as progress:
        if left := [batch for batch in batches if batch.name not in there]:
            opened = open_executor(executor, workers, directory, TASKS_PER_PROCESS, len(left))
            failures = run(left, *opened, progress)
    if failures:
        name, reason = next(iter(failures.items()))
        raise UserError(f"{len(failures)} {kind} failed; {name}: {reason}. Run the command again to go on")
    return pd.concat([batch.file.read() for batch in batches], ignore_index=True)
