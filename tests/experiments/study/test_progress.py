"""What a person reads about the time that is left."""

from __future__ import annotations

import time

from experiments.study.compute.progress import ProgressDisplay
from experiments.study.results.working import PROGRESS
from tests.experiments.study.misbehaving import Sum


def test_the_start_of_the_processes_says_nothing_about_the_speed(tmp_path, monkeypatch, capsys) -> None:
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    task = Sum("one", tmp_path)
    task.folder.mkdir(parents=True)
    display = ProgressDisplay(tmp_path / "work", {"one": 100.0}, ())
    display.tell(task, "running")

    def at(passed: float, share: float) -> str:
        now[0] = 1000.0 + passed
        (task.folder / PROGRESS).write_text(str(share))
        display.tick()
        return capsys.readouterr().out

    assert "left" not in at(40, 0)  # [s]
    at(60, 0.1)
    assert "about 2 min left" in at(90, 0.3)  # a tenth in 15 s
