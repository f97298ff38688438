"""Several environments at once: one process with one SUMO for each, watched over and replaced if it dies.

    envs = gym.make_vec("sumo/highway-v0", num_envs=4, config={"vehicles_count": 20})

This is not gymnasium's `AsyncVectorEnv`, because that one raises EOFError out of a half-read step when a worker
dies, keeps the shared memory that a new worker would need to itself, and loads SUMO into the calling process.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Container, Mapping, Sequence
from contextlib import suppress
from ctypes import c_float
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from sumo_env.config import resolve
from sumo_env.interface import interface
from sumo_env.tasks import get_task
from sumo_env.worker import Job, work

Batch = NDArray[np.float32]

ATTEMPTS = 3  # to begin an episode in new workers, before giving up
GRACE = 5.0  # [s] for a worker to end by itself


class WorkerError(RuntimeError):
    """Workers cannot be started, or die again and again."""


class WorkerDied(Exception):
    """A worker is gone or silent."""


class SumoVectorEnv(VectorEnv[Batch, NDArray[np.int64], NDArray[Any]]):
    """`num_envs` environments of one task, each in a process of its own.

    Finished episodes are reset within the step (``AutoresetMode.SAME_STEP``): the observation returned is the next
    episode's first, the last one is in ``infos["final_obs"]``, its info in ``infos["final_info"]``.

    A worker that dies (a crash of SUMO, the system's out-of-memory killer) or does not answer within `timeout` is
    replaced. Its episode is reported truncated, with reward 0, with the last observation that was returned as
    ``final_obs``, and with ``infos["worker_died"]`` True (only then is there such a key). The new worker begins
    another episode, whose seed follows from the one given at `reset`.

    Args:
        num_envs: how many.
        task: highway, two-way, roundabout, intersection or u-turn.
        config: as for one environment.
        render_mode: None or ``"rgb_array"``.
        timeout: longest time to wait for an answer [s].

    Raises:
        ConfigError: as for one environment.
        ValueError: `num_envs` is less than 1.
        WorkerError: the processes cannot be started.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (gymnasium's way)
        "render_modes": ["rgb_array"],
        "render_fps": 5,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        task: str,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        timeout: float = 300.0,
    ) -> None:
        self.closed = True  # until there are workers to close
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, not {num_envs}")
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.timeout = timeout
        self._task = get_task(task)
        self._config = resolve(task, self._task.defaults, config)
        offered = interface(self._task, self._config)
        self.single_observation_space = offered.observation_space
        self.single_action_space = offered.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        shape = (num_envs, *(self.single_observation_space.shape or ()))
        # spawned, not forked: a forked libsumo would share files with its parent
        self._context = multiprocessing.get_context("spawn")
        self._memory = self._context.RawArray(c_float, int(np.prod(shape)))
        self._table = np.ctypeslib.as_array(self._memory).reshape(shape)
        self._seen = np.zeros(shape, np.float32)  # what was returned last
        self._requests = 0
        self._seeds: list[int | None] = [None] * num_envs
        self._deaths = [0] * num_envs
        self._lost: dict[int, dict[str, Any]] = {}  # episodes lost between steps, for the next step to report
        self.closed = False
        self._workers = [self._start(index) for index in range(num_envs)]
        try:
            for index in range(num_envs):
                self._await_start(index)
        except WorkerError:
            self.close()
            raise

    # -- gymnasium -----------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Batch, dict[str, Any]]:
        """Start an episode in every environment; an integer seed means seed, seed + 1, ...

        Raises:
            ConfigError: ``options["config"]`` is not right.
            ValueError: wrong number of seeds, or a configuration with another observation or action space.
        """
        seeds = self._spread(seed)
        self._configure((options or {}).get("config"))
        self._seeds, self._deaths, self._lost = seeds, [0] * self.num_envs, {}
        infos: dict[str, Any] = {}
        for index, info in enumerate(self._ask("reset", [(one, options) for one in seeds])):
            if isinstance(info, WorkerDied):
                info = self._replace(index, info, seeds[index])
            infos = self._add_info(infos, info, index)
        return self._look(), infos

    def step(
        self, actions: Any
    ) -> tuple[Batch, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One policy step in every environment.

        Raises:
            ValueError: not one action of the action space for each environment.
        """
        arguments = [(action,) for action in self._checked(actions)]
        replies = self._ask("step", arguments, skip=self._lost)
        lost, self._lost = self._lost, {}
        rewards = np.zeros(self.num_envs)
        terminated, truncated = np.zeros((2, self.num_envs), np.bool_)
        infos: dict[str, Any] = {}
        for index, reply in enumerate(replies):
            if index in lost or isinstance(reply, WorkerDied):
                info = lost[index] if index in lost else self._lose(index, reply)
                truncated[index] = True
            else:
                rewards[index], terminated[index], truncated[index], info = reply
            infos = self._add_info(infos, info, index)
        return self._look(), rewards, terminated, truncated, infos

    def render(self) -> tuple[Any, ...] | None:
        """A picture of each environment."""
        return self.call("render")

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method, or get an attribute, of every environment."""
        return self._ask_all("call", [(name, args, kwargs)] * self.num_envs)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of every environment."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every environment to a value, or each to its own of a list; new workers forget it."""
        if not isinstance(values, list | tuple):
            values = [values] * self.num_envs
        if len(values) != self.num_envs:
            raise ValueError(f"{len(values)} values of {name!r} for {self.num_envs} environments")
        self._ask_all("set", [(name, value) for value in values])

    def close_extras(self, **kwargs: Any) -> None:
        """End the processes; `close` calls this."""
        for index in range(len(self._workers)):
            self._send(index, "close", ())
        for process, connection in self._workers:
            process.join(GRACE)
            _end(process, connection)

    # -- arguments -----------------------------------------------------------------------------------------

    def _spread(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + index for index in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"{len(seed)} seeds for {self.num_envs} environments")
        return list(seed)

    def _configure(self, config: Mapping[str, Any] | None) -> None:
        changed = resolve(self._task.name, self._task.defaults, self._config, config)
        offered = interface(self._task, changed)
        if (offered.observation_space, offered.action_space) != (
            self.single_observation_space,
            self.single_action_space,
        ):
            raise ValueError(
                "this configuration changes the observation or action space; make a new vector environment for it"
            )
        self._config = changed

    def _checked(self, actions: Any) -> list[int]:
        chosen = np.asarray(actions)
        if not np.issubdtype(chosen.dtype, np.integer) or not self.action_space.contains(chosen):
            raise ValueError(
                f"actions must be {self.num_envs} elements of {self.single_action_space}, not {actions!r}"
            )
        return [int(action) for action in chosen.tolist()]

    def _look(self) -> Batch:
        self._seen = self._table.copy()
        return self._seen.copy()

    # -- requests ------------------------------------------------------------------------------------------

    def _ask(
        self, command: str, arguments: Sequence[tuple[Any, ...]], skip: Container[int] = ()
    ) -> list[Any]:
        """The answers of all workers but some to a command; None of those, `WorkerDied` of the dead.

        An error that a worker reports is raised after all have answered: the next request finds them waiting.
        """
        if self.closed:
            raise gym.error.ClosedEnvironmentError("this vector environment has been closed")
        self._requests += 1
        asked = [index for index in range(self.num_envs) if index not in skip]
        for index in asked:
            self._send(index, command, arguments[index])
        replies: list[Any] = [None] * self.num_envs
        errors: list[Exception] = []
        for index in asked:
            try:
                error, replies[index] = self._receive(index, self._requests)
                if error is not None:
                    errors.append(error)
            except WorkerDied as died:
                replies[index] = died
        if errors:
            raise errors[0]
        return replies

    def _ask_all(self, command: str, arguments: Sequence[tuple[Any, ...]]) -> tuple[Any, ...]:
        """As `_ask`, and in place of a dead worker its successor answers; the next step tells of the loss."""
        replies = self._ask(command, arguments)
        for index, reply in enumerate(replies):
            if isinstance(reply, WorkerDied):
                self._lost[index] = self._lose(index, reply)
                others = set(range(self.num_envs)) - {index}
                replies[index] = self._ask(command, arguments, skip=others)[index]
        return tuple(replies)

    def _send(self, index: int, command: str, arguments: tuple[Any, ...]) -> None:
        with suppress(OSError):  # of a dead worker: noticed when it does not answer
            self._workers[index][1].send((self._requests, command, arguments))

    def _receive(self, index: int, number: int) -> tuple[Exception | None, Any]:
        """The error and the value in a worker's answer to request `number`.

        Raises:
            WorkerDied: there will be no answer.
        """
        process, connection = self._workers[index]
        try:
            while connection.poll(self.timeout):
                answered, error, value = connection.recv()
                if answered == number:  # else it is the answer to a request that Ctrl-C interrupted
                    return error, value
        except (EOFError, OSError):
            process.join(GRACE)
            raise WorkerDied(f"exit code {process.exitcode}") from None
        raise WorkerDied(f"no answer for {self.timeout:g} s")

    # -- workers -------------------------------------------------------------------------------------------

    def _start(self, index: int) -> tuple[BaseProcess, Connection]:
        ours, theirs = self._context.Pipe()
        job = Job(f"sumo/{self._task.name}-v0", self._config, self.render_mode, index, self._table.shape)
        process = self._context.Process(
            target=work, args=(theirs, self._memory, job), name=f"sumo_env-{index}", daemon=True
        )
        process.start()
        theirs.close()  # so that reading ends when the worker does
        return process, ours

    def _await_start(self, index: int) -> None:
        try:
            self._receive(index, 0)
        except WorkerDied as died:
            raise WorkerError(
                f"worker {index} could not be started ({died}); what it said is above. A script that makes a vector "
                "environment must do so under `if __name__ == '__main__':`, since every worker imports the script "
                "(start method spawn of multiprocessing). `python -m sumo_env.doctor` checks the installation."
            ) from None

    def _replace(self, index: int, died: WorkerDied, seed: int | None) -> dict[str, Any]:
        """Begin an episode in a new worker: its info."""
        for _ in range(ATTEMPTS):
            _end(*self._workers[index])
            self._workers[index] = self._start(index)
            self._await_start(index)
            self._send(index, "reset", (seed, None))
            try:
                error, info = self._receive(index, self._requests)
            except WorkerDied as again:
                died = again
                continue
            if error is not None:
                raise error
            reset_info: dict[str, Any] = info
            return reset_info
        raise WorkerError(f"worker {index} died {ATTEMPTS} times while beginning an episode ({died})")

    def _lose(self, index: int, died: WorkerDied) -> dict[str, Any]:
        """Replace a worker that died in the middle of an episode: the info of the step that reports it."""
        gym.logger.warn(f"worker {index} died ({died}); its episode is truncated, a new one goes on")
        self._deaths[index] += 1
        seed = self._seeds[index]
        if seed is not None:
            seed = int(np.random.SeedSequence((seed, self._deaths[index])).generate_state(1)[0])
        info = self._replace(index, died, seed)
        final = {"final_obs": self._seen[index].copy(), "final_info": {"worker_died": True}}
        return {**info, **final, "worker_died": True}


def _end(process: BaseProcess, connection: Connection) -> None:
    """See to it that a worker is gone."""
    if process.is_alive():
        process.kill()
        process.join(GRACE)
    connection.close()
