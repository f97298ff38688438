"""The learner learns as fast as the one that it replaced: learning curves as statistics over seeds."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.agents.curves import CURVES, SEEDS, STORED

FRESH = range(100, 104)
SIGMAS = 4.0


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CURVES))
def test_learning_curves_are_those_of_the_learner_in_numpy(name: str) -> None:
    """On other seeds: within 4 standard errors at every point, so a difference of a quarter is seen."""
    stored = json.loads(STORED.read_text())[name]
    mean, sd = np.array(stored["mean"]), np.array(stored["sd"])
    found = np.array([CURVES[name](seed) for seed in FRESH])
    spread = np.maximum(sd, found.std(0, ddof=1))
    error = spread * np.sqrt(1 / len(SEEDS) + 1 / len(FRESH))
    assert (np.abs(found.mean(0) - mean) < SIGMAS * error).all()
