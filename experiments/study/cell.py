"""What is computed for a cell: train, test, store. The task that the runner hands out."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import pandas as pd

from agents.checkpoint import CheckpointError
from agents.policies import Policy
from experiments.study.arms import gate_traffics
from experiments.study.evaluate import evaluate
from experiments.study.grid import Cell
from experiments.study.policies import load_agent, untrained_policy
from experiments.study.run import Beat
from experiments.study.store import (
    EPISODES,
    GATE_COLUMNS,
    GATES,
    MARK_COLUMNS,
    MARKS,
    TRAINING,
    WEIGHTS,
    DamagedCell,
    Store,
)
from experiments.study.wrappers import observed
from experiments.support.errors import UserError
from experiments.support.provenance import provenance

if TYPE_CHECKING:
    from experiments.study.train import Trained

MakeEnv = Callable[..., gym.Env[Any, Any]]
TEST_EPISODE = 10.0  # about as long as so many updates with their steps


@dataclass(frozen=True)
class CellTask:
    """A cell to compute in a result directory (a `run.Task`).

    make_env: makes an environment from (backend, task, config); must be importable in another process.
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
        """Where its checkpoint lies."""
        return Store(self.directory).work / self.name

    def done(self) -> bool:
        """Whether it is stored; damaged results are named and put aside."""
        store = Store(self.directory)
        try:
            store.record(self.name)
        except KeyError:
            return False
        except DamagedCell as error:
            aside = store.put_aside(store.cells / self.name)
            print(f"{error.file} is damaged ({error.reason}): put aside in {aside}, to be computed again")
            return False
        return True

    def compute(self, beat: Beat) -> None:
        """Train, test and store it."""
        cell, store = self.cell, Store(self.directory)
        timing: dict[str, Any] = {}
        done, total = 0.0, cell.updates + TEST_EPISODE * cell.work
        trained: Trained | None = None
        learner: dict[str, Any] = {}

        def advance(amount: float = TEST_EPISODE) -> None:
            nonlocal done
            done += amount
            beat(done / total)

        started = time.monotonic()
        if cell.kind == "agent":
            trained = _train(cell, store, self.make_env, advance)
            learner = {"learner": trained.learner}
            timing["train_seconds"] = time.monotonic() - started
        started = time.monotonic()
        with closing(self.make_env(cell.runs_on, cell.task, dict(cell.tested_config))) as env:
            files: dict[str, Any] = _test(cell, env, trained, store, advance)
        timing["test_seconds"] = time.monotonic() - started
        timing["finished"] = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        if trained is not None:
            trained.policy.save(self.folder / WEIGHTS)
            files |= {TRAINING: trained.episodes, WEIGHTS: self.folder / WEIGHTS}
        store.write(cell, {**learner, "timing": timing, "provenance": provenance()}, files)


def _train(cell: Cell, store: Store, make_env: MakeEnv, advance: Callable[[float], None]) -> Trained:
    """The trained agent."""
    from experiments.study.train import CHECKPOINT, train_cell  # baselines need no learner

    scratch = store.work / cell.name
    with closing(make_env(cell.backend, cell.task, cell.training_config)) as env:
        try:
            return train_cell(cell, env, scratch, advance)
        except CheckpointError as damage:
            aside = store.put_aside(scratch / CHECKPOINT)
            print(f"{cell.name}: its checkpoint was damaged ({damage}) and put aside in {aside}", flush=True)
            return train_cell(cell, env, scratch, advance)


def _test(
    cell: Cell, env: gym.Env[Any, Any], trained: Trained | None, store: Store, advance: Callable[[], None]
) -> dict[str, pd.DataFrame]:
    """The tables of the tests of a cell, by file."""

    def play(driver: tuple[gym.Env[Any, Any], Policy], episodes: int, **options: Any) -> pd.DataFrame:
        first = cell.first_scenario
        return evaluate(*driver, cell.task, cell.level, episodes, advance, first=first, **options)

    driver = _driver(cell, env, trained, store)
    if cell.test_on is not None:
        return {EPISODES: play(driver, cell.test_on["episodes"], traffics=cell.test_on["traffics"])}
    gates = play(driver, cell.gate_episodes, purpose="gate", traffics=gate_traffics(cell.arm))
    tables = {EPISODES: play(driver, cell.episodes), GATES: gates[list(GATE_COLUMNS)]}
    if trained is not None and trained.marks:
        early = [load_agent(cell.key(), cell.source, file, env) for file in trained.marks]
        tested = [play(driver, cell.episodes).assign(mark=k) for k, driver in enumerate(early, start=1)]
        tables[MARKS] = pd.concat(tested)[list(MARK_COLUMNS)]
    return tables


def _driver(
    cell: Cell, env: gym.Env[Any, Any], trained: Trained | None, store: Store
) -> tuple[gym.Env[Any, Any], Policy]:
    """The policy to be tested, behind the environment as it observes it."""
    if trained is not None:
        return observed(env, cell.profile), trained.policy
    if cell.test_on is None:
        return env, untrained_policy(cell.key(), cell.source, env)
    weights = store.weights(cell.parent.name)
    if weights is None:
        raise UserError(
            f"the weights of {cell.parent.name} are not here: train it first, by the same command without --cell"
        )
    return load_agent(cell.key(), cell.source, weights, env)
