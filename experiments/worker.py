"""The process that computes cells: one simulator, one thread, one job at a time.

Runs in a spawned process, because libsumo holds one simulation a process and highway-env changes class
attributes.
Talks to the engine through a pipe: jobs come in; progress, results and errors go out.
"""

from __future__ import annotations

import errno
import json
import shutil
import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import gymnasium as gym

from experiments.claims import Claims, Heart
from experiments.errors import UserError, disk_error
from experiments.evaluate import evaluate
from experiments.files import write_json
from experiments.grid import Cell
from experiments.jobs import Job, cohort_name
from experiments.provenance import provenance
from experiments.store import EPISODES, TRAINING, WEIGHTS, Store

MakeEnv = Callable[..., gym.Env[Any, Any]]
COHORT = "cohort.json"
# A write that fails for one of these fails for every cell: the sweep stops instead of trying again.
DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}
TEST_EPISODE = 10.0  # about as long as so many updates with their steps
REPORT_EVERY = 0.5  # [s] between two progress messages


@dataclass(frozen=True)
class Progress:
    """Share of the running job that is done, 0 to 1."""

    fraction: float


@dataclass(frozen=True)
class Done:
    """The job has ended: `busy` names cells that another process computes, all others are stored."""

    busy: tuple[str, ...] = ()


@dataclass(frozen=True)
class Failed:
    """The job ended with an error. fatal: nothing else can succeed either; `message` is then for the user."""

    message: str
    details: str = ""
    fatal: bool = False


@dataclass
class Meter:
    """Sends the progress of a job, not too often."""

    send: Callable[[Any], None]
    total: float
    done: float = 0.0
    _last: float = field(default=0.0)

    def add(self, amount: float) -> None:
        """Note that a piece of the work (in the unit of `total`) is done."""
        self.done += amount
        if time.monotonic() - self._last >= REPORT_EVERY:
            self._last = time.monotonic()
            self.send(Progress(min(self.done / self.total, 1.0)))


def main(connection: Connection, directory: Path, make_env: MakeEnv, parent: int) -> None:
    """Serve jobs until None comes or the engine is gone; the target of the spawned process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the engine decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    heart = Heart(parent)
    heart.start()
    try:
        while (job := connection.recv()) is not None:
            connection.send(_attempt(job, directory, make_env, heart, connection.send))
    except (EOFError, BrokenPipeError):
        pass  # the engine was killed: the next sweep takes over from the last checkpoint
    heart.stop()


def _attempt(
    job: Job, directory: Path, make_env: MakeEnv, heart: Heart, send: Callable[[Any], None]
) -> Done | Failed:
    try:
        return compute(job, Store(directory), make_env, heart, send)
    except UserError as error:
        return Failed(str(error), fatal=True)
    except OSError as error:
        if error.errno in DISK:
            return Failed(str(disk_error(error, directory)), fatal=True)
        return Failed(f"{type(error).__name__}: {error}", traceback.format_exc())
    except Exception as error:  # whatever goes wrong in one cell must not end the others
        return Failed(f"{type(error).__name__}: {error}", traceback.format_exc())


def compute(
    job: Job, store: Store, make_env: MakeEnv, heart: Heart, send: Callable[[Any], None] = lambda _: None
) -> Done:
    """Claim, compute and store the cells of a job; those that others hold are left out."""
    claims = Claims(store.directory / "claims")
    held = {cell.name: claim for cell in job.cells if (claim := claims.acquire(cell.name))}
    heart.claims += held.values()
    try:
        mine = [cell for cell in job.cells if cell.name in held]
        if mine:
            work = _agents if mine[0].kind == "agent" else _baselines
            work(mine, store, make_env, send)
    finally:
        heart.claims.clear()
        for claim in held.values():
            claim.release()
    return Done(tuple(cell.name for cell in job.cells if cell.name not in held))


def _baselines(cells: list[Cell], store: Store, make_env: MakeEnv, send: Callable[[Any], None]) -> None:
    from agents.rules import make_policy

    meter = Meter(send, total=sum(2 * cell.episodes for cell in cells))
    for cell in cells:
        if store.is_finished(cell):
            continue
        env = make_env(cell.backend, cell.task, dict(cell.env_config))
        try:
            _test(cell, make_policy(cell.policy, env), env, store, meter, {}, {})
        finally:
            env.close()


def _agents(cells: list[Cell], store: Store, make_env: MakeEnv, send: Callable[[Any], None]) -> None:
    unfinished = [cell for cell in cells if not store.is_finished(cell)]
    if not unfinished:
        return
    from experiments.train import train_cohort

    checkpoints = store.work / cohort_name(cells)
    if not checkpoints.exists():  # nothing to resume, so nothing ties the unfinished ones to the others
        cells, checkpoints = unfinished, store.work / cohort_name(unfinished)
    checkpoints.mkdir(exist_ok=True)
    write_json(checkpoints / COHORT, [cell.name for cell in cells])
    first = cells[0]
    test = 2 * first.episodes * TEST_EPISODE
    meter = Meter(send, total=len(cells) * (first.updates + test))
    env = make_env(first.backend, first.task, dict(first.env_config))
    try:
        started = time.monotonic()
        agents = train_cohort(cells, env, checkpoints, meter.add)
        seconds = (time.monotonic() - started) / len(cells)
        for cell, agent in zip(cells, agents, strict=True):
            if store.is_finished(cell):  # stored before the sweep was interrupted
                continue
            agent.policy.save(checkpoints / WEIGHTS)
            files = {TRAINING: agent.episodes, WEIGHTS: checkpoints / WEIGHTS}
            timing = {"train_seconds": seconds, "timed_updates": agent.timed_updates}
            _test(cell, agent.policy, env, store, meter, {"learner": agent.learner, "timing": timing}, files)
    finally:
        env.close()
    shutil.rmtree(checkpoints)


def _test(
    cell: Cell,
    policy: Any,
    env: gym.Env[Any, Any],
    store: Store,
    meter: Meter,
    record: dict[str, Any],
    files: dict[str, Any],
) -> None:
    """Test a policy and store its cell."""
    started = time.monotonic()
    weight = TEST_EPISODE if files else 1.0
    table = evaluate(env, policy, cell.task, cell.level, cell.episodes, lambda: meter.add(weight))
    timing = {**record.get("timing", {}), "test_seconds": time.monotonic() - started}
    timing["process_cpu_seconds"] = time.process_time()
    timing["finished"] = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    record = {**record, "timing": timing, "provenance": provenance()}
    store.write(cell, record, {EPISODES: table, **files})


def begun(directory: Path) -> list[list[str]]:
    """Names of the cells of each cohort that has a checkpoint."""
    cohorts = []
    for file in sorted((directory / "work").glob(f"*/{COHORT}")):
        try:
            cohorts.append(json.loads(file.read_text()))
        except (OSError, ValueError):  # another sweep finished or is just beginning it
            continue
    return cohorts
