"""Check the installation: python -m sumo_env. It takes a few seconds.

Prints one line per check, and what to do if one fails. Exits with 0 if all is well, 1 if there is a problem. Nothing is
changed on the machine.
"""

import argparse
import platform
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np

import sumo_env
from sumo_env.sumo.process import SUMO_VERSION

GYMNASIUM = (1, 1)  # the oldest version


def gymnasium() -> str:
    """gymnasium is new enough; with an older one, later checks would fail for reasons that mislead."""
    if tuple(int(part) for part in gym.__version__.split(".")[:2]) < GYMNASIUM:
        least = ".".join(map(str, GYMNASIUM))
        raise RuntimeError(f"version {gym.__version__} is too old: pip install 'gymnasium>={least}'")
    return gym.__version__


def sumo() -> str:
    """libsumo can be imported and is the version that everything was measured with."""
    from sumo_env.sumo.engine import version

    if SUMO_VERSION not in version():
        raise RuntimeError(f"{version()} is not that of the drivers: pip install libsumo=={SUMO_VERSION}")
    return version()


def task(id: str) -> str:
    """One episode, twice, gives equal observations; how fast it goes."""
    with closing(gym.make(id)) as env:
        first, start = _episode(env), time.perf_counter()
        again = _episode(env)
        speed = (len(again) - 1) / (time.perf_counter() - start)
    if not np.array_equal(first, again):
        raise RuntimeError("the same seed gave two different episodes")
    return f"same seed, same episode; {speed:.0f} steps/s"


def _episode(env: gym.Env[np.ndarray, int]) -> np.ndarray:
    observations, over = [env.reset(seed=0)[0]], False
    while not over:
        observation, _, terminated, truncated, _ = env.step(1)
        observations.append(observation)
        over = terminated or truncated
    return np.array(observations)


def pictures() -> str:
    """A scene can be drawn."""
    with closing(gym.make(sumo_env.IDS[0], render_mode="rgb_array")) as env:
        env.reset(seed=0)
        picture = np.asarray(env.render())
    return f"{picture.shape[1]} x {picture.shape[0]} px"


def workers() -> str:
    """A second environment of a process, which has a worker process, drives the episode of the first one."""
    start = time.perf_counter()
    with closing(gym.make(sumo_env.IDS[0])) as here, closing(gym.make(sumo_env.IDS[0])) as there:
        if not np.array_equal(_episode(here), _episode(there)):
            raise RuntimeError("a worker process drives another episode than this one with the same seed")
    return f"same episode; started and driven in {time.perf_counter() - start:.1f} s"


Check = tuple[str, Callable[[], str]]  # name, and a function that returns details or raises an exception
CHECKS: tuple[Check, ...] = (
    ("gymnasium", gymnasium),
    ("SUMO", sumo),
    *((sumo_env.task_of(id), partial(task, id)) for id in sumo_env.IDS),
    ("pictures", pictures),
    ("workers", workers),
)


def examine(checks: Sequence[Check]) -> int:
    """Make the checks in order, one line each; returns 0, or 1 at the first problem, after which none is made.

    Later checks rest on earlier ones, so one cause is reported once.
    """
    on = f"Python {platform.python_version()}, {platform.platform()}"
    print(f"sumo_env {sumo_env.__version__} in {Path(sumo_env.__file__).parent} on {on}")
    for name, check in checks:
        try:
            print(f"  ok    {name:14}{check()}", flush=True)
        except Exception as error:
            print(f"  FAIL  {name:14}{type(error).__name__}: {error}")
            print("if this does not help: install the package again, then report these lines")
            return 1
    print("all is well")
    return 0


if __name__ == "__main__":
    argparse.ArgumentParser("python -m sumo_env", description=__doc__).parse_args()
    sys.exit(examine(CHECKS))
