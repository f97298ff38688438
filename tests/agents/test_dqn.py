"""The learner against independent computations, exact values and known failures."""

import copy
import dataclasses
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional

from agents.dqn import DQN, DQNConfig
from agents.models import unflattened
from agents.replay_memory import Step, transitions
from tests.agents.networks import Noisy, Small

INPUTS, ACTIONS = 6, 3
Medium = partial(Small, hidden=(64, 48), stream=32)
SIZES: dict[str, Any] = {"n_steps": 1, "batch_size": 16, "replay_capacity": 200, "target_interval": 7}
SMALL = DQNConfig(**SIZES, tau=1.0, learning_rate_final=5e-4, standardise=False)


def make(config: DQNConfig = SMALL, seed: int = 0, network: Any = Small, inputs: int = INPUTS) -> DQN:
    space = gym.spaces.Box(-np.inf, np.inf, (inputs,), np.float32)
    return DQN(config, space, gym.spaces.Discrete(ACTIONS), seed, network)


def fill(agent: DQN, count: int) -> None:
    """Random transitions, a fifth of them terminal, with rewards so small that errors are below 1."""
    generator = np.random.default_rng(0)
    for _ in range(count):
        observation, after = generator.normal(size=(2, INPUTS))
        action, reward = int(generator.integers(ACTIONS)), 0.3 * generator.random()
        agent.remember([Step(observation, action, reward, after, bool(generator.random() < 0.2))])


def weights(module: nn.Module) -> np.ndarray:
    return nn.utils.parameters_to_vector(module.parameters()).detach().numpy().copy()


def attentive(config: DQNConfig) -> DQN:
    """An agent whose updates are by hand, and transitions in which some vehicles are not there."""
    space, actions = gym.spaces.Box(-1, 1, (4, INPUTS), np.float32), gym.spaces.Discrete(ACTIONS)
    agent = DQN(dataclasses.replace(config, network="attention"), space, actions, 1)
    assert agent._by_hand
    generator = np.random.default_rng(0)
    for _ in range(100):
        pair = generator.uniform(-1, 1, (2, 4, INPUTS))
        pair[:, generator.integers(1, 5) :] = 0.0
        action = int(generator.integers(ACTIONS))
        agent.remember([Step(pair[0], action, 0.3, pair[1], bool(generator.random() < 0.2))])
    agent.standardise()
    return agent


@pytest.mark.parametrize("by_hand", [False, True])
@pytest.mark.parametrize(("interval", "tau", "clip"), [(7, 1.0, False), (1, 0.05, False), (1, 0.05, True)])
def test_updates_are_those_of_the_algorithm_written_in_the_usual_way(
    interval: int, tau: float, clip: bool, by_hand: bool
) -> None:
    """Parameters of their own, double DQN, clipped norm, a falling learning rate, moves of the target network.

    With clip, goals stay in what rewards up to .3 allow, and values begin beyond it.
    """
    config = dataclasses.replace(
        SMALL,
        target_interval=interval,
        tau=tau,
        max_grad_norm=0.1,
        updates=20,
        learning_rate_final=0.0,
        clip_goals=clip,
    )
    agent = attentive(config) if by_hand else make(config, seed=1)
    if not by_hand:
        fill(agent, 150)
    for network in (agent.online, agent.target):
        inner: Any = network.network
        (inner.decision if by_hand else inner).value[-1].bias.data += 8.0 * clip
    before = weights(agent.online)
    online, target = (unflattened(network).requires_grad_() for network in (agent.online, agent.target))
    optimizer = torch.optim.Adam(online.parameters(), lr=5e-4)
    sampling = copy.deepcopy(agent._sampling)
    stored = agent.replay.arrays["rewards"][: len(agent.replay)]
    clipped = 0
    for update in range(20):
        s, action, reward, after, discount, _ = agent.replay.sample(sampling, config.batch_size)
        rows = torch.arange(len(action))
        with torch.no_grad():
            assert set(discount.tolist()) <= {0.0, float(np.float32(config.gamma))}
            goal = reward + discount * target(after)[rows, online(after).argmax(1)]
            if clip:
                beyond = goal > stored.max() / (1 - config.gamma)
                clipped += int(beyond.sum())
                goal[beyond] = float(stored.max()) / (1 - config.gamma)
        loss = functional.mse_loss(online(s)[rows, action], goal)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(online.parameters(), 0.1)
        optimizer.param_groups[0]["lr"] = 5e-4 * (1 - update / 20)
        optimizer.step()
        if (update + 1) % interval == 0:
            moved = (1 - tau) * torch.from_numpy(weights(target)) + tau * torch.from_numpy(weights(online))
            nn.utils.vector_to_parameters(moved, target.parameters())
        assert agent.update().item() == pytest.approx(loss.item(), rel=1e-4)
    np.testing.assert_allclose(weights(agent.online), weights(online), atol=1e-5)
    np.testing.assert_allclose(weights(agent.target), weights(target), atol=1e-5)
    assert np.abs(weights(agent.online) - before).max() > 1e-3
    assert agent.clipped == clipped and (clipped > 50) == clip


