"""The greedy policy of a trained network, and its file."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import nn

from agents.extra_column import with_column
from agents.files import DamagedFile, load_arrays, save_arrays


class Greedy:
    """The action of highest Q (the lowest number on a tie).

    ``network``: on the CPU, maps (1, ...) to (1, actions).
    """

    def __init__(self, network: nn.Module) -> None:
        self.network = network.eval()

    @torch.inference_mode()
    def q(self, observation: np.ndarray) -> np.ndarray:
        """Q of every action, (actions,), for one observation."""
        return self.network(torch.as_tensor(observation, dtype=torch.float32)[None])[0].numpy()

    def act(self, observation: np.ndarray) -> int:
        """The greedy action. Raises ValueError when its value is no finite number."""
        return best(self.q(observation))

    def reset(self, seed: int | None = None) -> None:
        """Nothing to do: a greedy policy has no state."""

    def save(self, path: str | Path) -> None:
        """Write the weights as an npz, an array each, by their names in the network."""
        save_arrays(path, {name: value.numpy() for name, value in self.network.state_dict().items()})

    @classmethod
    def load(cls, path: str | Path, network: nn.Module) -> "Greedy":
        """Read weights written by :meth:`save` into a network of the same kind.

        Raises ValueError when they belong to another one, DamagedFile when the file is damaged.
        """
        return cls(with_weights(network, load_arrays(path), path))


def with_weights(network: nn.Module, arrays: Mapping[str, np.ndarray], path: str | Path) -> nn.Module:
    """The network with weights that were read from a file.

    Raises ValueError when they belong to another network, DamagedFile when one is no finite number.
    """
    try:
        network.load_state_dict({name: torch.as_tensor(array) for name, array in arrays.items()})
    except (RuntimeError, TypeError) as error:
        raise ValueError(f"{path} holds the weights of another network: {error}") from error
    for name, weights in network.state_dict().items():
        if not torch.isfinite(weights).all():
            raise DamagedFile(f"{path}: the weights {name} are not finite; the agent cannot be used.")
    return network


def best(values: np.ndarray) -> int:
    """The number of the largest value. Raises ValueError when it is not finite; NaN counts as the largest."""
    action = int(values.argmax())
    if not math.isfinite(values[action]):
        raise ValueError(f"the network's value of action {action} is {values[action]}, not a finite number")
    return action


class Timed(Greedy):
    """A greedy policy that also observes the time: the share of ``steps`` actions that is over since `reset`."""

    def __init__(self, network: nn.Module, steps: int) -> None:
        super().__init__(network)
        self.steps, self._taken = steps, 0

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode at time 0."""
        self._taken = 0

    def act(self, observation: np.ndarray) -> int:
        """The greedy action at this time."""
        share = min(self._taken / self.steps, 1.0)
        self._taken += 1
        return super().act(with_column(observation, share))
