"""Two markers of tests: of every task that there is, and of the tasks that the study publishes numbers of."""

from __future__ import annotations

import pytest

from experiments.study.design.sheet import GRID
from sumo_env.tasks import TASKS

PUBLISHED = tuple(GRID)
every_task = pytest.mark.parametrize("task", tuple(TASKS))
published_task = pytest.mark.parametrize("task", PUBLISHED)
