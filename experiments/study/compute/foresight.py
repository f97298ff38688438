"""The best sequences of actions of an episode, by a beam search in copies of it that meet the future that will come.

What is found can be driven, so that its return is a lower bound of the best one, and a sequence without a crash shows
that there is one. That none is found does not show that there is none: the search keeps some states alone.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.streams import stream
from experiments.backends import make_env

if TYPE_CHECKING:
    from sumo_env.replica.vector import ReplicaVectorEnv

WIDTH = 256  # states that are kept after each policy step
# Of the states in one cell the one with the best return is kept.
PLACE, SPEED = 0.5, 0.25  # size of a cell [m], [m/s]


class Driven(NamedTuple):
    """A sequence of actions to the end of an episode, and its return."""

    value: float
    actions: str  # a digit each


class Found(NamedTuple):
    """The best sequence without a crash, and the best one that ends in a crash; None where none was found."""

    safe: Driven | None
    crashing: Driven | None

    @property
    def best(self) -> Driven:
        """The one with the higher return; every episode ends in one way or the other."""
        return max(filter(None, self), key=lambda driven: driven.value)


def batch_of_one(task: str, config: Mapping[str, Any]) -> "ReplicaVectorEnv":
    """An environment of the replica that can be copied; config: as of `make_env`."""
    from sumo_env.replica.vector import AutoresetMode, ReplicaVectorEnv  # here: not every command needs numba

    env: Any = make_env("replica", task, config).unwrapped
    return ReplicaVectorEnv(env, 1, AutoresetMode.DISABLED, 1)


def search(envs: "ReplicaVectorEnv", seed: int, risk: float, width: int = WIDTH) -> Found:
    """The best sequences of actions of the episode with this seed and dose of risk.

    After each policy step of all actions from all states, `width` states are kept, of different cells (place, speed,
    target speed and lane of the ego): half of them those with the best returns, half drawn from the others, since the
    best return is often that of an ego that cannot avoid a crash any more.

    Args:
        envs: as from `batch_of_one`.
    """
    rng, actions = stream(seed, "beam search"), np.arange(int(envs.single_action_space.n))  # type: ignore[attr-defined]
    best: dict[bool, Driven | None] = {False: None, True: None}
    kept, values, taken = np.zeros(1, np.int64), np.zeros(1), np.zeros((1, 0), np.int64)
    envs.reset(seed=seed, options={"config": {"risk": risk}})
    while len(kept):
        envs = envs.copies(np.repeat(kept, len(actions)))
        last = np.tile(actions, len(kept))
        _, rewards, terminated, truncated, infos = envs.step(last)
        values = np.repeat(values, len(actions)) + rewards
        taken = np.column_stack((np.repeat(taken, len(actions), axis=0), last))
        over = terminated | truncated
        for crashed, before in best.items():
            ends = np.flatnonzero(over & (infos["crashed"] == crashed))
            if len(ends) and (before is None or values[ends].max() > before.value):
                row = ends[values[ends].argmax()]
                best[crashed] = Driven(float(values[row]), "".join(map(str, taken[row])))
        kept = _chosen(np.flatnonzero(~over), values, envs, width, rng)
        values, taken = values[kept], taken[kept]
    return Found(best[False], best[True])


def _chosen(
    rows: NDArray[np.int64],
    values: NDArray[np.float64],
    envs: "ReplicaVectorEnv",
    width: int,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """The rows from which the search goes on, of those whose episodes do."""
    rows = rows[np.argsort(-values[rows], kind="stable")]
    egos = envs.egos[rows]
    sizes = {"x": PLACE, "y": PLACE, "speed": SPEED, "target_speed": SPEED, "target": 1}
    cells = np.column_stack([np.round(egos[name] / size) for name, size in sizes.items()])
    _, first = np.unique(cells, axis=0, return_index=True)
    rows = rows[np.sort(first)]
    if len(rows) <= width:
        return rows
    half = width // 2
    return np.concatenate((rows[:half], rng.choice(rows[half:], width - half, replace=False)))
