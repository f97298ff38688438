"""Markers of tests: of every task, of those that highway-env has, and of those that the study publishes numbers of."""

import pytest

from experiments.study.design.sheet import GRID
from sumo_env.tasks import TASKS

PUBLISHED = tuple(GRID)
# The replica has its own draws of them.
OF_HIGHWAY_ENV = tuple(name for name, task in TASKS.items() if task.reference)
every_task = pytest.mark.parametrize("task", tuple(TASKS))
highway_env_task = pytest.mark.parametrize("task", OF_HIGHWAY_ENV)
published_task = pytest.mark.parametrize("task", PUBLISHED)
