"""Networks: gradients, the mask of the attention, and standardised inputs."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from agents.compiled import Passes
from agents.models import DuelingMLP, EgoAttention, Standardised, flatten

SPACE = gym.spaces.Box(-1, 1, (6, 5), np.float32)
ACTIONS = 5


def table(vehicles: int, seed: int = 0, batch: int = 4) -> torch.Tensor:
    """Observations of the ego and so many others; the other rows are zeros."""
    x = torch.zeros(batch, *SPACE.shape)
    x[:, : vehicles + 1] = (
        torch.rand(batch, vehicles + 1, 5, generator=torch.Generator().manual_seed(seed)) + 0.1
    )
    return x


@pytest.fixture
def attention() -> EgoAttention:
    torch.manual_seed(0)
    return EgoAttention(SPACE, ACTIONS).eval()


def test_the_dueling_network_is_the_papers() -> None:
    network = DuelingMLP(gym.spaces.Box(-1, 1, (5, 5)), ACTIONS)
    shapes = [tuple(p.shape) for p in network.base.parameters() if p.ndim == 2]
    assert shapes == [(256, 25), (192, 256), (128, 192)]
    assert sum(p.numel() for p in network.parameters()) == 147_526
    inner = network.base(torch.ones(1, 25))
    advantage, value = network.advantage(inner), network.value(inner)
    q = network(torch.ones(1, 5, 5))
    torch.testing.assert_close(q.mean(), value[0, 0])  # the advantage has no mean
    torch.testing.assert_close(q - q.mean(), advantage - advantage.mean())


@pytest.mark.parametrize("others", [0, 2])
def test_absent_vehicles_have_no_weight_and_no_influence(attention: EgoAttention, others: int) -> None:
    x, there = table(others), others + 1
    weights = attention._attend(x)[2]
    assert weights.shape == (4, 2, 6)
    torch.testing.assert_close(weights.sum(2), torch.ones(4, 2))
    assert (weights[:, :, there:] == 0).all() and (weights[:, :, :there] > 0).all()
    torch.testing.assert_close(attention(x), attention(x[:, :there]))  # the rows may as well not be there
    assert torch.isfinite(attention(torch.zeros_like(x))).all()


def test_the_order_of_the_others_does_not_matter_and_the_ego_does(attention: EgoAttention) -> None:
    x = table(4)
    torch.testing.assert_close(attention(x[:, [0, 3, 1, 4, 2, 5]]), attention(x))
    assert (attention(x[:, [1, 0, 2, 3, 4, 5]]) - attention(x)).abs().max() > 1e-4


class Echo(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x


def test_vehicles_are_standardised_and_absent_ones_stay_zero() -> None:
    network = Standardised(Echo(), SPACE)
    x = table(3, batch=500)
    x[:, :, 0] = (x != 0).any(2).float()  # presence: constant, hence left as it is
    x[:, 0, 1] += 5
    x[::2, 3] = 0  # the third vehicle is there half of the time
    assert (network(x) == x).all()  # before anything is known
    network.fit(x)
    y = network(x)
    present = (x != 0).any(2)
    assert (y[~present] == 0).all()
    assert (y[:, :, 0] == x[:, :, 0]).all()
    ego, others = y[:, 0, 1:], y[:, 1:, 1:][present[:, 1:]]
    for rows in (ego, others):
        torch.testing.assert_close(rows.mean(0), torch.zeros(4), atol=1e-5, rtol=0)
        torch.testing.assert_close(rows.std(0), torch.ones(4), atol=1e-4, rtol=0)


def test_observations_of_another_shape_are_standardised_entry_by_entry() -> None:
    network = Standardised(Echo(), gym.spaces.Box(-1, 1, (3,)))
    x = torch.tensor([[0.0, 2.0, 7.0], [0.0, 4.0, 7.0]])
    network.fit(x)
    torch.testing.assert_close(network(x), torch.tensor([[0.0, -(0.5**0.5), 7.0], [0.0, 0.5**0.5, 7.0]]))


@pytest.mark.parametrize("others", [0, 3, 5])
def test_values_and_gradient_by_hand_are_those_of_autograd(others: int) -> None:
    """To the rounding of sums in another order; doubles would have to be compiled for this test alone."""
    torch.manual_seed(2)
    module = Standardised(EgoAttention(SPACE, ACTIONS), SPACE)
    module.fit(table(5, seed=3, batch=50))
    weights = flatten(module)
    x, gradient = table(others, batch=8), torch.rand(5, ACTIONS)
    expected = module(x)
    expected[:5].backward(gradient)
    wanted = weights.grad.clone()
    weights.grad.fill_(torch.nan)  # each is written
    passes = Passes(module, weights)
    values = passes(x.numpy())
    passes.backward(gradient.numpy())
    torch.testing.assert_close(torch.from_numpy(values), expected.detach(), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(weights.grad, wanted, rtol=1e-4, atol=1e-5)
    with pytest.raises(ValueError, match=r"Expected observations \(n, 6, 5\), got \(8, 7, 5\)"):
        passes(np.zeros((8, 7, 5)))
