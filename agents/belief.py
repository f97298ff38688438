"""Which traffic is this? An estimate of the dose of risk from a driver's own tables, and a policy that acts by it.

`Estimator` reads the vehicles that `agents.rules.perception` follows from one table to the next, one by one, and
remembers what it has read. It is trained on episodes whose dose is known (`fit`) and needs none afterwards.
`Weighed` averages the Q-values of two trained agents (QMDP: Littman, Cassandra and Kaelbling 1995), `MoreCareful` takes
the action of one of them. Both read a column of the observation, which one of the wrappers adds: the estimate, the
estimate of another episode, or any number.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from agents.columns import Env, Observed
from agents.files import load_arrays, save_arrays
from agents.greedy import Greedy, best, with_weights
from agents.rules.perception import Perception, View
from agents.streams import stream

Rule = Sequence[float]  # sharpness and threshold of `sharpened`
EGO, VEHICLE = 7, 10  # numbers that are read of the ego and of each vehicle
WIDTH = 48
EPOCHS, BATCH, RATE = 15, 128, 3e-3


def features(view: View, vehicles: int) -> tuple[np.ndarray, np.ndarray]:
    """What an estimator reads of a view: (EGO,) of the ego and (vehicles, VEHICLE), rows of zeros where there is none.

    Ego: place on the map, direction, speed, curvature and sideways. Vehicles: present, place, direction, speed,
    turning, acceleration, drift, known; all near 1.
    """
    ego = [*view.origin / 100, np.cos(view.heading), np.sin(view.heading)]
    ego += [view.speed / 20, view.curvature * 10, view.sideways / 3]
    columns = [np.ones(len(view.speeds)), *view.positions.T / 50, np.cos(view.headings)]
    columns += [np.sin(view.headings), view.speeds / 20, view.turning, view.acceleration / 5]
    columns += [view.drift / 3, view.known]
    others = np.zeros((vehicles, VEHICLE), np.float32)
    others[: len(view.speeds)] = np.stack(columns, axis=1)
    return np.array(ego, np.float32), others


class Estimator(nn.Module):
    """Logit of the dose being 1 and not 0, after each table of an episode.

    traces: estimates in other episodes (episodes, steps), half of each dose, for `ShuffledObserved`.
    """

    traces: Tensor

    def __init__(self, traces: Tensor | None = None) -> None:
        super().__init__()
        self.register_buffer("traces", torch.full((1, 1), 0.5) if traces is None else traces)
        self.vehicle = nn.Sequential(nn.Linear(VEHICLE, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU())
        self.memory = nn.GRU(2 * WIDTH + EGO, WIDTH, batch_first=True)
        self.last = nn.Sequential(nn.Linear(WIDTH, WIDTH), nn.ReLU(), nn.Linear(WIDTH, 1))

    def forward(self, ego: Tensor, vehicles: Tensor, memory: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Logits (batch, time) of ego (batch, time, EGO) and vehicles (batch, time, n, VEHICLE), and the memory."""
        codes = self.vehicle(vehicles) * vehicles[..., :1]
        seen, memory = self.memory(torch.cat([codes.amax(-2), codes.mean(-2), ego], -1), memory)
        return self.last(seen)[..., 0], memory

    def save(self, path: Path) -> None:
        """Write weights and traces in half precision."""
        save_arrays(
            path, {name: value.numpy().astype(np.float16) for name, value in self.state_dict().items()}
        )

    @classmethod
    def load(cls, path: Path) -> Estimator:
        """Read what `save` wrote. Raises ValueError for another file, DamagedFile or FileNotFoundError."""
        arrays = load_arrays(path)
        estimator = cls(torch.zeros(arrays["traces"].shape) if "traces" in arrays else None)
        with_weights(estimator, arrays, path)
        return estimator.eval()


def fit(ego: Tensor, vehicles: Tensor, alive: Tensor, dose: Tensor, seed: int) -> Estimator:
    """An estimator trained on all tables of all episodes.

    Args:
        ego, vehicles: as `Estimator.forward` takes them. alive: whether the episode was not yet over (batch, time).
            dose: 0 or 1 (batch,).
    """
    torch.manual_seed(seed)
    estimator, label = Estimator(), dose[:, None].expand_as(alive)
    optimizer = torch.optim.Adam(estimator.parameters(), lr=RATE)
    batches = len(dose) // BATCH + 1
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, EPOCHS * batches)
    for _ in range(EPOCHS):
        for part in torch.randperm(len(dose)).chunk(batches):
            logits, _ = estimator(ego[part], vehicles[part])
            losses = nn.functional.binary_cross_entropy_with_logits(logits, label[part], reduction="none")
            optimizer.zero_grad()
            ((losses * alive[part]).sum() / alive[part].sum()).backward()
            optimizer.step()
            schedule.step()
    return estimator.eval()


