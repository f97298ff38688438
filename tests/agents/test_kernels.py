"""What the compiled parts do beyond their arithmetic, which test_dqn.py compares with autograd and torch's Adam."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from agents.dqn import DQN, DQNConfig
from agents.kernels import adam

TRAINED = """
from agents.dqn import DQN, DQNConfig
from tests.agents.test_dqn import fill
agent = DQN(DQNConfig(), 25, 5, seed=0)
fill(agent, 200)
for _ in range(5):
    agent.update()
print(agent.policy().sha256)
"""


def test_bits_do_not_depend_on_the_number_of_threads() -> None:
    root = Path(__file__).parents[2]
    seen = set()
    for threads in ("1", "2"):
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
        run = subprocess.run(
            [sys.executable, "-c", TRAINED],
            cwd=root,
            env=os.environ | dict.fromkeys(names, threads),
            capture_output=True,
            text=True,
            check=True,
        )
        seen.add(run.stdout)
    assert len(seen) == 1


def test_moments_of_a_dead_unit_vanish_instead_of_becoming_denormal() -> None:
    weights, gradient = np.zeros((2, 3), np.float32)
    mean, square = np.full((2, 3), 1e-36, np.float32)
    numbers = map(np.float32, (1.0, 1e-3, 0.9, 0.999, 1.0, 1e-8))
    arguments = list(numbers)
    smallest = np.finfo(np.float32).tiny
    for _ in range(6000):
        adam(weights, gradient, mean, square, *arguments)
        for moment in (mean, square):
            assert ((moment == 0) | (moment >= smallest)).all()
    assert (mean == 0).all() and (square == 0).all()


def test_a_clamped_gradient_counts_as_its_bound() -> None:
    agents = [DQN(DQNConfig(gradient_clamp=0.25), 3, 2, seed=0) for _ in range(2)]
    for agent, size in zip(agents, (0.25, 7.0), strict=True):
        agent._gradient.flat[:] = size * np.resize([1, -1], agent.architecture.parameters)
        agent.updates = 1
        agent._adam_step()
    assert agents[0].policy().sha256 == agents[1].policy().sha256
