"""What is computed for a cell: train, test, store. The task that the runner hands out."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym

from experiments.study.attempt import Beat
from experiments.study.evaluate import Policy, evaluate
from experiments.study.grid import Cell
from experiments.study.policies import load_agent, untrained_policy
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
    weights_file,
)
from experiments.study.wrappers import observed
from experiments.support.errors import UserError
from experiments.support.provenance import provenance

if TYPE_CHECKING:
    import pandas as pd

    from experiments.study.train import Trained

MakeEnv = Callable[..., gym.Env[Any, Any]]
TEST_EPISODE = 10.0  # about as long as so many updates with their steps
SILENCE = 900.0  # [s] a cell that makes no update and ends no episode for so long hangs


@dataclass(frozen=True)
class CellTask:
    """A cell to compute in a result directory (an `attempt.Task`).

    make_env: makes an environment from (backend, task, config); must be importable in another process.
    cost: expected time on one core [s].
    """

    cell: Cell
    directory: Path
    make_env: MakeEnv
    cost: float = 1.0
    silence: float = SILENCE

    @property
    def name(self) -> str:
        """Name of the cell."""
        return self.cell.name

    @property
    def folder(self) -> Path:
        """Where its checkpoint lies."""
        return Store(self.directory).work / self.name

    def done(self) -> bool:
        """Whether it is stored; damaged results are put aside."""
        store = Store(self.directory)
        try:
            return store.is_finished(self.cell)
        except DamagedCell:
            store.put_aside(store.cells / self.name)
            return False

    def compute(self, beat: Beat) -> str:
        """Train, test and store it; returns a remark for the user, or nothing."""
        return compute(self.cell, Store(self.directory), self.make_env, beat)


def compute(cell: Cell, store: Store, make_env: MakeEnv, beat: Beat) -> str:
    """Train, test and store a cell; returns a remark for the user, or nothing."""
    meter = Meter(beat, cell.updates + cell.work * TEST_EPISODE)
    scratch = store.work / cell.name
    trained, timing, remark = _train(cell, store, make_env, meter) if cell.kind == "agent" else (None, {}, "")
    clock = Clock()
    with closing(make_env(cell.runs_on, cell.task, dict(cell.tested_config))) as env:
        tables = _early_tests(cell, trained, env, scratch, meter) if trained else {}
        tables |= _test(cell, *_policy(cell, trained, store, env), meter)
    record = {"timing": {**timing, **clock.test(cell.work)}, "provenance": provenance()}
    if trained is None:
        store.write(cell, record, tables)
    else:
        trained.policy.save(scratch / WEIGHTS)
        files = {**tables, TRAINING: trained.episodes, WEIGHTS: scratch / WEIGHTS}
        store.write(cell, {"learner": trained.learner, **record}, files)
    return remark


class Meter:
    """Turns amounts of work into the share of a cell that is done. total: the work in updates."""

    def __init__(self, beat: Beat, total: float) -> None:
        self._beat, self._total, self._done = beat, total, 0.0

    def add(self, amount: float = TEST_EPISODE) -> None:
        """Note that a piece of the work is done."""
        self._done += amount
        self._beat(self._done / self._total)


class Clock:
    """Measures time and processor time."""

    def __init__(self) -> None:
        self._started, self._processed = time.monotonic(), time.process_time()

    def since(self, what: str) -> dict[str, float]:
        """How long something has taken."""
        return {
            f"{what}_seconds": time.monotonic() - self._started,
            f"{what}_cpu_seconds": time.process_time() - self._processed,
        }

    def test(self, episodes: int) -> dict[str, Any]:
        """What cell.json says of a test of so many episodes, which ends now."""
        finished = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        return {"test_episodes": episodes, **self.since("test"), "finished": finished}


def _train(cell: Cell, store: Store, make_env: MakeEnv, meter: Meter) -> tuple[Trained, dict[str, Any], str]:
    """The trained agent, what its training has taken, and a remark."""
    from experiments.study.train import CHECKPOINT, checkpoint_damage, train_cell  # baselines need no learner

    scratch = store.work / cell.name
    scratch.mkdir(exist_ok=True)
    remark = ""
    if (damage := checkpoint_damage(scratch / CHECKPOINT)) is not None:
        aside = store.put_aside(scratch / CHECKPOINT)
        remark = f"its checkpoint was damaged ({damage}) and put aside in {aside}"
    clock = Clock()  # of this process: a resumed training counts from its last checkpoint
    with closing(make_env(cell.backend, cell.task, cell.training_config)) as env:
        trained = train_cell(cell, env, scratch, meter.add, cell.marks)
    return trained, {**clock.since("train"), "timed_updates": trained.timed_updates}, remark


def _policy(
    cell: Cell, trained: Trained | None, store: Store, env: gym.Env[Any, Any]
) -> tuple[gym.Env[Any, Any], Policy]:
    """The policy to be tested, and the environment as it observes it."""
    if trained is not None:
        return observed(env, cell.profile), trained.policy
    if cell.test_on is None:
        return env, untrained_policy(cell.key(), cell.source, env)
    weights = weights_file(store.directory, cell.parent.name)
    if weights is None:
        raise UserError(
            f"the weights of {cell.parent.name} are not here: train it first, by the same command without --cell"
        )
    return load_agent(cell.key(), cell.source, weights, env)


def _test(cell: Cell, env: gym.Env[Any, Any], policy: Policy, meter: Meter) -> dict[str, pd.DataFrame]:
    """The tables of a policy's test, by file."""
    first = cell.first_scenario
    if cell.test_on is not None:
        traffics, episodes = cell.test_on["traffics"], int(cell.test_on["episodes"])
        return {
            EPISODES: evaluate(
                env, policy, cell.task, cell.level, episodes, meter.add, traffics=traffics, first=first
            )
        }
    test = evaluate(env, policy, cell.task, cell.level, cell.episodes, meter.add, first=first)
    gates = evaluate(
        env, policy, cell.task, cell.level, cell.gate_episodes, meter.add,
        purpose="gate", traffics=cell.gate_traffics, first=first,
    )  # fmt: skip
    return {EPISODES: test, GATES: gates[list(GATE_COLUMNS)]}


def _early_tests(
    cell: Cell, trained: Trained, env: gym.Env[Any, Any], scratch: Path, meter: Meter
) -> dict[str, pd.DataFrame]:
    """The test of the policies that an agent had after shares of its budget, by file."""
    import pandas as pd

    tables = []
    for number, file in enumerate(trained.marks, start=1):
        try:
            seen, policy = load_agent(cell.key(), cell.source, file, env)
        except (UserError, OSError) as error:
            for checkpoint in scratch.glob("checkpoint*"):
                checkpoint.unlink()
            raise RuntimeError(f"{file.name} is lost ({error}): the training begins again") from None
        table = evaluate(
            seen, policy, cell.task, cell.level, cell.episodes, meter.add, first=cell.first_scenario
        )
        table.insert(0, "mark", number)
        tables.append(table)
    return {MARKS: pd.concat(tables)[list(MARK_COLUMNS)]} if tables else {}
