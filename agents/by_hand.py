"""The attention network with its gradient written out: the mathematics of `agents.models` without torch's autograd.

The last bits differ, because sums are taken in another order.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from agents.models import EgoAttention, Standardised


class Layers:
    """The linear layers of a module, each followed by a ReLU, or all but the last (`linear_end`)."""

    def __init__(self, module: nn.Module, linear_end: bool = False) -> None:
        layers = [part for part in module.modules() if isinstance(part, nn.Linear)]
        self._layers = [(layer, layer.weight.t(), layer.bias) for layer in layers]
        self._rectified = [True] * (len(layers) - 1) + [not linear_end]
        self._values: list[Tensor] = []  # of the last call: the inputs of all layers, and the output

    def __call__(self, x: Tensor) -> Tensor:
        """The outputs (n, ...) of inputs (n, ...)."""
        self._values = [x]
        for (_, weight, bias), is_rectified in zip(self._layers, self._rectified, strict=True):
            x = x @ weight if bias is None else torch.addmm(bias, x, weight)
            self._values.append(x.relu_() if is_rectified else x)
        return x

    def backward(self, gradient: Tensor, onwards: bool = True) -> Tensor:
        """Write the gradients of the weights, from that of the first outputs of the last call.

        Returns the gradient of the inputs, if it is needed `onwards`.
        """
        n = len(gradient)
        for k, (layer, _, bias) in reversed(list(enumerate(self._layers))):
            if self._rectified[k]:
                gradient = torch.ops.aten.threshold_backward(gradient, self._values[k + 1][:n], 0)
            torch.mm(gradient.t(), self._values[k][:n], out=layer.weight.grad)
            if bias is not None:
                torch.sum(gradient, 0, out=bias.grad)
            if k or onwards:
                gradient = gradient @ layer.weight
        return gradient


class ByHand:
    """An `EgoAttention` behind standardised inputs, with the weights of the module, on the CPU."""

    def __init__(self, module: nn.Module) -> None:
        assert isinstance(module, Standardised) and type(module.network) is EgoAttention
        network, decision = module.network, module.network.decision
        self._module, self._heads = module, network.heads
        self._ego, self._others = Layers(network.ego), Layers(network.others)
        self._query, self._output = Layers(network.query, True), Layers(network.output, True)
        self._base = Layers(decision.base)
        self._value, self._advantage = Layers(decision.value, True), Layers(decision.advantage, True)

    def standardised(self, x: Tensor) -> Tensor:
        """Observations (n, vehicles, features) as `Standardised` shows them to its network."""
        return (x - self._module.mean) / self._module.deviation * (x != 0).any(2, keepdim=True)

    def __call__(self, x: Tensor) -> Tensor:
        """Q-values (n, actions) of standardised observations, see `EgoAttention`. For torch's inference mode."""
        ego, others = self._ego(x[:, 0]), self._others(x[:, 1:].flatten(0, 1))
        vehicles = torch.cat([ego[:, None], others.view(len(x), -1, ego.shape[1])], 1)
        query = self._query(ego).view(len(x), self._heads, -1)
        absent = (x == 0).all(2)
        absent[:, 0] = False
        scores = query @ vehicles.transpose(1, 2) / math.sqrt(vehicles.shape[2])
        weights = scores.masked_fill_(absent[:, None], -torch.inf).softmax(2)
        self._attended = vehicles, query, weights
        base = self._base((self._output((weights @ vehicles).flatten(1)) + ego) / 2)
        advantage = self._advantage(base)
        return self._value(base) + advantage - advantage.mean(1, keepdim=True)

    def backward(self, gradient: Tensor) -> None:
        """Write the gradients of all weights, from that of the first Q-values of the last call, (n, actions)."""
        n = len(gradient)
        base = self._value.backward(gradient.sum(1, keepdim=True))
        base = base + self._advantage.backward(gradient - gradient.mean(1, keepdim=True))
        ego = self._base.backward(base) / 2
        answer = self._output.backward(ego).view(n, self._heads, -1)
        vehicles, query, weights = (part[:n] for part in self._attended)
        scores = weights * (answer @ vehicles.transpose(1, 2))  # of the softmax
        scores = (scores - weights * scores.sum(2, keepdim=True)) / math.sqrt(vehicles.shape[2])
        seen = torch.cat([weights, scores], 1).transpose(1, 2) @ torch.cat([answer, query], 1)
        ego = ego + self._query.backward((scores @ vehicles).flatten(1)) + seen[:, 0]
        self._ego.backward(ego, onwards=False)
        self._others.backward(seen[:, 1:].flatten(0, 1), onwards=False)
