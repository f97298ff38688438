"""Cells computed in processes, each once, and what is computed for one: train, test, store."""

import shutil
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

from experiments import backends
from experiments.backends import MakeEnv
from experiments.study.compute.evaluate import evaluate
from experiments.study.compute.executors import cores, open_executor
from experiments.study.compute.executors.local import TASKS_PER_PROCESS
from experiments.study.compute.policies import driver
from experiments.study.compute.progress import ProgressDisplay, costs, duration
from experiments.study.compute.run import Heartbeat, run
from experiments.study.design.arms import gate_traffics
from experiments.study.design.cell import Cell, learner_of, tested_on
from experiments.study.design.training_rules import TrainingRules
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
            where = cell.task, cell.level, range(first, first + n), traffics, purpose
            return evaluate(there, policy, *where, on_episode)

        episodes = table(seen, "test", cell.tested["traffics"], cell.tested["episodes"])
        if cell.test_on is not None:
            return {EPISODES: episodes}
        judged: Any = seen
        if has_values := "probe_q" in record:
            judged = Worth(seen, policy, learner_of(cell.key(), cell.source)[1].gamma, cell.rules)
        gates = table(judged, "gate", gate_traffics(cell.arm), cell.eval["gate_episodes"])
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


class Worth(gym.Wrapper[Any, Any, Any, Any]):
    """Notes, for each whole episode, the value of its first observation and the discounted sum of its rewards.

    Rewards are those of the training. At the time limit the value of the last observation is added, as in the
    learner's goals.

    Args:
        agent: that drives, a policy with Q-values. gamma: its discount.
    """

    def __init__(self, env: gym.Env[Any, Any], agent: Any, gamma: float, rules: TrainingRules) -> None:
        super().__init__(env)
        self._agent, self._gamma, self._rules = agent, gamma, rules
        self._rows: list[tuple[float, float]] = []

    def _value(self, observation: np.ndarray) -> float:
        return float(self._agent.q(observation).max())

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:  # gymnasium's checker looks for this name
        """Begin an episode."""
        observation, info = self.env.reset(**options)
        self._expected, self._got, self._discount = self._value(observation), 0.0, 1.0
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Add the reward."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._got += self._discount * (float(reward) + self._rules.crash_reward * info["crashed"])
        self._discount *= self._gamma
        if truncated and not terminated:
            self._got += self._discount * self._value(observation)
        if terminated or truncated:
            self._rows.append((self._expected, self._got))
        return observation, reward, terminated, truncated, info

    def record(self) -> dict[str, Any]:
        """Of the episodes so far: their number, the means of what was expected and got, and the latter's size.

        Which is the root of the mean of its square.
        """
        expected, got = np.array(self._rows, float).T
        return {
            "episodes": len(self._rows),
            "expected": float(expected.mean()),
            "got": float(got.mean()),
            "size": float(np.sqrt(np.square(got).mean())),
        }


def compute(
    cells: Sequence[Cell],
    directory: Path,
    make_env: MakeEnv = backends.make_env,
    executor: str = "local",
    workers: int | None = None,
) -> dict[str, str]:
    """Compute the cells that are not finished; returns the reason of each failure by the name of its cell.

    make_env: of `backends`, or another that is importable in other processes. executor, workers: see
    `executors.open_executor`.
    """
    store = Store(directory)
    tasks = {cell.name: CellTask(cell, directory, make_env) for cell in cells}
    there = {name for name, task in tasks.items() if task.done()}
    for name in there:  # where a kill left it
        shutil.rmtree(store.work / name, ignore_errors=True)
    sizes = {cell.name: sum(costs(cell)) for cell in cells}
    print(f"{len(tasks)} cells, {len(there)} of them finished before; results go to {directory}", flush=True)
    if executor == "local" and (left := sum(size for name, size in sizes.items() if name not in there)):
        number = workers or cores()
        print(f"about {duration(left / number)} with {number} processes on a common server", flush=True)
    # highway-env's tasks change class attributes of each other
    simulators = {name for cell in cells for name, _ in cell.simulated}
    per_process = 1 if "highway-env" in simulators else TASKS_PER_PROCESS
    failures: dict[str, str] = {}
    with closing(ProgressDisplay(store.work, sizes, there)) as progress:
        for kinds in (("agent", "baseline"), ("test",)):  # agents are tested elsewhere once all are trained
            batch = [task for name, task in tasks.items() if name not in there and task.cell.kind in kinds]
            if kinds == ("test",):
                batch = [task for task in batch if store.weights(task.cell.parent.name)]
            if batch:
                opened = open_executor(executor, workers, directory, per_process, len(batch))
                failures |= run(batch, *opened, progress)
    return failures
