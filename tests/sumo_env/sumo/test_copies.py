"""Episodes that are copied: a copy goes on as the original does, to the last bit, and leaves nothing behind."""

import copy
import gc
import itertools
import os
import signal
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import libsumo
import numpy as np
import pytest

from sumo_env.env import DrivingEnv
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.simulator import SimulatorError
from sumo_env.sumo import pipe
from sumo_env.sumo.process import SimulatorDied, SumoProcess
from sumo_env.tasks import TASKS
from tests.processes import children, descriptors, ends
from tests.sumo_env.plans import needs_sumo
from tests.sumo_env.rollout import assert_same_bits, drive
from tests.sumo_env.scenarios import files
from tests.sumo_env.sumo.fake import COMMAND, FAKE, scenario


def to_the_end(*envs: Any, seed: int = 0) -> None:
    """Drive environments that are in one state by the same random actions, with equal results."""
    envs[0].action_space.seed(seed)
    actions = [envs[0].action_space.sample() for _ in range(100)]
    for first, *others in zip(*(drive(env, actions) for env in envs), strict=True):
        for other in others:
            assert_same_bits(other, first)
    first, *others = [env.unwrapped.np_random.bit_generator.state for env in envs]
    assert all(state == first for state in others)


@pytest.fixture
def begun() -> SumoProcess:
    """A worker, two steps into an episode of the fake simulator."""
    simulator = SumoProcess(FAKE)
    simulator.reset(scenario(3))
    for _ in range(2):
        simulator.step({"ego": COMMAND})
    return simulator


# -- the same to the last bit ------------------------------------------------------------------------------


def attribute_by_attribute(env: Any) -> Any:
    """As rl-agents' `safe_deepcopy_env` copies."""
    kind: Any = type(env)
    twin = kind.__new__(kind)
    for name, value in vars(env).items():
        copied = attribute_by_attribute(value) if isinstance(value, gym.Env) else copy.deepcopy(value, {})
        setattr(twin, name, copied)
    return twin


# Every day in risky traffic, before a release in all.
EVERY = itertools.product(TASKS, (0, -1), (0.0, 1.0), range(4))
CASES = [pytest.param(*case, marks=() if case[1:] == (0, 1.0, 2) else pytest.mark.long) for case in EVERY]


@pytest.mark.parametrize(("task", "level", "risk", "seed"), CASES)
def test_a_copy_goes_on_as_the_original(task: str, level: int, risk: float, seed: int) -> None:
    """Copies, a copy of a copy and one as rl-agents' planners make it, beside an environment that is never copied."""
    config = {**list(TASKS[task].levels.values())[level], "risk": risk}
    reference, env = (gym.make(f"sumo/{task}-v0", config=config) for _ in range(2))
    envs: list[Any] = [reference, env]
    for one in envs:
        one.reset(seed=seed)
        if any(result[2] for result in drive(one, seed * [1])):
            return
    envs += [attribute_by_attribute(env), copy.deepcopy(env)]
    envs.append(copy.deepcopy(envs[-1]))
    elsewhere = copy.deepcopy(env)
    elsewhere.step(0)
    to_the_end(*envs, seed=seed)
    first, *others = [one.reset(seed=seed + 1)[0] for one in envs[1:]]  # a copy can be reset
    assert all(np.array_equal(first, other) for other in others)


def begun_in(env: Any) -> Any:
    """Three steps into the second episode."""
    for seed in (4, 3):
        env.reset(seed=seed)
        for action in [env.action_space.sample() for _ in range(3)]:
            env.step(action)
    return env


def of_files(folder: Path, more: str = "", **config: Any) -> Any:
    file = files.written(folder, "static")
    file.write_text(file.read_text().replace("<time>", f"{more}<time>"))
    return begun_in(SumoDrivingEnv(file, ego_vehicle="ego", config={"duration": 12, **config}))


def handed_over() -> Any:
    env: Any = begun_in(DrivingEnv("highway"))
    env.hand_over()
    env.step(1)
    return env


def with_pictures(of: str) -> Any:
    kind = {"type": "GrayscaleObservation", "observation_shape": (32, 24), "stack_size": 2}
    seen = {**kind, "weights": [0.3, 0.6, 0.1], "scaling": 1.75}
    return begun_in(gym.make(f"{of}/u-turn-v0", config={"observation": seen}))


KINDS: dict[str, Callable[[Path], Any]] = {
    "SUMO drives since a hand-over": lambda _: handed_over(),
    "SUMO's own files, at risk": lambda folder: of_files(folder, risk=1.0),
    "SUMO with threads": lambda folder: of_files(folder, '<processing><threads value="2"/></processing>'),
    "pictures": lambda _: with_pictures("sumo"),
    "pictures of the replica": lambda _: with_pictures("replica"),
    "an agent that steers": lambda _: begun_in(gym.make(gym.spec("replica/intersection-v1"))),
}


@needs_sumo
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS)
def test_whatever_is_copied_goes_on(kind: str, tmp_path: Path) -> None:
    env = KINDS[kind](tmp_path)
    twin = copy.deepcopy(env)
    to_the_end(env, twin, copy.deepcopy(twin))
    for one in (env, twin):
        one.close()


# -- systems without the fork of a process -----------------------------------------------------------------------------