@pytest.mark.parametrize("n_steps", [1, 2, 3, 7])
def test_goals_of_several_steps_end_at_random_actions_and_at_ends(n_steps: int) -> None:
    """Against sums over the whole episode, for random episodes that crash or are cut."""
    generator, gamma = np.random.default_rng(n_steps), 0.9
    lengths = set()
    for _ in range(200):
        length, crashes = int(generator.integers(1, 9)), bool(generator.random() < 0.5)
        rewards, is_random = generator.normal(size=length), generator.random(length) < 0.3
        episode = [
            Step(np.array(k), k, rewards[k], np.array(k + 1), crashes and k == length - 1, bool(is_random[k]))
            for k in range(length)
        ]
        for start, found in enumerate(transitions(episode, gamma, n_steps, 20.0)):
            cuts = [k for k in range(start + 1, length) if is_random[k]]
            end = min([start + n_steps, length, *cuts[:1]])
            there = np.arange(start, end)
            assert found.reward == pytest.approx((gamma ** (there - start) * rewards[there]).sum())
            assert found.discount == pytest.approx(
                0.0 if crashes and end == length else gamma ** (end - start)
            )
            assert (found.observation, found.action, found.next_observation) == (start, start, end)
            assert found.left == 20.0 - start
            lengths.add(end - start)
    assert lengths == {*range(1, n_steps + 1)}


@pytest.mark.parametrize("value", [50.0, 1.0])
@pytest.mark.parametrize("by_hand", [False, True])
def test_goals_are_clipped_to_what_the_time_left_allows(by_hand: bool, value: float) -> None:
    """Each at its own limit: rewards of at most .3 in the steps from its observation to the horizon.

    Counted are those that exceed what a whole episode allows.
    """
    horizon = 6
    config = dataclasses.replace(SMALL, tau=0.05, horizon=horizon, batch_size=64)
    agent = attentive(dataclasses.replace(config, horizon=0)) if by_hand else make(config)
    agent.config, agent.horizon, agent.replay.added = config, horizon, 0
    generator = np.random.default_rng(0)
    for _ in range(30):
        seen = generator.uniform(-1, 1, (horizon + 1, *agent.replay.arrays["observations"].shape[1:]))
        agent.remember([Step(seen[k], 0, 0.3, seen[k + 1], k == horizon - 1) for k in range(horizon)])
    inner: Any = agent.target.network
    before = agent.target(torch.from_numpy(agent.replay.first(100))).mean().item()
    (inner.decision if by_hand else inner).value[-1].bias.data += value - before
    batch, rows = agent.replay.sample(copy.deepcopy(agent._sampling), config.batch_size), np.arange(64)
    chosen = agent.q(batch.next_observations.numpy()).argmax(1)
    with torch.no_grad():
        free = 0.3 + batch.discounts.numpy() * agent.target(batch.next_observations).numpy()[rows, chosen]
    limits = [sum(0.3 * config.gamma**k for k in range(int(left))) for left in batch.left]
    error = agent.q(batch.observations.numpy())[rows, batch.actions] - np.minimum(free, limits)
    assert agent.update().item() == pytest.approx(np.square(error).mean(), rel=1e-3)
    beyond, beyond_all = (int((free > most + 1e-6).sum()) for most in (np.array(limits), max(limits)))
    assert agent.clipped == beyond_all
    assert beyond_all < beyond if value == 1.0 else beyond_all == beyond > 30


@pytest.mark.parametrize(("length", "crashes"), [(6, False), (7, True)])
def test_a_horizon_beyond_which_episodes_go_on_is_refused(length: int, crashes: bool) -> None:
    agent = make(dataclasses.replace(SMALL, horizon=6))
    seen = np.zeros(INPUTS)
    with pytest.raises(ValueError, match=f"horizon is 6, but after {length} steps"):
        agent.remember([Step(seen, 0, 0.3, seen, crashes and k == length - 1) for k in range(length)])


