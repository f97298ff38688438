"""The learner against independent computations, exact values and known failures."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from torch.nn import functional

from agents.dqn import DQN, DQNConfig
from agents.streams import stream
from tests.agents.test_network import autograd_q

SMALL = DQNConfig(batch_size=16, hidden=(24, 16), stream=(12,), target_lag=7, replay_capacity=200)


def fill(agent: DQN, count: int, seed: int = 0) -> None:
    """Random transitions, a fifth of them terminal."""
    generator = np.random.default_rng(seed)
    inputs, actions = agent.architecture.inputs, agent.architecture.actions
    for _ in range(count):
        observation, after = generator.normal(size=(2, inputs))
        action, reward = int(generator.integers(actions)), float(generator.normal())
        agent.replay.add(observation, action, reward, after, bool(generator.random() < 0.2))


def weights(agent: DQN) -> np.ndarray:
    return agent.policy().weights


class AutogradDQN:
    """The same algorithm in the usual way: autograd, torch.optim.Adam, a target copy. Shares only the samples."""

    def __init__(self, agent: DQN) -> None:
        self.config, self.replay, self.architecture = agent.config, agent.replay, agent.architecture
        self.online = torch.nn.Parameter(torch.from_numpy(weights(agent).copy()))
        self.target = self.online.detach().clone()
        self.optimizer = torch.optim.Adam([self.online], lr=agent.config.learning_rate)
        self.sampling = stream(agent.seed, "replay")
        self.updates = 0

    def update(self) -> float:
        rows = self.replay.sample(self.sampling, self.config.batch_size)
        s, after, action, reward, terminated = (
            torch.from_numpy(getattr(self.replay, name)[rows])
            for name in ("observations", "next_observations", "actions", "rewards", "terminated")
        )
        with torch.no_grad():
            next_q = autograd_q(self.architecture, self.target, after)
            chooser = autograd_q(self.architecture, self.online, after) if self.config.double else next_q
            value = next_q[torch.arange(len(rows)), chooser.argmax(1)]
            goal = reward + self.config.gamma * value * (terminated == 0)
        predicted = autograd_q(self.architecture, self.online, s)[torch.arange(len(rows)), action]
        loss = functional.mse_loss(predicted, goal)
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_value_([self.online], self.config.gradient_clamp)
        self.optimizer.step()
        self.updates += 1
        if self.updates % self.config.target_lag == 0:
            self.target = self.online.detach().clone()
        return loss.item()


@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("head", ["mean", "sum"])
@pytest.mark.parametrize("clamp", [1.0, 0.01])
@pytest.mark.parametrize("stored", [150, 100])  # more transitions than draws between two copies, and fewer
def test_updates_equal_those_of_autograd_and_adam(double: bool, head: str, clamp: float, stored: int) -> None:
    config = dataclasses.replace(SMALL, double=double, head=head, gradient_clamp=clamp)
    agent = DQN(config, 6, 3, seed=1)
    fill(agent, stored)
    reference = AutogradDQN(agent)
    for _ in range(20):  # two target copies on the way
        agent.update()
        assert agent.loss() == pytest.approx(reference.update(), rel=1e-4)
    np.testing.assert_allclose(weights(agent), reference.online.detach().numpy(), atol=2e-5)
    assert np.abs(weights(agent) - DQN(config, 6, 3, seed=1).policy().weights).max() > 5e-3


def test_the_paper_network_takes_the_same_steps_as_autograd() -> None:
    agent = DQN(DQNConfig(), 25, 5, seed=0)
    fill(agent, 300)
    reference = AutogradDQN(agent)
    for _ in range(5):
        agent.update()
        assert agent.loss() == pytest.approx(reference.update(), rel=1e-4)
    np.testing.assert_allclose(weights(agent), reference.online.detach().numpy(), atol=5e-5)


def test_loss_is_that_of_stable_baselines3_with_squared_error() -> None:
    """SB3 computes r + gamma (1 - done) max Q_target(s') and smooth-L1, which is half the square below its beta."""
    agent = DQN(dataclasses.replace(SMALL, double=False, batch_size=64), 6, 3, seed=4)
    fill(agent, 200)
    architecture = agent.architecture
    vector = torch.from_numpy(weights(agent))
    rows = agent.replay.sample(stream(4, "replay"), 64)
    replay = agent.replay
    with torch.no_grad():
        next_q = autograd_q(architecture, vector, torch.from_numpy(replay.next_observations[rows]))
        rewards, dones = (torch.from_numpy(a[rows])[:, None] for a in (replay.rewards, replay.terminated))
        target = rewards + (1 - dones) * 0.99 * next_q.max(dim=1).values.reshape(-1, 1)
        q = autograd_q(architecture, vector, torch.from_numpy(replay.observations[rows]))
        current = torch.gather(q, dim=1, index=torch.from_numpy(replay.actions[rows])[:, None].long())
        expected = 2 * functional.smooth_l1_loss(current, target, beta=1e6) * 1e6
    agent.update()
    assert agent.loss() == pytest.approx(expected.item(), rel=1e-5)


def test_constant_reward_through_truncations_is_worth_one_over_one_minus_gamma() -> None:
    config = DQNConfig(
        gamma=0.9, hidden=(32,), stream=(16,), batch_size=32, target_lag=50, learning_rate=1e-3
    )
    agent = DQN(config, 3, 2, seed=0)
    states = np.random.default_rng(0).normal(size=(100, 3))
    for state, after in zip(states, np.roll(states, -1, axis=0), strict=True):
        for action in (0, 1):
            agent.replay.add(state, action, 1.0, after, terminated=False)
    for _ in range(4000):
        agent.update()
    values = np.array([agent.q(state).max() for state in states])
    assert values.mean() == pytest.approx(10.0, rel=0.02)
    np.testing.assert_allclose(values, 10.0, rtol=0.05)


def test_terminal_states_are_worth_nothing_beyond_their_reward() -> None:
    config = DQNConfig(hidden=(32,), stream=(16,), batch_size=32, target_lag=10, learning_rate=3e-3)
    agent = DQN(config, 3, 2, seed=0)
    for state in np.random.default_rng(0).normal(size=(50, 3)):
        for action, reward in ((0, -1.0), (1, 2.0)):
            agent.replay.add(state, action, reward, state, terminated=True)
    for _ in range(800):
        agent.update()
    values = np.array([agent.q(state) for state in agent.replay.observations[:100]])
    np.testing.assert_allclose(values, np.broadcast_to([-1.0, 2.0], values.shape), atol=0.15)


def risky_road(states: int = 12, actions: int = 3, seed: int = 0) -> tuple[np.ndarray, ...]:
    """A known Markov decision process: faster actions pay more and crash more often (terminal, no reward after).

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
    q = np.zeros_like(rewards)
    for _ in range(2000):
        q = rewards + gamma * (1 - crash) * (transitions @ q.max(1))
    return q


def test_values_and_policy_of_a_known_decision_process() -> None:
    gamma = 0.9
    features, transitions, rewards, crash = risky_road()
    expected = exact_q(transitions, rewards, crash, gamma)
    config = DQNConfig(gamma=gamma, hidden=(64, 48), stream=(32,), target_lag=50)
    agent = DQN(config, 8, 3, seed=0)
    generator = np.random.default_rng(1)
    for _ in range(20_000):
        state, action = int(generator.integers(12)), int(generator.integers(3))
        after = int(generator.choice(12, p=transitions[state, action]))
        crashed = bool(generator.random() < crash[state, action])
        agent.replay.add(features[state], action, rewards[state, action], features[after], crashed)
    for _ in range(4000):
        agent.update()
    learnt = np.array([agent.q(feature) for feature in features])
    assert np.abs(learnt - expected).mean() < 0.05 * expected.max()

    def worth(policy: np.ndarray) -> float:
        """Mean value over the states of a policy (states,), solved exactly."""
        rows = np.arange(12)
        step = gamma * (1 - crash[rows, policy])[:, None] * transitions[rows, policy]
        return float(np.linalg.solve(np.eye(12) - step, rewards[rows, policy]).mean())

    best = worth(expected.argmax(1))
    trivial = max(worth(rewards.argmax(1)), *(worth(np.full(12, action)) for action in range(3)))
    assert trivial < 0.85 * best  # crashes must be weighed against speed
    assert worth(learnt.argmax(1)) > best - 0.25 * (best - trivial)


def test_equal_seeds_give_equal_bits_and_others_do_not() -> None:
    trained = []
    for seed in (3, 3, 4):
        agent = DQN(SMALL, 6, 3, seed)
        fill(agent, 100)
        for _ in range(10):
            agent.update()
        trained.append(agent.policy().sha256)
    assert trained[0] == trained[1] != trained[2]


@pytest.mark.parametrize("capacity", [200, 90])  # values of the target network are not kept, and are
def test_a_restored_agent_goes_on_bit_for_bit(capacity: int) -> None:
    config = dataclasses.replace(SMALL, replay_capacity=capacity)
    agent = DQN(config, 6, 3, seed=5)
    fill(agent, 250)  # the replay has wrapped
    for _ in range(11):
        agent.update()
    state = {name: array.copy() for name, array in agent.state_dict().items()}
    other = DQN(config, 6, 3, seed=99)
    fill(other, 300, seed=9)  # more than the state holds: nothing may be left of it
    other.update()
    other.load_state_dict(state)
    observation = np.ones(6)
    for each in (agent, other):
        fill(each, 30, seed=8)
        for _ in range(12):
            each.update()
    for name, array in agent.state_dict().items():
        np.testing.assert_array_equal(array, other.state_dict()[name], err_msg=name)
    assert [agent.act(observation, 0.5) for _ in range(20)] == [
        other.act(observation, 0.5) for _ in range(20)
    ]


def test_a_state_of_another_network_is_refused() -> None:
    with pytest.raises(ValueError, match="parameters in online"):
        DQN(SMALL, 6, 3, 0).load_state_dict(DQN(SMALL, 6, 4, 0).state_dict())


def test_exploration_share_and_greedy_actions() -> None:
    agent = DQN(SMALL, 6, 3, seed=0)
    observation = np.ones(6)
    best = int(np.argmax(agent.q(observation)))
    assert {agent.act(observation, 0.0) for _ in range(50)} == {best}
    counts = np.bincount([agent.act(observation, 1.0) for _ in range(3000)], minlength=3)
    assert np.abs(counts - 1000).max() < 150
    greedy = np.mean([agent.act(observation, 0.3) == best for _ in range(3000)])
    assert greedy == pytest.approx(0.8, abs=0.04)  # .7, and a third of the random .3


def test_epsilon_decays_with_the_budget() -> None:
    config = DQNConfig(updates=1000, epsilon_decay=0.2)
    assert config.epsilon(0) == 1.0
    assert config.epsilon(200) == pytest.approx(0.1 + 0.9 / np.e)
    assert config.epsilon(100_000) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"gamma": 1.0}, "gamma must lie between 0 and 1"),
        ({"gamma": 0.0}, "gamma must lie between 0 and 1"),
        ({"head": "median"}, "'median': choose one of mean, sum"),
        ({"learning_rate": 0.0}, "learning_rate must be greater than 0"),
        ({"gradient_clamp": float("nan")}, "gradient_clamp must be greater than 0"),
        ({"batch_size": 0}, "batch_size must be a whole number of at least 1"),
        ({"target_lag": 2.5}, "target_lag must be a whole number"),
        ({"updates": True}, "updates must be a whole number"),
        ({"epsilon_final": 0.5, "epsilon_start": 0.2}, "epsilon_final <= epsilon_start"),
        ({"hidden": ()}, "hidden layer"),
    ],
)
def test_settings_that_make_no_sense_are_refused(setting: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DQNConfig(**setting)


def test_an_update_without_experience_is_refused() -> None:
    with pytest.raises(ValueError, match="empty replay"):
        DQN(SMALL, 6, 3, 0).update()