@pytest.fixture
def no_fork(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows and macOS: a process that has loaded SUMO is not forked."""
    monkeypatch.setattr(pipe, "FORKS", False)
    monkeypatch.setattr("sumo_env.sumo.process._Worker.fork", None)


def test_workers_and_copies_drive_the_same_episode(no_fork: None) -> None:
    """Without risk nothing is imagined."""
    ids = ["sumo/roundabout-v0"] * 2
    with closing(gym.make(ids[0])) as here, closing(gym.make(ids[1])) as there:
        for env in (here, there):
            env.reset(seed=3)
        envs: list[Any] = [here, there]
        for first, second in zip(*(drive(env, [1, 0, 2]) for env in envs), strict=True):
            assert_same_bits(first, second)
        copies = [copy.deepcopy(env) for env in envs]
        copies.append(copy.deepcopy(copies[0]))
        copies += [env.unwrapped.imagine(5) for env in envs]
        for first, *others in zip(*(drive(env, [3, 1, 4]) for env in (*envs, *copies)), strict=True):
            for other in others:
                assert_same_bits(first, other)
        for env in copies:
            env.close()


# -- what planners do --------------------------------------------------------------------------------------


def test_an_imagined_copy_has_the_past_and_another_future() -> None:
    env = DrivingEnv("u-turn", {"risk": 1.0, **TASKS["u-turn"].levels["12"]})
    env.reset(seed=8)
    for _ in range(2):
        env.step(1)
    same, first, second = env.imagine(1), env.imagine(1), env.imagine(env.scenario.seed)
    past = {event for event in env.scenario.events if event.time <= env.scene.time}
    for twin in (first, second):
        assert past == {*env.scenario.events} & {*twin.scenario.events} < {*twin.scenario.events}
    assert first.scenario == same.scenario != second.scenario != env.scenario
    endings = []
    for twin in (env, same, first, second):
        for _ in range(4):
            observation = twin.step(1)[0]
        endings.append(observation.tobytes())
    assert endings[1] == endings[2]
    assert len(set(endings)) > 1
    again = SumoProcess()  # an imagined episode is a scenario: driven from its start, it is the same
    again.reset(first.scenario)
    for commands in first._car.episode.commands:
        step = again.step(commands)
    np.testing.assert_array_equal(step.scene.x, first.scene.x)


def test_copies_keep_no_further_commands_however_long_an_episode_is() -> None:
    """A copy of each step of a planner's episode takes no more time and memory the later it is made."""
    env = DrivingEnv("highway", {"vehicles_count": 0, "policy_frequency": 10, "duration": 20})
    env.reset(seed=0)
    for _ in range(150):
        env.step(1)
    twin = copy.deepcopy(env)
    env.step(0)
    for _ in range(2):
        twin.step(1)
    assert (len(env._car.episode.commands), len(twin._car.episode.commands)) == (151, 152)
    simulators: list[Any] = [env._car.episode.simulator, twin._car.episode.simulator]
    calls = [call for simulator in simulators for call in simulator._calls]
    kept = {id(one) for each in (env, twin) for one in each._car.episode.commands}
    kept |= {id(arguments[0]) for name, arguments in calls if name == "step"}
    assert len(kept) == 153


def test_a_copy_may_be_made_before_the_first_episode() -> None:
    env = DrivingEnv("highway")
    early = copy.deepcopy(env)
    np.testing.assert_array_equal(env.reset(seed=0)[0], early.reset(seed=0)[0])


# -- ends --------------------------------------------------------------------------------------------------


def test_a_killed_original_leaves_its_copies_alone_and_a_killed_copy_the_others(begun: SumoProcess) -> None:
    twin, killed = copy.deepcopy(begun), copy.deepcopy(begun)
    os.kill(killed.pid, signal.SIGKILL)
    assert ends(killed.pid) and copy.deepcopy(begun).step({"ego": COMMAND}).scene.time == 3.0
    os.kill(begun.pid, signal.SIGKILL)
    assert ends(begun.pid)
    with pytest.raises(SimulatorDied, match="was killed by SIGKILL"):
        copy.deepcopy(begun)
    with pytest.raises(SimulatorDied, match="has ended"):
        copy.deepcopy(begun)
    third = copy.deepcopy(twin)
    assert third.step({"ego": COMMAND}).scene.time == twin.step({"ego": COMMAND}).scene.time == 3.0
    twin.close()
    assert third.step({"ego": COMMAND}).scene.time == 4.0


def test_copies_leave_no_process_and_no_descriptor(begun: SumoProcess) -> None:
    first = copy.deepcopy(begun)
    first.close()
    assert ends(first.pid)
    before = descriptors(), descriptors(begun.pid)  # the worker may close those of the first copy later
    pids = []
    for number in range(30):
        twin = copy.deepcopy(begun)
        pids.append(twin.pid)
        if number % 10 == 0:
            twin.step({"ego": COMMAND})
        if number % 2:
            twin.close()  # the others are forgotten, as rl-agents' planners do
    del twin
    gc.collect()
    assert all(ends(pid) for pid in pids)
    assert descriptors() <= before[0] and descriptors(begun.pid) <= before[1]
    assert begun.pid is not None and children(begun.pid) == []


# -- refusals ----------------------------------------------------------------------------------------------


def test_a_simulation_that_was_changed_through_libsumo_is_not_copied() -> None:
    env = DrivingEnv("highway")
    env.reset(seed=0)
    env.step(1)
    libsumo.vehicle.setSpeed("v0", 1.0)
    result = env.step(1)
    with pytest.raises(SimulatorError, match="changed through libsumo"):
        copy.deepcopy(env)
    assert not result[2]
    env.step(1)  # it goes on
