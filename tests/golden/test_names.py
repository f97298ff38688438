"""Published cells, and those that are still to come, keep their names: nothing is computed twice or lost."""

from __future__ import annotations

import pytest

from experiments.study.results.store import Store
from tests.golden.names import FOLDERS, MISSING_COMMANDS, RESULTS, asked, golden


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_commands_of_a_folder_ask_for_its_cells_by_their_names(folder: str) -> None:
    store, names = Store(RESULTS / folder), set(golden()[folder])
    assert names and names <= set(store.finished())
    found = set().union(*(asked(sweep["command"]) for sweep in store.sweeps()))
    assert sorted(names - found) == []


@pytest.mark.parametrize("command", MISSING_COMMANDS)
def test_a_setting_that_is_not_published_has_the_names_that_its_training_uses(command: str) -> None:
    names = set(golden()[command])
    assert len(names) == 55 and names == asked(command)


def test_the_study_is_published_or_awaited() -> None:
    assert len(golden()) == len(FOLDERS) + len(MISSING_COMMANDS)
