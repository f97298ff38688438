"""The same seed is the same episode, bit for bit, whatever happened before and in whichever process."""

import json
import os
import threading
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from sumo_env.env import DrivingEnv
from sumo_env.replica.env import ReplicaEnv
from sumo_env.tasks import TASKS
from tests.processes import children, descriptors, python
from tests.sumo_env.rollout import digest, record, rollout
from tests.tasks import every_task

CROWDED = {name: list(task.levels.values())[:2][-1] for name, task in TASKS.items()}
SHUFFLED = {"observation": {"type": "Kinematics", "order": "shuffled", "vehicles_count": 3}}
CASES = [(task, 5, {**CROWDED[task], "risk": risk}) for task in TASKS for risk in (0.0, 1.0)]
CASES.append(("u-turn", 5, SHUFFLED))


def test_in_another_process_and_another_order() -> None:
    """No state of SUMO, of numpy's global generator or of hash seeds leaks into an episode."""
    here = [digest(rollout(*case)) for case in CASES]
    digests = python("-m", "tests.sumo_env.rollout", json.dumps(CASES[::-1]), PYTHONHASHSEED="7").split()
    assert digests[::-1] == here


@every_task
def test_dose_zero_is_regular_traffic(task: str) -> None:
    """Also after a risky episode in the same environment, and as a number of another type."""
    regular = rollout(task, 3)
    np.testing.assert_array_equal(rollout(task, 3, {"risk": 0}), regular)
    env = DrivingEnv(task, {"risk": 1.0})
    assert not np.array_equal(record(env, 3), regular)
    env.configure({"risk": 0.0})
    np.testing.assert_array_equal(record(env, 3), regular)


@every_task
def test_agents_meet_the_same_scenarios(task: str) -> None:
    """What chance decides depends on the seed alone, not on the agent, on what it is shown, or on the simulator."""
    simulators: list[Any] = [DrivingEnv, partial(ReplicaEnv, scenarios="seeded")]
    configs: list[dict[str, Any]] = [{}, SHUFFLED, {"simulation_frequency": 15, "scaling": 5.0}]
    scenarios = []
    for make, config in product(simulators, configs):
        env = make(task, {"risk": 1.0, **config})
        env.reset(seed=8)
        drawn = [env.scenario]
        for _ in range(3):
            env.step(len(config))  # agents act differently
            env.reset()
            drawn.append(env.scenario)
        # how often a second is computed is the one thing that differs, and no matter of chance
        scenarios.append([replace(scenario, simulation_frequency=10) for scenario in drawn])
    assert all(drawn == scenarios[0] for drawn in scenarios)
    assert len(set(scenarios[0])) == 4  # without a seed, episodes differ


ENVIRONMENTS = 3  # one in this process and two in workers
BLOCKS, BLOCK = 8, 250  # episodes
BOUND = 8.0  # [MiB] that a process may grow after its first block
ENVS, STEPS = 64, 1_000_000  # of a batch


def episode(env: DrivingEnv, risk: int, seed: int) -> str:
    """Drive an episode under pseudo-random actions; returns the digest of all that was seen."""
    env.configure({"risk": float(risk)})
    return digest(record(env, seed))


def resident(pid: int) -> float:
    """Resident memory of a process [MiB]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


@pytest.mark.long
@every_task
def test_a_long_run(task: str) -> None:
    """Environments take turns, every second episode is risky; after each block all drive the same two episodes."""
    processes, opened = set(children(os.getpid())), descriptors()
    envs = [DrivingEnv(task) for _ in range(ENVIRONMENTS)]
    always: set[tuple[str, str]] = set()
    memory, open_files = [], []
    for block in range(BLOCKS):
        for number in range(block * BLOCK, (block + 1) * BLOCK):
            episode(envs[number % ENVIRONMENTS], number // ENVIRONMENTS % 2, number)
        always |= {(episode(env, 0, 0), episode(env, 1, 0)) for env in envs}
        workers = sorted(set(children(os.getpid())) - processes)
        memory.append([resident(pid) for pid in (os.getpid(), *workers)])
        open_files.append(descriptors())
    assert len(always) == 1
    assert all(after < before + BOUND for before, after in zip(memory[0], memory[-1], strict=True))
    assert open_files[-1] <= open_files[0]
    for env in envs:
        env.close()
    assert set(children(os.getpid())) <= processes
    assert descriptors() <= opened


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("scenarios", ["seeded", "highway-env"])
def test_a_batch_of_a_million_steps_costs_no_memory(scenarios: str) -> None:
    threads = threading.active_count()
    envs = gym.make_vec("sumo_env:replica/roundabout-v0", num_envs=ENVS, scenarios=scenarios, threads=2)
    envs.reset(seed=0)
    rng, memory = np.random.default_rng(0), []
    for count in range(STEPS // ENVS):
        envs.step(rng.integers(5, size=ENVS))
        if count % (STEPS // ENVS // BLOCKS) == 0:
            memory.append(resident(os.getpid()))
    envs.close()
    assert memory[-1] < memory[1] + BOUND, memory
    assert threading.active_count() == threads
