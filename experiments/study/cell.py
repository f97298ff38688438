"""What is computed for a cell: train, test, store. The task that the runner hands out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym

from experiments.study.attempt import Beat
from experiments.study.evaluate import Policy, evaluate
from experiments.study.grid import Cell
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
        """Train, test and store it."""
        cell, store = self.cell, Store(self.directory)
        config = cell.test_on["env_config"] if cell.test_on else cell.env_config
        env = self.make_env(cell.runs_on, cell.task, dict(config))
        try:
            if cell.kind == "agent":
                return _agent(cell, env, self.make_env, store, beat)
            return (_further_test if cell.kind == "test" else _baseline)(cell, env, store, beat)
        finally:
            env.close()


class Meter:
    """Turns amounts of work into the share of a cell that is done. total: the work in updates."""

    def __init__(self, beat: Beat, total: float) -> None:
        self._beat, self._total, self._done = beat, total, 0.0

    def add(self, amount: float) -> None:
        """Note that a piece of the work is done."""
        self._done += amount
        self._beat(self._done / self._total)


class Clock:
    """Measures a test."""

    def __init__(self) -> None:
        self._started, self._processed = time.monotonic(), time.process_time()

    def test(self, episodes: int) -> dict[str, Any]:
        """What cell.json says of a test of so many episodes, which ends now."""
        return {
            "test_episodes": episodes,
            "test_seconds": time.monotonic() - self._started,
            "test_cpu_seconds": time.process_time() - self._processed,
            "finished": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        }


def _baseline(cell: Cell, env: gym.Env[Any, Any], store: Store, beat: Beat) -> str:
    from experiments.study.policies import untrained_policy

    meter = Meter(beat, cell.work * TEST_EPISODE)
    _test(cell, untrained_policy(cell.key(), cell.source, env), env, store, meter, {}, {})
    return ""


def _further_test(cell: Cell, env: gym.Env[Any, Any], store: Store, beat: Beat) -> str:
    """Test an agent that is stored already in other traffic, or on another simulator."""
    from experiments.study.policies import load_agent

    assert cell.test_on is not None
    parent = store.cells / cell.parent.name
    if not (parent / WEIGHTS).exists():
        raise UserError(
            f"the weights of {parent.name} are not here: train it first, by the same command without --cell"
        )
    env, policy = load_agent(cell.key(), cell.source, parent / WEIGHTS, env)
    meter = Meter(beat, cell.work * TEST_EPISODE)
    clock = Clock()
    table = evaluate(
        env, policy, cell.task, cell.level, int(cell.test_on["episodes"]), lambda: meter.add(TEST_EPISODE),
        traffics=cell.test_on["traffics"], first=cell.first_scenario,
    )  # fmt: skip
    store.write(cell, {"timing": clock.test(cell.work), "provenance": provenance()}, {EPISODES: table})
    return ""


def _agent(cell: Cell, env: gym.Env[Any, Any], make_env: MakeEnv, store: Store, beat: Beat) -> str:
    import pandas as pd

    from experiments.study.policies import load_agent
    from experiments.study.train import (  # here: baselines need no learner
        CHECKPOINT,
        checkpoint_damage,
        train_cell,
    )

    scratch = store.work / cell.name
    scratch.mkdir(exist_ok=True)
    checkpoint, remark = scratch / CHECKPOINT, ""
    if (damage := checkpoint_damage(checkpoint)) is not None:
        remark = f"its checkpoint was damaged ({damage}) and put aside in {store.put_aside(checkpoint)}"
    meter = Meter(beat, cell.updates + cell.work * TEST_EPISODE)
    started, processed = time.monotonic(), time.process_time()
    if cell.training_config != cell.env_config:  # an environment of its own, closed before the test opens one
        own = make_env(cell.backend, cell.task, cell.training_config)
        try:
            agent = train_cell(cell, own, scratch, meter.add)
        finally:
            own.close()
    else:
        agent = train_cell(cell, env, scratch, meter.add)
    timing = {
        "train_seconds": time.monotonic() - started,  # of this process: a resumed cell's covers its last part
        "train_cpu_seconds": time.process_time() - processed,
        "timed_updates": agent.timed_updates,
    }
    agent.policy.save(scratch / WEIGHTS)
    tables = []
    for number, file in enumerate(agent.marks, start=1):
        try:
            seen, policy = load_agent(cell.key(), cell.source, file, env)
        except (UserError, OSError) as error:
            checkpoint.unlink(missing_ok=True)
            raise RuntimeError(
                f"the policy in {file.name} is lost ({error}): the training begins again"
            ) from None
        table = evaluate(
            seen,
            policy,
            cell.task,
            cell.level,
            cell.episodes,
            lambda: meter.add(TEST_EPISODE),
            first=cell.first_scenario,
        )
        table.insert(0, "mark", number)
        tables.append(table)
    record = {"learner": agent.learner, "timing": timing}
    files = {
        TRAINING: agent.episodes,
        MARKS: pd.concat(tables)[list(MARK_COLUMNS)],
        WEIGHTS: scratch / WEIGHTS,
    }
    _test(cell, agent.policy, observed(env, cell.profile), store, meter, record, files)
    return remark


def _test(
    cell: Cell,
    policy: Policy,
    env: gym.Env[Any, Any],
    store: Store,
    meter: Meter,
    record: dict[str, Any],
    files: dict[str, Any],
) -> None:
    """Test a policy and store its cell."""
    clock = Clock()

    def note() -> None:
        meter.add(TEST_EPISODE)

    first = cell.first_scenario
    table = evaluate(env, policy, cell.task, cell.level, cell.episodes, note, first=first)
    gates = evaluate(
        env,
        policy,
        cell.task,
        cell.level,
        cell.gate_episodes,
        note,
        purpose="gate",
        traffics=cell.gate_traffics,
        first=first,
    )
    work = 2 * cell.episodes + len(cell.gate_traffics) * cell.gate_episodes
    timing = {**record.get("timing", {}), **clock.test(work)}
    tables = {EPISODES: table, GATES: gates[list(GATE_COLUMNS)]}
    store.write(cell, {**record, "timing": timing, "provenance": provenance()}, {**tables, **files})
