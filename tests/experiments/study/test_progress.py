"""What a person reads about the time that is left."""

from __future__ import annotations

import re
import time

import pytest

from experiments.study.compute.progress import ProgressDisplay
from experiments.study.results.working import PROGRESS
from tests.experiments.study.misbehaving import Sum


class Told:
    """A display of three tasks of 100 s each, the last of which was finished before, and the time."""

    def __init__(self, work, monkeypatch, capsys) -> None:
        self.now, self.tasks = 1000.0, {name: Sum(name, work) for name in "abc"}
        monkeypatch.setattr(time, "monotonic", lambda: self.now)
        for task in self.tasks.values():
            task.folder.mkdir(parents=True)
        self.display, self.capsys = ProgressDisplay(work / "work", dict.fromkeys("abc", 100.0), {"c"}), capsys

    def tell(self, name: str, state: str) -> None:
        self.display.tell(self.tasks[name], state)

    def at(self, passed: float, **shares: float) -> float | None:
        """Minutes that are said to be left, after so many seconds and with these shares of tasks done."""
        self.now = 1000.0 + passed
        for name, share in shares.items():
            (self.tasks[name].folder / PROGRESS).write_text(str(share))
        self.display.tick()
        found = re.search(r"about (\d+) (s|min) left", self.capsys.readouterr().out)
        return None if found is None else int(found[1]) / (60 if found[2] == "s" else 1)


@pytest.fixture
def told(tmp_path, monkeypatch, capsys) -> Told:
    return Told(tmp_path, monkeypatch, capsys)


def test_the_start_of_the_processes_says_nothing_about_the_speed(told) -> None:
    told.tell("a", "running")
    assert told.at(40, a=0) is None  # [s]
    told.at(60, a=0.1)
    assert told.at(100, a=0.5) == 2  # a hundredth a second, and 150 s of work


def test_neither_other_runs_nor_failures_nor_what_was_there_speed_it_up(told) -> None:
    told.tell("a", "running")
    told.at(20, a=0.1)
    assert told.at(60, a=0.5) == 2
    told.tell("b", "running")  # for a moment, in which the other run's share is read
    told.at(61, b=0.9)
    told.tell("b", "in another run")
    told.at(62, a=0.5)
    told.tell("b", "finished")
    assert told.at(102, a=0.9) == 10 / 60
    told.tell("a", "failed")
    assert told.at(120) is None


def test_the_speed_is_that_of_the_last_ten_minutes(told) -> None:
    told.tell("a", "running")
    told.at(10, a=0.01)
    told.at(20, a=0.5)
    for minute in range(1, 14):
        left = told.at(20 + 60 * minute, a=0.5 + 0.03 * minute)
    assert left == 37  # three seconds of work in a minute, and 111 s of it
