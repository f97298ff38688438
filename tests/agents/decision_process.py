"""A known Markov decision process, its exact solution, and random experience in it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

Process = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def risky_road(states: int = 12, actions: int = 3, seed: int = 0) -> Process:
    """Faster actions pay more and crash more often (terminal, no reward after).

    Returns features (N(0, 1): one-hot inputs learn very slowly), transitions (s, a, s'), rewards (s, a) and crash
    probabilities (s, a).
    """
    generator = np.random.default_rng(seed)
    features = generator.normal(size=(states, 8))
    transitions = generator.dirichlet(np.ones(states) * 0.3, size=(states, actions))
    rewards = np.linspace(0.4, 1.0, actions) + 0.1 * generator.random((states, actions))
    crash = np.linspace(0.0, 0.35, actions) * generator.random((states, 1))
    return features, transitions, rewards, crash


def exact_q(transitions: np.ndarray, rewards: np.ndarray, crash: np.ndarray, gamma: float) -> np.ndarray:
    """Q of every state and action (s, a), by value iteration."""
    q = np.zeros_like(rewards)
    for _ in range(2000):
        q = rewards + gamma * (1 - crash) * (transitions @ q.max(1))
    return q


def experience(process: Process, count: int, seed: int) -> Iterator[tuple[Any, int, float, Any, bool]]:
    """Random transitions: observation, action, reward, next observation, terminated."""
    features, transitions, rewards, crash = process
    generator = np.random.default_rng(seed)
    for _ in range(count):
        state, action = int(generator.integers(len(features))), int(generator.integers(rewards.shape[1]))
        after = int(generator.choice(len(features), p=transitions[state, action]))
        crashed = bool(generator.random() < crash[state, action])
        yield features[state], action, float(rewards[state, action]), features[after], crashed
