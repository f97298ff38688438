"""Episodes in batches: each is driven once, and is a file of rows, so that a command goes on where it was stopped."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd

from experiments.study.compute.executors import open_executor
from experiments.study.compute.executors.local import TASKS_PER_PROCESS
from experiments.study.compute.progress import ProgressDisplay
from experiments.study.compute.run import Heartbeat, run
from experiments.study.results.parquet import DamagedEpisodes, read_part, write_part
from experiments.study.results.working import LOG
from experiments.support.errors import UserError
from experiments.support.files import digest_of


@dataclass(frozen=True)
class Batch(ABC):
    """Some episodes (a `run.Task`). directory: of the results. columns: of their rows, as of `read_part`."""

    directory: Path
    silence: ClassVar[float] = 900.0
    columns: ClassVar[Mapping[str, str]]

    @property
    @abstractmethod
    def name(self) -> str:
        """It says what is computed, see `named`."""

    @property
    @abstractmethod
    def episodes(self) -> Mapping[str, Sequence[Any]]:
        """Which they are, as of `read_part`."""

    @abstractmethod
    def drive(self) -> Iterator[dict[str, Any]]:
        """Drive them, row by row."""

    @property
    def size(self) -> float:
        """What it costs beside other batches."""
        return 1.0

    @property
    def folder(self) -> Path:
        """Its working folder."""
        return self.directory / "work" / self.name

    @property
    def path(self) -> Path:
        """The file in which they are stored."""
        return self.directory / "episodes" / f"{self.name}.parquet"

    def read(self) -> pd.DataFrame:
        """The stored rows. Raises DamagedEpisodes."""
        return read_part(self.path, self.name, self.columns, self.episodes)

    def done(self) -> bool:
        """Whether they are stored; a damaged file is named, and its episodes are to be driven again."""
        if not self.path.exists():
            return False
        try:
            self.read()
        except DamagedEpisodes as error:
            print(f"{self.path} is damaged ({error.reason}): its episodes are driven again", flush=True)
            return False
        return True

    def rows(self, heartbeat: Heartbeat = lambda _: None) -> pd.DataFrame:
        """Drive them in this process, telling `heartbeat` the share that is done."""
        rows, number = list[dict[str, Any]](), len(next(iter(self.episodes.values())))
        for row in self.drive():
            rows.append(row)
            heartbeat(len(rows) / number)
        return pd.DataFrame(rows, columns=list(self.columns))

    def write(self, rows: pd.DataFrame) -> None:
        """Store them. Raises ValueError where the rows are not those of the episodes; OSError."""
        write_part(self.path, self.name, self.columns, rows, self.episodes)

    def compute(self, heartbeat: Heartbeat) -> None:
        """Drive and store them."""
        self.write(self.rows(heartbeat))


def named(label: str, key: Mapping[str, Any]) -> str:
    """The name of a batch. key: all that decides the result, as plain values."""
    return f"{label}-{digest_of(key)[:12]}"


def driven(batches: Sequence[Batch], executor: str, workers: int | None, kind: str) -> pd.DataFrame:
    """The rows of all batches of a directory, those included that were driven before.

    Raises:
        UserError: some failed.
    """
    directory = batches[0].directory
    there = {batch.name for batch in batches if batch.done()}
    failures = dict[str, str]()
    sizes = {batch.name: batch.size for batch in batches}
    with closing(ProgressDisplay(directory / "work", sizes, there, kind)) as progress:
        if left := [batch for batch in batches if batch.name not in there]:
            opened = open_executor(executor, workers, directory, TASKS_PER_PROCESS, len(left))
            failures = run(left, *opened, progress)
    for name, reason in failures.items():
        log = directory / "work" / name / LOG
        raise UserError(
            f"{len(failures)} {kind} failed; {name}: {reason}, see {log}. Run the command again to go on"
        )
    return pd.concat([batch.read() for batch in batches], ignore_index=True)
