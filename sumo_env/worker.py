"""A process that drives one environment for `vector.SumoVectorEnv`; here alone is libsumo loaded for it.

Requests are (number, command, arguments), answers (number, error or None, value). Observations do not travel: they
are written into this worker's row of the shared table.
"""

from __future__ import annotations

import pickle
import signal
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import gymnasium as gym
import numpy as np

from sumo_env.config import Config


@dataclass(frozen=True)
class Job:
    """What a worker is started with.

    Attributes:
        id: of the environment.
        config: what the user changed, or the whole configuration.
        render_mode: as in ``gym.make``.
        row: of the table of observations that is this worker's.
        shape: of the table.
    """

    id: str
    config: Config
    render_mode: str | None
    row: int
    shape: tuple[int, ...]


def work(connection: Connection, memory: Any, job: Job) -> None:
    """Answer requests until told to close or until the other end is gone; `memory` is a shared array of floats."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    row = np.ctypeslib.as_array(memory).reshape(job.shape)[job.row]
    env = gym.make(job.id, config=job.config, render_mode=job.render_mode, disable_env_checker=True)
    connection.send((0, None, None))
    while True:
        try:
            number, command, arguments = connection.recv()
        except (EOFError, OSError):  # the parent has died
            return
        if command == "close":
            env.close()
            return
        try:
            answer = (number, None, _COMMANDS[command](env, row, *arguments))
            connection.send(answer)
        except Exception as error:
            connection.send((number, _portable(error, job.row), None))


def _reset(
    env: gym.Env[Any, Any], row: Any, seed: int | None, options: dict[str, Any] | None
) -> dict[str, Any]:
    row[:], info = env.reset(seed=seed, options=options)
    return info


def _step(env: gym.Env[Any, Any], row: Any, action: int) -> tuple[float, bool, bool, dict[str, Any]]:
    observation, reward, terminated, truncated, info = env.step(action)
    if terminated or truncated:
        final = {"final_obs": observation, "final_info": info}
        observation, info = env.reset()
        info = {**info, **final}
    row[:] = observation
    return float(reward), terminated, truncated, info


def _call(env: gym.Env[Any, Any], row: Any, name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    attribute = env.get_wrapper_attr(name)
    return attribute(*args, **kwargs) if callable(attribute) else attribute


def _set(env: gym.Env[Any, Any], row: Any, name: str, value: Any) -> None:
    env.set_wrapper_attr(name, value)


_COMMANDS: dict[str, Callable[..., Any]] = {"reset": _reset, "step": _step, "call": _call, "set": _set}


def _portable(error: Exception, row: int) -> Exception:
    """The error, or a likeness of it where it cannot be pickled, with its traceback as a note."""
    note = f"In worker {row}:\n{traceback.format_exc()}"
    try:
        error = pickle.loads(pickle.dumps(error))
    except Exception:
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.__notes__ = [note]  # add_note is not kept by every pickled exception
    return error
