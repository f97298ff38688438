"""The dueling network in training: forward and hand-written backward pass over a batch.

All parameters lie in one flat array, so that Adam and the target copy are one call each. The backward pass
is written by hand, and every buffer is allocated once: autograd's bookkeeping and fresh memory cost as much
as the arithmetic at this size. The gradient is tested against autograd.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike

from agents.architecture import Architecture
from agents.kernels import add_bias, back_through_bias, join_streams, split_gradient


class Activations:
    """Room for the layer outputs of one forward pass over ``rows`` observations.

    gradient_rows: how many of the first rows a backward pass differentiates.
    ranked_rows: how many of the last rows only the best action is wanted of. The value of a state does not
        change the order of its actions and is not computed for them: their ``q`` is the advantage.
    q: the Q-values (rows, actions) of the last forward pass.
    """

    def __init__(
        self,
        architecture: Architecture,
        rows: int,
        gradient_rows: int = 0,
        ranked_rows: int = 0,
        dtype: DTypeLike = np.float32,
    ) -> None:
        layers = architecture.layers
        shared, value = len(architecture.hidden), architecture.value_output
        self.outputs = [
            np.empty((rows - ranked_rows if shared <= index <= value else rows, layer.fan_out), dtype)
            for index, layer in enumerate(layers)
        ]
        self.deltas = [np.empty((gradient_rows, layer.fan_out), dtype) for layer in layers]
        self.spare = np.empty((gradient_rows, architecture.hidden[-1]), dtype)
        self.q = np.empty((rows, architecture.actions), dtype)


class Network:
    """One dueling network. ``flat``: its parameter vector; ``layers``: views (weight, bias) of it."""

    def __init__(self, architecture: Architecture, dtype: DTypeLike = np.float32) -> None:
        self.architecture = architecture
        self.flat = np.zeros(architecture.parameters, dtype)
        self.layers = architecture.split(self.flat)

    # Products are np.dot and not np.matmul, which takes ten times as long where an operand has one column.

    def forward(self, observations: np.ndarray, activations: Activations) -> np.ndarray:
        """Q-values (rows, actions) of observations (rows, inputs); the array belongs to ``activations``."""
        architecture, outputs = self.architecture, activations.outputs
        if len(observations) != len(outputs[-1]):
            raise ValueError(f"{len(observations)} observations for activations of {len(outputs[-1])} rows")
        for layer, (weight, bias), output in zip(architecture.layers, self.layers, outputs, strict=True):
            x = observations if layer.source < 0 else outputs[layer.source]
            np.dot(x[: len(output)], weight, out=output)
            add_bias(output, bias, layer.relu)
        value, advantage = outputs[architecture.value_output], outputs[-1]
        join_streams(value, advantage, architecture.head == "mean", activations.q)
        return activations.q

    def backward(
        self, observations: np.ndarray, activations: Activations, q_gradient: np.ndarray, gradient: Network
    ) -> None:
        """Write d(loss)/d(parameters) to ``gradient``, given d(loss)/dQ of the last forward pass.

        observations: (gradient_rows, inputs) and q_gradient: (gradient_rows, actions), the first rows of the
        forward pass; the rows after them carry no gradient.
        """
        architecture, deltas = self.architecture, activations.deltas
        outputs = [output[: len(q_gradient)] for output in activations.outputs]
        value, advantage = deltas[architecture.value_output], deltas[-1]
        split_gradient(q_gradient, architecture.head == "mean", value, advantage)
        reached: set[int] = set()
        for index, layer in reversed(list(enumerate(architecture.layers))):
            delta, weight = deltas[index], self.layers[index][0]
            x = observations if layer.source < 0 else outputs[layer.source]
            weight_gradient, bias_gradient = gradient.layers[index]
            back_through_bias(delta, outputs[index], layer.relu, bias_gradient)
            np.dot(x.T, delta, out=weight_gradient)
            if layer.source in reached:
                # The last shared layer feeds both streams: the second one adds to what the first one wrote.
                deltas[layer.source] += np.dot(delta, weight.T, out=activations.spare)
            elif layer.source >= 0:
                np.dot(delta, weight.T, out=deltas[layer.source])
                reached.add(layer.source)
