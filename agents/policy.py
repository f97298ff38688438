"""Acting with a trained network: numpy only."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from agents.architecture import Architecture


def q_values(
    architecture: Architecture, layers: Sequence[tuple[np.ndarray, np.ndarray]], observation: np.ndarray
) -> np.ndarray:
    """Q of every action, float32 (actions,), for one observation of any shape.

    layers: (weight, bias) of every layer, see :meth:`Architecture.split`.
    """
    outputs = {-1: np.asarray(observation, dtype=np.float32).reshape(-1)}
    for index, (layer, (weight, bias)) in enumerate(zip(architecture.layers, layers, strict=True)):
        output = outputs[layer.source] @ weight
        output += bias
        outputs[index] = np.maximum(output, 0.0, out=output) if layer.relu else output
    value, advantage = outputs[architecture.value_output], output
    if architecture.head == "mean":
        advantage = advantage - advantage.mean()
    return value + advantage


class GreedyPolicy:
    """The action of highest Q. ``weights``: (architecture.parameters,); ValueError for another length."""

    def __init__(self, architecture: Architecture, weights: np.ndarray) -> None:
        self.architecture = architecture
        self.weights = np.array(weights, dtype=np.float32)
        self._layers = architecture.split(self.weights)

    def q(self, observation: np.ndarray) -> np.ndarray:
        """Q of every action, float32 (actions,). Raises ValueError when the observation has another size."""
        if np.size(observation) != self.architecture.inputs:
            shape, entries = np.shape(observation), self.architecture.inputs
            raise ValueError(f"Expected an observation with {entries} entries, got shape {shape}.")
        return q_values(self.architecture, self._layers, observation)

    def act(self, observation: np.ndarray) -> int:
        """The greedy action (the lowest index on a tie)."""
        return int(np.argmax(self.q(observation)))

    def reset(self, seed: int | None = None) -> None:
        """Nothing to do: a greedy policy has no state. Present so that every policy is driven alike."""

    @property
    def sha256(self) -> str:
        """Fingerprint of the weights."""
        return hashlib.sha256(self.weights.tobytes()).hexdigest()

    def save(self, path: str | Path) -> None:
        """Write an npz: the head, and each layer as "base.0.weight", ...; equal weights give equal bytes."""
        arrays = {"head": np.array(self.architecture.head)}
        for layer, (weight, bias) in zip(self.architecture.layers, self._layers, strict=True):
            arrays[f"{layer.name}.weight"], arrays[f"{layer.name}.bias"] = weight, bias
        with open(path, "wb") as file:  # a file object, because numpy would append .npz to a bare name
            np.savez(file, allow_pickle=False, **arrays)

    @classmethod
    def load(cls, path: str | Path) -> GreedyPolicy:
        """Read a policy written by :meth:`save`. Raises ValueError when the file holds no such network."""
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        try:
            architecture = _architecture_of(arrays)
            names = [f"{layer.name}.{kind}" for layer in architecture.layers for kind in ("weight", "bias")]
            parts = [arrays[name].ravel() for name in names]
        except KeyError as missing:
            raise ValueError(f"{path} holds no dueling network: {missing} is missing.") from missing
        return cls(architecture, np.concatenate(parts))


def _architecture_of(arrays: dict[str, np.ndarray]) -> Architecture:
    """Read the sizes off the shapes of the stored weights."""

    def widths(name: str) -> list[int]:
        count = sum(key.startswith(f"{name}.") and key.endswith(".weight") for key in arrays)
        if count == 0:
            raise KeyError(f"{name}.0.weight")
        return [arrays[f"{name}.{i}.weight"].shape[1] for i in range(count)]

    return Architecture(
        inputs=arrays["base.0.weight"].shape[0],
        actions=widths("advantage")[-1],
        hidden=tuple(widths("base")),
        stream=tuple(widths("advantage")[:-1]),
        head=str(arrays["head"]),
    )
