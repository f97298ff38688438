"""The hand-written network against autograd, and acting against it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from agents.architecture import Architecture
from agents.network import Activations, Network
from agents.policy import GreedyPolicy

ARCHITECTURES = [
    Architecture(25, 5, head="mean"),
    Architecture(25, 5, head="sum"),
    Architecture(105, 3, head="mean"),
    Architecture(7, 2, hidden=(11,), stream=(13,), head="mean"),
    Architecture(3, 4, hidden=(5, 6), stream=(), head="sum"),
    Architecture(1, 1, hidden=(1,), stream=(2, 3, 4), head="mean"),
]


def autograd_q(architecture: Architecture, vector: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """The dueling network written with plain tensor algebra, for autograd."""
    start, parts = 0, []
    for layer in architecture.layers:
        weight = vector[start : start + layer.fan_in * layer.fan_out].view(layer.fan_in, layer.fan_out)
        start += layer.fan_in * layer.fan_out
        parts.append((weight, vector[start : start + layer.fan_out]))
        start += layer.fan_out
    base, stream = len(architecture.hidden), len(architecture.stream) + 1
    for weight, bias in parts[:base]:
        x = torch.relu(x @ weight + bias)
    heads = []
    for chain in (parts[base : base + stream], parts[base + stream :]):
        h = x
        for weight, bias in chain[:-1]:
            h = torch.relu(h @ weight + bias)
        heads.append(h @ chain[-1][0] + chain[-1][1])
    value, advantage = heads
    if architecture.head == "mean":
        advantage = advantage - advantage.mean(-1, keepdim=True)
    return value + advantage


@pytest.mark.parametrize("architecture", ARCHITECTURES, ids=str)
@pytest.mark.parametrize(("rows", "gradient_rows"), [(9, 9), (10, 5)])
def test_gradient_equals_autograd(architecture: Architecture, rows: int, gradient_rows: int) -> None:
    generator = torch.Generator().manual_seed(1)
    network, gradient = Network(architecture, np.float64), Network(architecture, np.float64)
    network.flat[:] = architecture.initial(np.random.default_rng(0))
    activations = Activations(architecture, rows, gradient_rows, dtype=np.float64)
    x = torch.randn(rows, architecture.inputs, generator=generator, dtype=torch.float64)
    weighting = torch.randn(gradient_rows, architecture.actions, generator=generator, dtype=torch.float64)
    for _ in range(2):  # twice: nothing may be left over from the pass before
        q = network.forward(x.numpy(), activations)
        network.backward(x.numpy()[:gradient_rows], activations, weighting.numpy(), gradient)
    vector = torch.from_numpy(network.flat.copy()).requires_grad_()
    expected = autograd_q(architecture, vector, x)
    (expected[:gradient_rows] * weighting).sum().backward()
    torch.testing.assert_close(torch.from_numpy(q), expected.detach(), rtol=0, atol=1e-10)
    torch.testing.assert_close(torch.from_numpy(gradient.flat), vector.grad, rtol=0, atol=1e-10)


@pytest.mark.parametrize("architecture", ARCHITECTURES, ids=str)
def test_ranked_rows_have_the_order_of_their_q_values_and_leave_the_others_alone(
    architecture: Architecture,
) -> None:
    network = Network(architecture, np.float64)
    network.flat[:] = architecture.initial(np.random.default_rng(0))
    x = np.random.default_rng(1).normal(size=(20, architecture.inputs))
    q = network.forward(x, Activations(architecture, 20, dtype=np.float64))
    ranked = network.forward(x, Activations(architecture, 20, ranked_rows=8, dtype=np.float64))
    np.testing.assert_allclose(ranked[:12], q[:12], atol=1e-12)
    np.testing.assert_array_equal(ranked[12:].argsort(1), q[12:].argsort(1))
    assert np.abs(ranked[12:] - q[12:]).max() > 1e-3


def test_paper_network_has_the_published_number_of_parameters() -> None:
    assert Architecture(25, 5).parameters == 147_526
    assert Architecture(35, 5).parameters == 150_086


def test_mean_head_centres_the_advantage_and_sum_head_does_not() -> None:
    vector = Architecture(4, 3).initial(np.random.default_rng(0))
    observation = np.arange(4.0)
    mean = GreedyPolicy(Architecture(4, 3, head="mean"), vector).q(observation)
    plain = GreedyPolicy(Architecture(4, 3, head="sum"), vector).q(observation)
    offsets = plain - mean
    np.testing.assert_allclose(offsets, offsets[0], atol=1e-6)
    assert abs(offsets[0]) > 1e-4


def test_initial_weights_follow_torch_linear() -> None:
    architecture = Architecture(50, 5)
    layers = architecture.split(architecture.initial(np.random.default_rng(0)))
    for layer, (weight, bias) in zip(architecture.layers, layers, strict=True):
        reference = torch.nn.Linear(layer.fan_in, layer.fan_out)
        bound = reference.weight.abs().max().item()
        assert np.abs(weight).max() == pytest.approx(bound, rel=0.05)
        assert np.abs(bias).max() <= layer.fan_in**-0.5
        if weight.size > 1000:
            assert weight.std() == pytest.approx(reference.weight.std().item(), rel=0.05)


def test_acting_agrees_with_the_forward_pass_of_training() -> None:
    for architecture in ARCHITECTURES:
        network = Network(architecture)
        vector = architecture.initial(np.random.default_rng(3))
        network.flat[:] = vector
        x = np.random.default_rng(0).standard_normal((20, architecture.inputs), np.float32)
        q = network.forward(x, Activations(architecture, 20))
        policy = GreedyPolicy(architecture, vector)
        for observation, expected in zip(x, q, strict=True):
            np.testing.assert_allclose(policy.q(observation), expected, atol=1e-5)
            assert policy.q(observation).dtype == np.float32


def test_a_vector_of_another_length_is_refused() -> None:
    architecture = Architecture(7, 3, hidden=(8,), stream=(9,))
    with pytest.raises(ValueError, match=f"{architecture.parameters} parameters"):
        architecture.split(np.zeros(architecture.parameters + 1))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"inputs": 0, "actions": 5}, "at least 1"),
        ({"inputs": 25, "actions": 5, "head": "max"}, "mean, sum"),
        ({"inputs": 25, "actions": 5, "hidden": ()}, "hidden layer"),
        ({"inputs": 25, "actions": 5, "stream": (128, -1)}, "at least 1"),
    ],
)
def test_impossible_sizes_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Architecture(**arguments)
