"""What is computed for a cell: train, test, store. The task that the runner hands out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import pandas as pd

from experiments.backends import MakeEnv
from experiments.study.compute.evaluate import drives, evaluate
from experiments.study.compute.policies import driver
from experiments.study.compute.progress import costs
from experiments.study.compute.run import Heartbeat
from experiments.study.compute.worth import Worth
from experiments.study.design.arms import gate_traffics
from experiments.study.design.cell import Cell, learner_of, tested_on
from experiments.study.results.schema import EPISODES, GATES, TRAINING, WEIGHTS
from experiments.study.results.store import DamagedCell, Store, of_other_weights
from experiments.support.errors import UserError
from experiments.support.files import made
from experiments.support.provenance import provenance


@dataclass(frozen=True)
class CellTask:
    """A cell to compute in a result directory (a `run.Task`).

    make_env: must be importable in another process.
    silence: a cell that makes no update and ends no episode for so long hangs, and is begun again [s].
    """

    cell: Cell
    directory: Path
    make_env: MakeEnv
    silence: float = 900.0

    @property
    def name(self) -> str:
        """Name of the cell."""
        return self.cell.name

    @property
    def folder(self) -> Path:
        """Its working folder."""
        return Store(self.directory).work / self.name

    def done(self) -> bool:
        """Whether it is stored; damaged results are named and put aside."""
        store = Store(self.directory)
        try:
            if not store.is_whole(self.name):
                return False
            record = store.record(self.name)
            with suppress(KeyError):  # no further test, or of an agent that is not here
                if of_other_weights(record, store.record(record["tested"]["cell"])):
                    raise DamagedCell(store.cells / f"{self.name}.parquet", "its agent was trained again")
            return True
        except DamagedCell as error:
            aside = store.put_aside(self.name)
            print(f"{error.file} is damaged ({error.reason}): put aside in {aside}, to be computed again")
            return False

    def compute(self, heartbeat: Heartbeat) -> None:
        """Train, test and store it."""
        cell, store = self.cell, Store(self.directory)
        training, tests = costs(cell)
        played, steps = 0, max(cell.budget[0], 1)
        timing: dict[str, Any] = {}
        learner: dict[str, Any] = {}
        record: dict[str, Any] = {}
        files: dict[str, Any] = {}

        def on_episode() -> None:
            nonlocal played
            played += 1
            heartbeat((training + tests * played / cell.work) / (training + tests))

        started, busy = time.monotonic(), time.process_time()
        if cell.kind == "agent":
            from experiments.study.compute.train import train_cell  # baselines need no learner

            trained, episodes, record = train_cell(
                cell,
                self.make_env,
                lambda made: heartbeat(training * min(made / steps, 1.0) / (training + tests)),
            )
            timing["train_seconds"] = time.monotonic() - started
            timing["train_cpu_seconds"] = time.process_time() - busy
            trained.policy.save(made(self.folder) / WEIGHTS)
            files = {TRAINING: episodes, WEIGHTS: self.folder / WEIGHTS}
            learner = {"learner": record}
        elif cell.kind == "test":
            self._weights()  # which are here
            tested = store.record(cell.parent.name)["files"].get(WEIGHTS)
            learner = {"tested": {"cell": cell.parent.name, "sha256": tested}}
        started = time.monotonic()
        with closing(self.make_env(*tested_on(cell.key()))) as env:
            files |= self._test(env, on_episode, record)
        timing["test_seconds"] = time.monotonic() - started
        timing["finished"] = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        store.write(cell, {**learner, "timing": timing, "provenance": provenance()}, files)

    def _test(
        self, env: gym.Env[Any, Any], on_episode: Callable[[], None], record: dict[str, Any]
    ) -> dict[str, pd.DataFrame]:
        """The tables of the tests, by file; adds to the record of a learner of Q-values whether these come true."""
        cell = self.cell

        seen, policy = driver(cell.key(), cell.source, env, self._weights())
        first = cell.eval["first_scenario"]

        def table(there: gym.Env[Any, Any], purpose: str, traffics: Iterable[str], n: int) -> pd.DataFrame:
            asked = drives(cell.task, cell.level, range(first, first + n), traffics, purpose)
            return evaluate(there, policy, asked, on_episode)

        episodes = table(seen, "test", cell.tested["traffics"], int(cell.tested["episodes"]))
        if cell.test_on is not None:
            return {EPISODES: episodes}
        judged: Any = seen
        if has_values := "probe_q" in record:
            judged = Worth(seen, policy, learner_of(cell.key(), cell.source)[1].gamma, cell.rules)
        gates = table(judged, "gate", gate_traffics(cell.arm), cell.gate_episodes)
        if has_values:
            record["values"] = judged.record()
        return {EPISODES: episodes, GATES: gates}

    def _weights(self) -> Path | None:
        """Those that are tested; None for a policy that is not trained."""
        if self.cell.kind != "test":
            return self.folder / WEIGHTS if self.cell.kind == "agent" else None
        parent = self.cell.parent.name
        weights = Store(self.directory).weights(parent)
        if weights is None:
            raise UserError(
                f"the weights of {parent} are not here: train it first, by the same command without --cell"
            )
        return weights
