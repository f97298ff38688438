"""What the study makes of results: the analysis of made-up cells, and the curves of a learner on a made-up road."""

from __future__ import annotations

import json
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from agents.dqn import DQNConfig
from agents.training import train
from experiments.analysis.analysis import analyse
from experiments.study.results import load
from tests.agents.road import Road
from tests.agents.test_training import Small
from tests.experiments import synthetic

LEVELS = {"highway": (1,), "u-turn": (1, 2)}
FAULTS = {"sumo-highway-50-control-s0": "diverged", "sumo-u-turn-3-control-s1": "tied"}


class Config(DQNConfig):
    """Explores as the learner in numpy did: epsilon falls from the first step."""

    def epsilon(self, step: int) -> float:
        return super().epsilon(step + self.warm_up)


# Settings of the learner in numpy that the golden curves are of: explores from the first step, copies the target.
LEARNER = Config(
    updates=1200,
    steps_per_update=1,
    gamma=0.99,
    learning_rate_final=5e-4,
    batch_size=16,
    warm_up=60,
    standardise=False,
    target_interval=50,
    tau=1.0,
)
SEEDS = range(12)
PARTS = 6  # of the training steps
CELL_HASH = re.compile(r'-[0-9a-f]{12}"')
# What a mean over the seeds may differ by, if two standard errors of the golden mean are less.
FLOOR = {"return": 0.5, "crash_rate": 0.05}


def analysis() -> dict[str, Any]:
    """analysis.json of made-up cells, without its provenance and the hashes in the names of cells (versions)."""
    with tempfile.TemporaryDirectory() as folder:
        synthetic.write(Path(folder), LEVELS, seeds=4, faults=FAULTS, effect=-0.2)
        value = analyse(load(Path(folder)))
    del value["provenance"]
    for part in ("ate", "pooled"):  # the others are computed alike
        value[part] = [record for record in value[part] if record["outcome"] in ("return", "crashed")]
    result: dict[str, Any] = json.loads(CELL_HASH.sub('"', json.dumps(value)))
    return result


def curves() -> dict[str, list[list[float]]]:
    """Return and crash rate in each sixth of the training steps: mean and standard error over the seeds."""
    agents = [train(Road(), LEARNER, seed, network=Small) for seed in SEEDS]
    parts: dict[str, list[list[float]]] = {"return": [], "crash_rate": []}
    for agent in agents:
        log = agent.episodes
        part = np.minimum((log["step"] - 1) * PARTS // agent.steps, PARTS - 1)
        for name, column in (("return", log["return"]), ("crash_rate", log["crashed"])):
            parts[name].append([float(column[part == k].mean()) for k in range(PARTS)])
    return {name: _means(np.array(rows)) for name, rows in parts.items()}


def _means(rows: np.ndarray) -> list[list[float]]:
    error = rows.std(axis=0, ddof=1) / np.sqrt(len(rows))
    return [[round(float(m), 4), round(float(e), 4)] for m, e in zip(rows.mean(axis=0), error, strict=True)]
