"""What the target network thinks of the stored next observations, computed once between two target copies."""

from __future__ import annotations

import numpy as np

from agents.network import Activations, Network
from agents.replay import Replay


class TargetValues:
    """The target network's Q-values of the next observations in a replay.

    The network changes only at a copy, while a transition is drawn many times between two of them. So its values
    are kept, for as long as there are fewer transitions than draws; beyond that, each batch is computed anew.

    The last bits of a product depend on its shape and on a row's place in it. Hence transitions are evaluated in
    blocks whose places in the replay are fixed: values are a function of the weights and the replay, whenever
    they are computed, and nothing needs to be kept in a checkpoint.

    target: the network; call :meth:`forget` when it has changed, or when the replay has been exchanged.
    lag: updates between two target copies. batch: transitions drawn in an update; also the size of a block.
    """

    def __init__(self, target: Network, replay: Replay, lag: int, batch: int) -> None:
        architecture = target.architecture
        self._target, self._replay, self._block, self._draws = target, replay, batch, lag * batch
        self._values = np.empty((replay.capacity, architecture.actions), np.float32)
        self._known = 0  # how many of the transitions ever added have been evaluated
        self._pass = Activations(architecture, batch)
        self._last_pass = Activations(architecture, replay.capacity % batch)  # the last block may be shorter

    def forget(self) -> None:
        """Evaluate everything anew when it is asked for."""
        self._known = 0

    def q(self, rows: np.ndarray) -> np.ndarray:
        """Q-values (batch, actions) of the next observations in these rows (batch,) of the replay."""
        if len(self._replay) > self._draws:
            return self._target.forward(self._replay.next_observations[rows], self._pass)
        if self._known < self._replay.added:
            self._evaluate()
        return self._values[rows]

    def _evaluate(self) -> None:
        """Evaluate the blocks that hold transitions added since the last time."""
        replay, block = self._replay, self._block
        new = np.arange(max(self._known, replay.added - replay.capacity), replay.added) % replay.capacity
        for start in np.unique(new // block) * block:
            observations = replay.next_observations[start : start + block]
            room = self._pass if len(observations) == block else self._last_pass
            self._values[start : start + block] = self._target.forward(observations, room)
        self._known = replay.added
