"""The process that computes cells: one simulator, one thread, one cell at a time.

Runs in a spawned process, because libsumo holds one simulation a process and highway-env changes class
attributes. Talks to the engine through a pipe: jobs come in; progress, results and errors go out.
"""

from __future__ import annotations

import errno
import shutil
import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import gymnasium as gym

from experiments.study.claims import Claims, Heart
from experiments.study.evaluate import Policy, evaluate
from experiments.study.grid import Cell
from experiments.study.store import EPISODES, GATES, TRAINING, WEIGHTS, Store
from experiments.study.wrappers import observed
from experiments.support.errors import UserError, disk_error
from experiments.support.provenance import provenance

MakeEnv = Callable[..., gym.Env[Any, Any]]
# A write that fails for one of these fails for every cell: the sweep stops instead of trying again.
DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}
TEST_EPISODE = 10.0  # about as long as so many updates with their steps
REPORT_EVERY = 0.5  # [s] between two progress messages


@dataclass(frozen=True)
class Job:
    """A cell to compute. cost: expected seconds. attempts: how often it was begun in this sweep."""

    cell: Cell
    cost: float
    attempts: int = 0

    @property
    def simulator(self) -> tuple[str, ...]:
        """What a process must serve alone: highway-env's tasks change class attributes of each other."""
        backend, task = self.cell.backend, self.cell.task
        return (backend,) if backend == "sumo" else (backend, task)


@dataclass(frozen=True)
class Progress:
    """Share of the running job that is done, 0 to 1."""

    fraction: float


@dataclass(frozen=True)
class Done:
    """The job has ended: the cell is stored, or another process is computing it."""

    elsewhere: bool = False


@dataclass(frozen=True)
class Failed:
    """The job ended with an error. fatal: nothing else can succeed either; `message` is then for the user."""

    message: str
    details: str = ""
    fatal: bool = False


Send = Callable[[Any], None]


class Meter:
    """Sends the progress of a job, not too often. total: the work in updates."""

    def __init__(self, send: Send, total: float) -> None:
        self._send, self._total, self._done, self._last = send, total, 0.0, 0.0

    def add(self, amount: float) -> None:
        """Note that a piece of the work is done."""
        self._done += amount
        if time.monotonic() - self._last >= REPORT_EVERY:
            self._last = time.monotonic()
            self._send(Progress(min(self._done / self._total, 1.0)))


def main(connection: Connection, directory: Path, make_env: MakeEnv, parent: int) -> None:
    """Serve jobs until None comes or the engine is gone; the target of the spawned process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the engine decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    heart = Heart(parent)
    heart.start()
    try:
        while (job := connection.recv()) is not None:
            connection.send(attempt(job, directory, make_env, heart, connection.send))
    except (EOFError, ConnectionError):
        pass  # the engine was killed: the next sweep takes over from the last checkpoint
    heart.stop()


def attempt(job: Job, directory: Path, make_env: MakeEnv, heart: Heart, send: Send) -> Done | Failed:
    """Compute a job; errors become answers: fatal ones are for the user, others count as one failed try."""
    try:
        return Done(elsewhere=not compute(job.cell, Store(directory), make_env, heart, send))
    except UserError as error:
        return Failed(str(error), fatal=True)
    except OSError as error:
        if error.errno in DISK:
            return Failed(str(disk_error(error, directory)), fatal=True)
        return Failed(f"{type(error).__name__}: {error}", traceback.format_exc())
    except Exception as error:  # whatever goes wrong in one cell must not end the others
        return Failed(f"{type(error).__name__}: {error}", traceback.format_exc())


def compute(
    cell: Cell, store: Store, make_env: MakeEnv, heart: Heart | None = None, send: Send = lambda _: None
) -> bool:
    """Claim, compute and store a cell, unless it is stored already. False: another process holds it."""
    claim = Claims(store.directory / "claims").acquire(cell.name)
    if claim is None:
        return False
    if heart:
        heart.claims.append(claim)
    try:
        if not store.is_finished(cell):
            env = make_env(cell.backend, cell.task, dict(cell.env_config))
            try:
                (_agent if cell.kind == "agent" else _baseline)(cell, env, store, send)
            finally:
                env.close()
    finally:
        if heart:
            heart.claims.remove(claim)
        claim.release()
    return True


def _baseline(cell: Cell, env: gym.Env[Any, Any], store: Store, send: Send) -> None:
    from experiments.study.policies import untrained_policy

    meter = Meter(send, cell.work * TEST_EPISODE)
    _test(cell, untrained_policy(cell.key(), cell.source, env), env, store, meter, {}, {})


def _agent(cell: Cell, env: gym.Env[Any, Any], store: Store, send: Send) -> None:
    from experiments.study.train import train_cell  # here: baselines need no learner

    scratch = store.work / cell.name
    scratch.mkdir(exist_ok=True)
    meter = Meter(send, cell.updates + cell.work * TEST_EPISODE)
    started, processed = time.monotonic(), time.process_time()
    agent = train_cell(cell, env, scratch, meter.add)
    timing = {
        "train_seconds": time.monotonic() - started,  # of this process: a resumed cell's covers its last part
        "train_cpu_seconds": time.process_time() - processed,
        "timed_updates": agent.timed_updates,
    }
    agent.policy.save(scratch / WEIGHTS)
    record = {"learner": agent.learner, "timing": timing}
    files = {TRAINING: agent.episodes, WEIGHTS: scratch / WEIGHTS}
    _test(cell, agent.policy, observed(env, cell.profile), store, meter, record, files)
    shutil.rmtree(scratch)


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
    started, processed = time.monotonic(), time.process_time()

    def note() -> None:
        meter.add(TEST_EPISODE)

    table = evaluate(env, policy, cell.task, cell.level, cell.episodes, note)
    gates = evaluate(
        env,
        policy,
        cell.task,
        cell.level,
        cell.gate_episodes,
        note,
        purpose="gate",
        traffics=cell.gate_traffics,
    )
    timing = {
        **record.get("timing", {}),
        "test_episodes": cell.work,
        "test_seconds": time.monotonic() - started,
        "test_cpu_seconds": time.process_time() - processed,
        "finished": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    tables = {EPISODES: table, GATES: gates}
    store.write(cell, {**record, "timing": timing, "provenance": provenance()}, {**tables, **files})
