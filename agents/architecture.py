"""Sizes of the dueling network (Wang et al. 2016), as plain data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

HEADS = ("mean", "sum")


class Layer(NamedTuple):
    """One linear layer; ``source`` is the index of the layer it reads, -1 for the observation."""

    name: str
    fan_in: int
    fan_out: int
    source: int
    relu: bool


@dataclass(frozen=True)
class Architecture:
    """A shared base, then a value stream V (one output) and an advantage stream A (one output an action).

    inputs: length of the flattened observation.
    actions: number of discrete actions.
    hidden: widths of the shared layers (paper: 256, 192, 128).
    stream: widths of the hidden layers of each stream (paper: 2 x 128).
    head: "mean" is Q = V + A - mean_a A, which the paper's cited code (rl-agents) computes; "sum" is
        Q = V + A, which the paper prints, and where V and A are defined only up to a constant.

    Parameters lie in one vector: base, value stream, value output, advantage stream, advantage output, each
    layer as its weight (fan_in, fan_out) and its bias, so that a layer is ``x @ weight + bias``. All but the
    two outputs end in a ReLU. Raises ValueError for sizes below 1 or an unknown head.
    """

    inputs: int
    actions: int
    hidden: tuple[int, ...] = (256, 192, 128)
    stream: tuple[int, ...] = (128, 128)
    head: str = "mean"

    def __post_init__(self) -> None:
        if self.head not in HEADS:
            raise ValueError(f"Unknown head {self.head!r}: choose one of {', '.join(HEADS)}.")
        sizes = (self.inputs, self.actions, *self.hidden, *self.stream)
        if not all(type(size) is int and size >= 1 for size in sizes):
            raise ValueError(f"Layer sizes must be whole numbers of at least 1, got {sizes}.")
        if not self.hidden:
            raise ValueError("The shared base needs at least one hidden layer, got hidden=().")

    @cached_property
    def layers(self) -> tuple[Layer, ...]:
        """Every layer, in storage order."""
        base = (self.inputs, *self.hidden)
        layers = [Layer(f"base.{i}", base[i], base[i + 1], i - 1, True) for i in range(len(self.hidden))]
        for name, outputs in (("value", 1), ("advantage", self.actions)):
            widths = (base[-1], *self.stream, outputs)
            for i in range(len(widths) - 1):
                source = len(self.hidden) - 1 if i == 0 else len(layers) - 1
                layers.append(Layer(f"{name}.{i}", widths[i], widths[i + 1], source, i < len(self.stream)))
        return tuple(layers)

    @property
    def value_output(self) -> int:
        """Index of the layer that computes V; the last layer computes A."""
        return len(self.hidden) + len(self.stream)

    @property
    def parameters(self) -> int:
        """Number of weights and biases (147,526 for 25 inputs and 5 actions)."""
        return sum((layer.fan_in + 1) * layer.fan_out for layer in self.layers)

    def split(self, vector: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Views (weight, bias) of every layer of a parameter vector.

        Raises ValueError when its shape is not (parameters,).
        """
        if vector.shape != (self.parameters,):
            raise ValueError(f"Expected a vector of {self.parameters} parameters, got shape {vector.shape}.")
        views, start = [], 0
        for layer in self.layers:
            middle = start + layer.fan_in * layer.fan_out
            end = middle + layer.fan_out
            views.append((vector[start:middle].reshape(layer.fan_in, layer.fan_out), vector[middle:end]))
            start = end
        return views

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        """Initial parameters, float32 (parameters,): U(-b, b) with b = 1/sqrt(fan_in) for weights and biases.

        That is what ``torch.nn.Linear`` does by default (kaiming_uniform with a = sqrt(5)).
        """
        vector = np.empty(self.parameters, dtype=np.float32)
        for layer, (weight, bias) in zip(self.layers, self.split(vector), strict=True):
            bound = layer.fan_in**-0.5
            weight[...] = generator.uniform(-bound, bound, weight.shape)
            bias[...] = generator.uniform(-bound, bound, bias.shape)
        return vector
