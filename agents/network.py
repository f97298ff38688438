"""The dueling network in training: forward and hand-written backward pass over a batch.

All parameters lie in one flat tensor, so that Adam, the gradient clamp and the target copy are one call
each. The backward pass is written by hand, and every buffer is allocated once: autograd's bookkeeping and
fresh memory cost as much as the arithmetic at this size. The gradient is tested against autograd.
"""

from __future__ import annotations

import torch
from torch import Tensor

from agents.architecture import Architecture


class Activations:
    """Room for the layer outputs of one forward pass over ``rows`` observations.

    gradient_rows: how many of the first rows a backward pass differentiates.
    q: the Q-values (rows, actions) of the last forward pass.
    """

    def __init__(
        self,
        architecture: Architecture,
        rows: int,
        gradient_rows: int = 0,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self.outputs = [torch.empty(rows, layer.fan_out, dtype=dtype) for layer in architecture.layers]
        self.deltas = [
            torch.empty(gradient_rows, layer.fan_out, dtype=dtype) for layer in architecture.layers
        ]
        self.q = torch.empty(rows, architecture.actions, dtype=dtype)


class Network:
    """One dueling network. ``flat``: its parameter vector; ``layers``: views (weight, bias) of it."""

    def __init__(self, architecture: Architecture, dtype: torch.dtype = torch.float32) -> None:
        self.architecture = architecture
        self.flat = torch.zeros(architecture.parameters, dtype=dtype)
        self.layers = architecture.split(self.flat)

    def forward(self, observations: Tensor, activations: Activations) -> Tensor:
        """Q-values (rows, actions) of observations (rows, inputs); the tensor belongs to ``activations``."""
        architecture, outputs = self.architecture, activations.outputs
        for layer, (weight, bias), output in zip(architecture.layers, self.layers, outputs, strict=True):
            x = observations if layer.source < 0 else outputs[layer.source]
            torch.addmm(bias, x, weight, out=output)
            if layer.relu:
                output.relu_()
        value, advantage = outputs[architecture.value_output], outputs[-1]
        torch.add(value, advantage, out=activations.q)
        if architecture.head == "mean":
            activations.q.sub_(advantage.mean(-1, keepdim=True))
        return activations.q

    def backward(
        self, observations: Tensor, activations: Activations, q_gradient: Tensor, gradient: Network
    ) -> None:
        """Write d(loss)/d(parameters) to ``gradient``, given d(loss)/dQ of the last forward pass.

        observations: (gradient_rows, inputs) and q_gradient: (gradient_rows, actions), the first rows of the
        forward pass; the rows after them carry no gradient.
        """
        architecture, deltas = self.architecture, activations.deltas
        outputs = [output[: len(q_gradient)] for output in activations.outputs]
        torch.sum(q_gradient, -1, keepdim=True, out=deltas[architecture.value_output])
        deltas[-1].copy_(q_gradient)
        if architecture.head == "mean":
            deltas[-1].sub_(q_gradient.mean(-1, keepdim=True))
        reached: set[int] = set()
        for index, layer in reversed(list(enumerate(architecture.layers))):
            delta, weight = deltas[index], self.layers[index][0]
            if layer.relu:
                # Derivative of ReLU: 1 where its output is positive. This is the kernel that autograd uses.
                torch.ops.aten.threshold_backward.grad_input(delta, outputs[index], 0, grad_input=delta)
            x = observations if layer.source < 0 else outputs[layer.source]
            weight_gradient, bias_gradient = gradient.layers[index]
            torch.mm(x.t(), delta, out=weight_gradient)
            torch.sum(delta, 0, out=bias_gradient)
            if layer.source >= 0:
                # The last shared layer feeds both streams: the second one adds to what the first one wrote.
                below = deltas[layer.source]
                torch.addmm(below, delta, weight.t(), beta=layer.source in reached, out=below)
                reached.add(layer.source)