def test_values_and_policy_of_a_known_decision_process() -> None:
    """Faster actions pay more and crash more often (terminal, no reward after)."""
    gamma, states = 0.9, 12
    generator = np.random.default_rng(0)
    features = generator.normal(size=(states, 8))  # one-hot inputs learn very slowly
    transitions = generator.dirichlet(np.ones(states) * 0.3, size=(states, ACTIONS))
    rewards = np.linspace(0.4, 1.0, ACTIONS) + 0.1 * generator.random((states, ACTIONS))
    crash = np.linspace(0.0, 0.35, ACTIONS) * generator.random((states, 1))
    expected = np.zeros_like(rewards)
    for _ in range(2000):
        expected = rewards + gamma * (1 - crash) * (transitions @ expected.max(1))
    config = DQNConfig(gamma=gamma, updates=2000, learning_rate=1.5e-3, batch_size=100, tau=0.03)
    agent = make(config, network=Medium, inputs=8)
    for _ in range(12_000):
        state, action = int(generator.integers(states)), int(generator.integers(ACTIONS))
        after = int(generator.choice(states, p=transitions[state, action]))
        crashed = bool(generator.random() < crash[state, action])
        agent.remember([Step(features[state], action, rewards[state, action], features[after], crashed)])
    agent.standardise()
    for _ in range(2000):
        agent.update()
    learnt = agent.q(features)
    assert np.abs(learnt - expected).mean() < 0.05 * expected.max()

    def worth(policy: np.ndarray) -> float:
        """Mean value over the states of a policy (states,), solved exactly."""
        rows = np.arange(states)
        step = gamma * (1 - crash[rows, policy])[:, None] * transitions[rows, policy]
        return float(np.linalg.solve(np.eye(states) - step, rewards[rows, policy]).mean())

    best = worth(expected.argmax(1))
    trivial = max(worth(rewards.argmax(1)), *(worth(np.full(states, action)) for action in range(ACTIONS)))
    assert trivial < 0.85 * best  # crashes must be weighed against speed
    assert worth(learnt.argmax(1)) > best - 0.25 * (best - trivial)


class Normed(Small):
    """With statistics of its inputs that no gradient moves."""

    def __init__(self, space: gym.spaces.Box, actions: int) -> None:
        super().__init__(space, actions)
        self.norm = nn.BatchNorm1d(INPUTS)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return super().forward(self.norm(x))


def test_the_target_network_takes_over_what_is_no_weight() -> None:
    agent = make(dataclasses.replace(SMALL, target_interval=1), network=Normed)
    fill(agent, 50)
    agent.update()
    online, target = (dict(network.named_buffers()) for network in (agent.online, agent.target))
    assert online["network.norm.running_mean"].abs().max() > 0.0
    assert all(torch.equal(value, target[name]) for name, value in online.items())


def test_a_policy_is_a_copy() -> None:
    agent = make()
    fill(agent, 50)
    policy = agent.policy()
    before = weights(policy.network)
    agent.update()
    np.testing.assert_array_equal(weights(policy.network), before)
    assert (weights(agent.policy().network) != before).any()
    assert all(p.untyped_storage().size() == 4 * p.numel() for p in policy.network.parameters())


def test_exploration_share_and_greedy_actions() -> None:
    agent = make(network=Noisy)  # whose dropout is off while acting
    fill(agent, 20)
    agent.update()
    observation = np.ones(INPUTS)
    best = int(agent.q(observation[None]).argmax())
    assert {agent.act(observation, 0.0) for _ in range(50)} == {(best, False)}
    actions, are_random = zip(*(agent.act(observation, 1.0) for _ in range(3000)), strict=True)
    assert np.abs(np.bincount(actions, minlength=3) - 1000).max() < 150 and all(are_random)
    greedy = np.mean([agent.act(observation, 0.3)[0] == best for _ in range(3000)])
    assert greedy == pytest.approx(0.8, abs=0.04)  # .7, and a third of the random .3


def test_epsilon_is_one_in_the_warm_up_and_then_decays_with_the_steps() -> None:
    config = DQNConfig(updates=1000, steps_per_update=4, warm_up=50, epsilon_decay=0.2)
    assert config.steps == 4050
    assert config.epsilon(0) == config.epsilon(50) == 1.0
    assert config.epsilon(850) == pytest.approx(0.1 + 0.9 / np.e)
    assert config.epsilon(1_000_000) == pytest.approx(0.1)
