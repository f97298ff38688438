"""Thousands of episodes in one process cost no memory, leave nothing behind and change nothing."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from sumo_env.env import DrivingEnv
from tests.processes import children, descriptors
from tests.sumo_env.rollout import digest, record
from tests.tasks import every_task

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
