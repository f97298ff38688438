"""What a driver reads of others' motion, the estimate that is made of it, and two agents who act by it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from agents.belief import (
    EGO,
    VEHICLE,
    BeliefObserved,
    Estimator,
    Rule,
    ShuffledObserved,
    Together,
    features,
    fit,
    sharpened,
)
from agents.extra_column import Observed
from agents.greedy import Greedy
from agents.rules.perception import Perception
from tests.agents.test_rules import road, scene
from tests.experiments.fake_env import make_env


def read(*scenes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is read of the last of some observations, one a second."""
    perception = Perception(road())
    return [features(perception.look(each), len(each)) for each in scenes][-1]


class TestFeatures:
    def test_a_change_of_lane_is_a_drift_whoever_changes_and_wherever_its_row_stands(self) -> None:
        """Two cars at 20 m/s, one of which goes 3 m to the left; their rows change places."""
        _, vehicles = read(scene((30, 0, 20), (50, 4, 20)), scene((45, 1, 20), (25, 0, 20)))
        assert vehicles[:2, -1].tolist() == [1, 1]  # known
        np.testing.assert_allclose(vehicles[:2, 1:3] * 50, [[45, 1], [25, 0]], atol=1e-3)
        np.testing.assert_allclose(vehicles[:2, -2] * 3, [-3, 0], atol=1e-3)

    def test_at_first_sight_nothing_is_known_of_a_vehicle(self) -> None:
        _, vehicles = read(scene((30, 0, 20)), scene((25, 0, 18), (90, 4, 30)))
        assert vehicles[:2, -1].tolist() == [1, 0]
        assert vehicles[1, -4:].tolist() == [0, 0, 0, 0]
        assert vehicles[0, -3] * 5 == pytest.approx(-2, abs=1e-3)  # [m/s2]
        assert not vehicles[2:].any()


@pytest.fixture(scope="module")
def estimator() -> Estimator:
    """One of episodes in which the vehicles drift at dose 1, from the third table on."""
    random = np.random.default_rng(0)
    dose = np.arange(1000) % 2
    vehicles = random.normal(0, 0.1, (1000, 6, 2, VEHICLE)).astype(np.float32)
    vehicles[..., 0] = 1
    vehicles[:, 2, 0, -2] += 3 * dose
    told = torch.from_numpy(dose).float()
    found = fit(torch.zeros(1000, 6, EGO), torch.from_numpy(vehicles), torch.ones(1000, 6), told, seed=0)
    found.traces = torch.tensor([[0.25, 0.5], [0.75, 1.0]])
    return found


class TestEstimator:
    def test_remembers_what_it_has_seen_once(self, estimator: Estimator) -> None:
        ego, vehicles = torch.zeros(2, 6, EGO), torch.zeros(2, 6, 2, VEHICLE)
        vehicles[..., 0] = 1
        vehicles[1, 2, 0, -2] = 3
        with torch.inference_mode():
            logits, _ = estimator(ego, vehicles)
        belief = torch.sigmoid(logits)
        assert (belief[1, 2:] > 0.9).all() and (belief[0, 2:] < 0.1).all()
        assert torch.allclose(belief[0, :2], belief[1, :2])

    def test_is_the_same_from_its_file_to_half_precision(self, estimator: Estimator, tmp_path: Path) -> None:
        estimator.save(tmp_path / "one.npz")
        again = Estimator.load(tmp_path / "one.npz")
        again.save(tmp_path / "two.npz")
        assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
        ego, vehicles = torch.randn(3, 6, EGO), torch.randn(3, 6, 2, VEHICLE)
        with torch.inference_mode():
            assert torch.allclose(estimator(ego, vehicles)[0], again(ego, vehicles)[0], atol=0.1)
        assert again.traces.tolist() == estimator.traces.tolist()


def seen(env: gym.Env[Any, Any], seed: int) -> list[float]:
    """What the column says in an episode of idling."""
    table, _ = env.reset(seed=seed)
    numbers = [float(table[0, -1])]
    for _ in range(4):
        table, *_ = env.step(1)
        numbers.append(float(table[0, -1]))
    return numbers


