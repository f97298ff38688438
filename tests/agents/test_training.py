"""The training loop: budgets, reproducibility, interruption, and the failures it must make visible."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits

from agents.dqn import DQN, DQNConfig, Training, train
from agents.replay_memory import Replay, Step, Transition
from tests.agents import networks
from tests.agents.networks import Small, weights
from tests.experiments.fake_env import FakeEnv

SMALL = DQNConfig(
    f"{networks.__file__}:Small",
    updates=300,
    steps_per_update=1,
    n_steps=1,
    batch_size=16,
    warm_up=30,
    probe_interval=90,
)


def road(risk: float = 0.0) -> FakeEnv:
    return FakeEnv("u-turn", {"duration": 20, "risk": risk})


def network_of(env: FakeEnv, config: DQNConfig) -> Any:
    """What an agent has learned, whose statistics of the inputs a type checker does not know."""
    policy: Any = train(env, config, 0).policy
    return policy.network


def test_a_training_has_one_thread() -> None:
    """More would sum in another order. Of numba's products, too, which scipy's BLAS makes."""
    with threadpool_limits(2):
        train(road(), replace(SMALL, network="attention", updates=20), 0)
        found = {library["filepath"]: library["num_threads"] for library in threadpool_info()}
    assert set(found.values()) == {1} and any("scipy" in path for path in found)


def test_every_agent_gets_the_same_budget() -> None:
    config = replace(SMALL, steps_per_update=4, updates=110)
    agents = [train(road(dose), config, 0) for dose in (0.0, 0.9, 4.0)]
    for agent in agents:
        assert agent.record["updates"] == 110
        assert 0 <= agent.record["steps"] - config.steps < 20  # the last episode is played to its end
        assert agent.episodes["length"].sum() == agent.record["steps"] == agent.episodes["step"][-1]
    assert len({len(agent.episodes["episode"]) for agent in agents}) > 1


def test_inputs_are_standardised_with_the_warm_up_and_then_fixed() -> None:
    short, long = (network_of(road(), replace(SMALL, updates=updates)) for updates in (20, 100))
    np.testing.assert_array_equal(short.mean, long.mean)
    assert (short.mean != 0).any() and (short.deviation != 1).any()
    plain = network_of(road(), replace(SMALL, updates=20, standardise=False))
    assert (plain.mean == 0).all() and (plain.deviation == 1).all()


def test_goals_beyond_what_rewards_allow_are_clipped_and_counted() -> None:
    """A target network without lag diverges; clipped, its values stay where they can be, and the record says how."""
    config = replace(SMALL, updates=200, tau=1.0, gamma=0.99, standardise=False)
    free, clipped = (train(road(), replace(config, clip_goals=clip), 0) for clip in (False, True))
    assert "goals_clipped" not in free.record
    assert 90.0 < free.record["q_bound"] <= 1 / 0.01  # the fake environment pays at most 1
    rows = clipped.record["goals_clipped"]
    assert [row[0] for row in rows] == [row[0] for row in clipped.record["probe_q"]]
    assert all(0 <= share <= 1 for _, share in rows)
    agent = DQN(config, road().observation_space, road().action_space, 0, Small)
    seen = np.zeros((2, 5))
    agent.remember([Step(seen, 0, reward, seen, False) for reward in (-0.5, 0.25)])
    assert agent.bounds(agent.horizon) == pytest.approx((-50.0, 25.0))
    watched = Training(agent, road())
    for agent.updates, agent.clipped in ((10, 16), (14, 24)):
        watched.watch()
    size = config.batch_size
    assert watched.trained().record["q_bound"] == pytest.approx(50.0)  # of the least reward
    assert watched.goals_clipped == [[10, 16 / (10 * size)], [14, 8 / (4 * size)]]  # since the row before


def test_values_are_watched_on_the_first_observations() -> None:
    trained = train(road(), SMALL, 0)
    assert [row[0] for row in trained.record["probe_q"]] == [100, 180, 280, 300]
    env = road()
    again = Training(DQN(SMALL, env.observation_space, env.action_space, 0), env)
    again.play(SMALL.warm_up)  # the same random steps
    first = again.agent.replay.first(SMALL.warm_up)
    probe_size = len(first)
    watched = train(road(), replace(SMALL, probe_size=probe_size), 0)
    assert weights(watched.policy) == weights(trained.policy)  # watching changes nothing
    policy: Any = watched.policy
    values = np.array([np.abs(policy.q(observation)).max() for observation in first])
    assert watched.record["probe_q"][-1][1:] == pytest.approx([values.mean(), values.max()])


def test_the_time_limit_is_no_end_to_the_values() -> None:
    """Only a crash is stored as terminal: what comes after the last step of an episode is still expected."""
    env = road()
    agent = DQN(SMALL, env.observation_space, env.action_space, 0, Small)
    played = Training(agent, env)
    played.play(200)
    crashes, lengths = sum(played.env.rows["crashed"]), played.env.rows["length"]
    assert max(lengths) == 20
    assert crashes < len(lengths)
    assert (agent.replay.arrays["discounts"][: len(agent.replay)] == 0.0).sum() == crashes


def filled(capacity: int, count: int) -> Replay:
    replay = Replay(capacity, (2, 2))
    for i in range(count):
        seen, after = np.full((2, 2), i), np.full((2, 2), i + 1)
        replay.add(Transition(seen, i % 3, i / 10, after, float(i % 5 != 4), i))
    return replay


def test_sampling_is_uniform_over_what_is_stored() -> None:
    batch = filled(50, 20).sample(np.random.default_rng(0), 20_000)
    counts = np.bincount(batch.observations[:, 0, 0].int(), minlength=20)
    assert len(counts) == 20
    assert np.abs(counts - 1000).max() < 5 * np.sqrt(1000)


def test_the_oldest_transition_makes_room_and_a_batch_holds_whole_ones() -> None:
    batch = filled(10, 13).sample(np.random.default_rng(0), 200)
    number = batch.observations[:, 0, 0]
    assert sorted({*number.tolist()}) == list(range(3, 13))
    assert torch.equal(batch.next_observations[:, 1, 1], number + 1)
    assert torch.equal(batch.actions, number.long() % 3)
    torch.testing.assert_close(batch.rewards, number / 10)
    assert torch.equal(batch.discounts, (number % 5 != 4).float()) and torch.equal(
        batch.left, number.double()
    )