def sharpened(belief: float, sharpness: float, threshold: float) -> float:
    """Weight of the second agent: 1/2 where the belief is at the threshold, and the steeper around it the sharper.

    With (1, .5) the weight is the belief itself; 32 is sharp enough for a switch.
    """
    second, first = (belief * (1 - threshold)) ** sharpness, ((1 - belief) * threshold) ** sharpness
    return second / (first + second)


class BeliefObserved(Observed):
    """Shows what an estimator says of the episode so far, as a weight by `sharpened` where a rule is given."""

    def __init__(self, env: Env, estimator: Estimator, rule: Rule = (1.0, 0.5)) -> None:
        super().__init__(env, self._see)
        self._perception, self._estimator, self._rule = Perception(env), estimator, rule
        self._memory: Tensor | None = None

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:  # gymnasium's checker looks for this name
        """Begin an episode without a memory."""
        self._perception.reset()
        self._memory = None
        return super().reset(**kwargs)

    @torch.inference_mode()
    def _see(self, table: np.ndarray) -> float:
        view = features(self._perception.look(table), len(table))
        logits, self._memory = self._estimator(
            *(torch.from_numpy(part)[None, None] for part in view), self._memory
        )
        return sharpened(float(torch.sigmoid(logits[0, 0])), *self._rule)


class ShuffledObserved(Observed):
    """Shows what the estimator has said in another episode, which the seed of `reset` draws."""

    def __init__(self, env: Env, estimator: Estimator, rule: Rule = (1.0, 0.5)) -> None:
        super().__init__(env, lambda _: sharpened(float(next(self._trace)), *rule))
        self._traces: Tensor = estimator.traces
        self._trace: Iterator[Tensor] = iter(())

    def reset(self, *, seed: int | None = None, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode. Of an episode longer than the other the last estimate stays."""
        row = self._traces[stream(seed or 0, "shuffled").integers(len(self._traces))]
        self._trace = chain(row, repeat(row[-1]))
        return super().reset(seed=seed, **kwargs)


class Weighed:
    """The action of highest (1 - w) Q1 + w Q2, where w is the last column of the ego's row and neither agent's own.

    The agents' weights are rounded to half precision, in which they are published; the agents given stay as they are.
    """

    def __init__(self, first: Greedy, second: Greedy) -> None:
        self._agents = in_half_precision(first), in_half_precision(second)

    def act(self, observation: np.ndarray) -> int:
        """The action. Raises ValueError when its value is no finite number."""
        weight, table = float(observation[0, -1]), observation[:, :-1]
        first, second = (agent.q(table) for agent in self._agents)
        return best((1 - weight) * first + weight * second)

    def reset(self, seed: int | None = None) -> None:
        """Nothing to do: what changes is observed."""


class MoreCareful:
    """The first agent's action at a low belief, the second's at a high one, and the more careful of both between.

    The belief is the last column of the ego's row and neither agent's own. No values are averaged, so that their scales
    do not matter. Weights are rounded as in `Weighed`.

    by_caution: the actions, the most careful first. unsure: the more careful action is taken from the first of these
        beliefs to the second.
    """

    def __init__(
        self,
        first: Greedy,
        second: Greedy,
        by_caution: Sequence[int],
        unsure: tuple[float, float] = (0.2, 0.8),
    ) -> None:
        self._agents = in_half_precision(first), in_half_precision(second)
        self._by_caution, self._unsure = by_caution, unsure

    def act(self, observation: np.ndarray) -> int:
        """The action. Raises ValueError when its value is no finite number."""
        belief, table = float(observation[0, -1]), observation[:, :-1]
        first, second = (agent.act(table) for agent in self._agents)
        low, high = self._unsure
        if low <= belief <= high:
            return min(first, second, key=self._by_caution.index)
        return first if belief < low else second

    def reset(self, seed: int | None = None) -> None:
        """Nothing to do: what changes is observed."""


def in_half_precision(agent: Greedy) -> Greedy:
    """The same agent with rounded weights."""
    network = copy.deepcopy(agent.network)
    for value in network.state_dict().values():
        value.copy_(value.half())
    return type(agent)(network)