class TestColumns:
    def test_a_belief_depends_on_its_own_episode_alone(self, estimator: Estimator) -> None:
        env = BeliefObserved(make_env("sumo", "u-turn"), estimator)
        first = seen(env, 3)
        assert seen(env, 4) != first
        assert seen(env, 3) == first
        plain, perception = make_env("sumo", "u-turn"), Perception(env)
        tables = [plain.reset(seed=3)[0], *(plain.step(1)[0] for _ in range(4))]
        parts = zip(*(features(perception.look(table), 2) for table in tables), strict=True)
        with torch.inference_mode():
            logits, _ = estimator(*(torch.from_numpy(np.stack(part))[None] for part in parts))
        assert torch.sigmoid(logits[0]).tolist() == pytest.approx(first, abs=1e-6)

    def test_a_shuffled_belief_is_of_another_episode_that_the_seed_draws(self, estimator: Estimator) -> None:
        env = ShuffledObserved(make_env("sumo", "u-turn"), estimator)
        found = {tuple(seen(env, seed)) for seed in range(20)}
        assert found == {(0.25, 0.5, 0.5, 0.5, 0.5), (0.75, 1.0, 1.0, 1.0, 1.0)}
        assert seen(env, 3) == seen(env, 3)


class Fixed(torch.nn.Module):
    """Q-values that depend on the first number of the ego's row."""

    def __init__(self, *values: float) -> None:
        super().__init__()
        self.values = torch.nn.Parameter(torch.tensor(values))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        assert x.shape[2] == 5  # without the weight
        return x[:, 0, :1] * self.values


BY_CAUTION = (2, 1, 0)


def told(belief: float) -> np.ndarray:
    """The first table of an episode with this belief."""
    return Observed(make_env("sumo", "u-turn"), lambda _: belief).reset(seed=0)[0]


def preferring(first: int, second: int, rule: Rule) -> Together:
    """Two agents that prefer these actions."""
    one, two = (Greedy(Fixed(*(float(action == own) for action in range(3)))) for own in (first, second))
    return Together(one, two, BY_CAUTION, rule)


class TestWeighed:
    RULE = Rule(weighed=(1.0, 0.5))  # the weight is the belief itself

    @pytest.mark.parametrize(("weight", "action"), [(0.0, 0), (0.2, 0), (0.5, 1), (0.8, 2), (1.0, 2)])
    def test_the_mean_of_the_values_decides(self, weight: float, action: int) -> None:
        agents = Greedy(Fixed(1.0, 0.7, 0.0)), Greedy(Fixed(0.0, 0.7, 1.0))
        assert Together(*agents, BY_CAUTION, self.RULE).act(told(weight)) == action

    def test_the_belief_is_sharpened(self) -> None:
        """With (32, .3) a belief of .31 is enough for the second agent, and one of .29 for the first."""
        pair = preferring(0, 1, Rule(weighed=(32.0, 0.3)))
        assert [pair.act(told(belief)) for belief in (0.29, 0.31)] == [0, 1]

    def test_the_agents_are_those_that_are_published(self) -> None:
        """In half precision 1 and 1.0001 are one number, and the first action is taken."""
        network = Fixed(1.0, 1.0001, 0.3)
        table = np.ones((2, 6), np.float32)
        assert Greedy(network).act(table[:, :-1]) == 1
        assert Together(Greedy(network), Greedy(network), BY_CAUTION, self.RULE).act(table) == 0
        assert network.values.tolist() == torch.tensor([1.0, 1.0001, 0.3]).tolist()  # of the agent itself


class TestMoreCareful:
    @pytest.mark.parametrize(
        ("belief", "action"), [(0.0, 0), (0.19, 0), (0.21, 1), (0.5, 1), (0.79, 1), (0.81, 1), (1.0, 1)]
    )
    def test_while_the_belief_is_unsure_the_more_careful_action_is_taken(
        self, belief: float, action: int
    ) -> None:
        rule = Rule(unsure=(0.2, 0.8))
        assert preferring(0, 1, rule).act(told(belief)) == action
        # the second agent dares more
        assert preferring(1, 0, rule).act(told(belief)) == (0 if belief > 0.8 else 1)

    def test_a_pair_can_be_careful_at_first_in_every_episode(self) -> None:
        pair = preferring(0, 1, Rule(careful_steps=2, weighed=(3.0, 0.3)))
        for _ in range(2):
            pair.reset()
            assert [pair.act(told(belief)) for belief in (0.0, 0.0, 0.0, 1.0, 0.0)] == [1, 1, 0, 1, 0]


@pytest.mark.parametrize(
    ("belief", "rule", "weight"),
    [
        (0.3, (1.0, 0.5), 0.3),
        (0.3, (3.0, 0.3), 0.5),
        (0.6, (2.0, 0.5), 9 / 13),  # odds of 1.5 squared
        (0.31, (32.0, 0.3), 0.8),
        (0.0, (3.0, 0.3), 0.0),
        (1.0, (3.0, 0.3), 1.0),
    ],
)
def test_weights_of_a_belief(belief: float, rule: tuple[float, float], weight: float) -> None:
    assert sharpened(belief, *rule) == pytest.approx(weight, abs=0.02)
