"""How much a full and a quick run measure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from experiments.benchmarks.environments import Effort


@dataclass(frozen=True)
class Size:
    """How much is measured. `seconds`: what each part takes on two cores, for the progress bar."""

    effort: Effort
    all_levels: bool
    learner_turns: int
    sweep_updates: int
    sweep_episodes: int
    vector_tasks: tuple[str, ...]
    vector_sizes: tuple[int, ...]
    vector_seconds: float
    growth: tuple[int, ...]
    memory: int
    seconds: Mapping[str, float]


FULL = Size(
    effort=Effort(turns=5, seconds=1.0, reference_seconds=2.0, reference_steps=3),
    all_levels=True,
    learner_turns=9,
    sweep_updates=400,
    sweep_episodes=10,
    vector_tasks=("highway", "two-way", "roundabout", "intersection", "u-turn"),
    vector_sizes=(1, 2, 4),
    vector_seconds=3.0,
    growth=(25, 50, 75, 100, 125, 150),
    memory=10_000,
    seconds={"env": 720, "learner": 50, "sweep": 240, "vector": 60, "growth": 75, "memory": 110},
)
QUICK = Size(
    effort=Effort(turns=3, seconds=0.08, reference_seconds=0.25, reference_steps=1),
    all_levels=False,
    learner_turns=2,
    sweep_updates=40,
    sweep_episodes=2,
    vector_tasks=("highway",),
    vector_sizes=(1, 2),
    vector_seconds=0.7,
    growth=(25, 50, 75),
    memory=200,
    seconds={"env": 50, "learner": 25, "sweep": 11, "vector": 5, "growth": 10, "memory": 4},
)
