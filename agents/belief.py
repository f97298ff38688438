"""Which traffic is this? An estimate of the dose of risk from a driver's own tables, and a policy that acts by it.

`Estimator` reads the vehicles that `agents.rules.perception` follows from one table to the next, one by one, and
remembers what it has read. It is trained on episodes whose dose is known (`fit`) and needs none afterwards.
`Together` is two trained agents who drive as one. It reads the belief from a column of the observation, which one of
the wrappers adds: the estimate, the estimate of another episode, or any number.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from agents.extra_column import Env, Observed
from agents.files import load_arrays, save_arrays
from agents.greedy import Greedy, best, with_weights
from agents.rules.perception import Perception, View
from agents.streams import stream

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
    """Shows what an estimator says of the episode so far: how likely its dose is 1."""

    def __init__(self, env: Env, estimator: Estimator) -> None:
        super().__init__(env, self._see)
        self._perception, self._estimator = Perception(env), estimator
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
        return float(torch.sigmoid(logits[0, 0]))


class ShuffledObserved(Observed):
    """Shows what the estimator has said in another episode, which the seed of `reset` draws."""

    def __init__(self, env: Env, estimator: Estimator) -> None:
        super().__init__(env, lambda _: float(next(self._trace)))
        self._traces: Tensor = estimator.traces
        self._trace: Iterator[Tensor] = iter(())

    def reset(self, *, seed: int | None = None, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode. Of an episode longer than the other the last estimate stays."""
        row = self._traces[stream(seed or 0, "shuffled").integers(len(self._traces))]
        self._trace = chain(row, repeat(row[-1]))
        return super().reset(seed=seed, **kwargs)


class Rule(NamedTuple):
    """Which of two agents' actions is taken, given a belief.

    careful_steps: in so many first steps of an episode it is the more careful one. unsure: so it is at beliefs from the
    first of these to the second. weighed: everywhere else it is the action of highest (1 - w) Q1 + w Q2, with the
    weight w of `sharpened` (QMDP: Littman, Cassandra and Kaelbling 1995), this sharpness and threshold; None: the first
    agent's below .5, and the second's above.
    """

    careful_steps: int = 0
    unsure: Sequence[float] | None = None
    weighed: Sequence[float] | None = None


class Together:
    """Two agents who drive as one, by a rule and a belief: the last column of the ego's row, and neither agent's own.

    The agents' weights are rounded to half precision, in which they are published; the agents given stay as they are.

    by_caution: the actions, the most careful first.
    """

    def __init__(self, first: Greedy, second: Greedy, by_caution: Sequence[int], rule: Rule) -> None:
        self._agents = in_half_precision(first), in_half_precision(second)
        self._by_caution, self._rule, self._taken = by_caution, rule, 0

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode."""
        self._taken = 0

    def act(self, observation: np.ndarray) -> int:
        """The action. Raises ValueError when its value is no finite number."""
        belief, table, rule = float(observation[0, -1]), observation[:, :-1], self._rule
        first, second = (agent.q(table) for agent in self._agents)
        self._taken += 1
        low, high = rule.unsure or (1.0, 0.0)
        if self._taken <= rule.careful_steps or low <= belief <= high:
            return min(best(first), best(second), key=self._by_caution.index)
        if rule.weighed is None:
            return best(first if belief < 0.5 else second)
        weight = sharpened(belief, *rule.weighed)
        return best((1 - weight) * first + weight * second)


def in_half_precision(agent: Greedy) -> Greedy:
    """The same agent with rounded weights."""
    network = copy.deepcopy(agent.network)
    for value in network.state_dict().values():
        value.copy_(value.half())
    return type(agent)(network)
