"""SUMO's own window (live="sumo-gui"), on a display that nobody sees."""

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import sumo_env
from sumo_env.env import DrivingEnv
from sumo_env.simulator import SimulatorError
from tests.processes import children, ends, python
from tests.sumo_env.plans import needs_sumo
from tests.sumo_env.rollout import drive

pytestmark = [
    needs_sumo,
    pytest.mark.skipif(not shutil.which("Xvfb"), reason="needs Xvfb: apt-get install xvfb"),
    pytest.mark.slow,
]
HURRIED = ["--delay", "0"]
IDLE = 1


@pytest.fixture(scope="module", autouse=True)
def display() -> Iterator[None]:
    """A display, found by a number that is free."""
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x900x24"]
    with (
        subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL) as server,
        pytest.MonkeyPatch.context() as patch,
    ):
        os.close(write)
        with os.fdopen(read) as number:
            patch.setenv("DISPLAY", f":{number.readline().strip()}")
        yield
        server.terminate()


def window_of(env: Any) -> int:
    """Process of the window of an environment."""
    (pid,) = children(env.unwrapped._car.episode.simulator.pid, "sumo-gui")
    return pid


def assert_equal(ours: Any, theirs: Any, seed: int, actions: list[int], risk: float) -> None:
    first = [env.reset(seed=seed, options={"config": {"risk": risk}})[0] for env in (ours, theirs)]
    assert np.array_equal(*first)
    for one, other in zip(drive(ours, actions), drive(theirs, actions), strict=True):
        assert np.array_equal(one[0], other[0]) and one[1:4] == other[1:4]


# Every day where SUMO changes lanes and where vehicles come and go, before a release everywhere.
EPISODES: list[Any] = [("sumo/highway-v0", 1), ("sumo/intersection-v0", 1)]
EPISODES += [pytest.param(id, 20, marks=pytest.mark.long) for id in sumo_env.IDS]


@pytest.mark.parametrize(("id", "seeds"), EPISODES)
def test_the_window_changes_nothing(id: str, seeds: int) -> None:
    made = gym.make(id, live="sumo-gui", sumo_options=HURRIED)
    env: Any = made.unwrapped
    with made as ours, gym.make(id) as theirs:
        for seed in range(seeds):
            actions = np.random.default_rng(seed).integers(env.action_space.n, size=100).tolist()
            assert_equal(ours, theirs, seed, actions, risk=float(seed % 2))
        assert env.sumo.vehicle.getColor("ego") == (0, 150, 255, 255)
        assert env.sumo.gui.getTrackedVehicle() == "ego"


def test_closing_the_window_ends_the_episode_and_the_next_one_has_none() -> None:
    env: Any = DrivingEnv("highway", live="sumo-gui", sumo_options=HURRIED)
    env.reset(seed=0)
    seen, *_ = env.step(IDLE)
    os.kill(window_of(env), signal.SIGTERM)
    with pytest.warns(UserWarning, match="SUMO's window was closed: this episode ends, and the next ones"):
        last, reward, terminated, truncated, info = env.step(IDLE)
    assert (terminated, truncated, info["distance"]) == (False, True, 0.0)
    assert np.array_equal(seen[1:], last[1:]) and np.isfinite(reward)
    with pytest.raises(SimulatorError, match="has ended; call reset"):
        env.step(IDLE)
    with DrivingEnv("highway") as other:
        assert_equal(env, other, 3, [IDLE] * 5, risk=0.0)
    env.close()


def test_a_window_ends_with_a_worker_that_is_killed() -> None:
    env: Any = DrivingEnv("two-way", live="sumo-gui")
    env.reset(seed=0)
    window = window_of(env)
    os.kill(env._car.episode.simulator.pid, signal.SIGKILL)
    assert ends(window)
    with pytest.raises(SimulatorError, match="killed by SIGKILL"):
        env.step(IDLE)
    env.close()


def test_a_script_that_ends_leaves_no_window() -> None:
    script = (
        "import gymnasium as gym, sumo_env; from tests.processes import children\n"
        "env = gym.make('sumo/u-turn-v0', live='sumo-gui'); env.reset(seed=0); env.step(1)\n"
        "print(children(env.unwrapped._car.episode.simulator.pid, 'sumo-gui')[0])"
    )
    assert ends(int(python("-c", script).split()[-1]))
