"""The runner: every task is computed once, whatever dies, hangs or fails; what cannot be is named."""

import multiprocessing
import os
import re
import signal
import time
from concurrent.futures import Executor
from contextlib import suppress

import pytest

from experiments.study.compute.executors import open_executor
from experiments.study.compute.progress import ProgressDisplay
from experiments.study.compute.run import Observer, attempt, locked, run, watched
from experiments.study.results.working import LOG, PROGRESS, last_words
from experiments.support.errors import UserError
from tests.experiments.study.misbehaving import STEPS, Sum
from tests.processes import is_alive, wait_for

TOTAL = str(sum(range(STEPS)))


class Witness(Observer):
    """Keeps what the runner tells."""

    def __init__(self) -> None:
        self.retries: list[tuple[str, str]] = []
        self.order: list[str] = []

    def tell(self, task, state, words="") -> None:
        if state == "running":
            self.order.append(task.name)
        elif state == "waiting":
            self.retries.append((task.name, words))


def compute(
    tasks: list[Sum], workers: int = 2, tasks_per_process: int = 25
) -> tuple[dict[str, str], Witness]:
    witness = Witness()
    executor, limit = open_executor("local", workers, tasks[0].directory, tasks_per_process, len(tasks))
    return run(tasks, executor, limit, witness), witness


def results(tasks: list[Sum]) -> list[str | None]:
    return [task.result.read_text() if task.done() else None for task in tasks]


def test_every_task_is_computed_once_in_the_order_asked_for(tmp_path):
    """A study that is stopped early has the first of its settings and seeds whole."""
    tasks = [Sum(f"t{number}", tmp_path) for number in (3, 1, 4, 0, 2)]
    failures, witness = compute(tasks, workers=1)
    assert failures == {}
    assert witness.order == ["t3", "t1", "t4", "t0", "t2"]
    assert results(tasks) == [TOTAL] * 5
    assert [len(task.tries()) for task in tasks] == [1] * 5
    assert not list((tmp_path / "work").iterdir())
    compute(tasks)
    assert [len(task.tries()) for task in tasks] == [1] * 5


def test_processes_are_recycled(tmp_path):
    tasks = [Sum(f"t{number}", tmp_path) for number in range(4)]
    compute(tasks, workers=1, tasks_per_process=2)
    assert len({task.tries()[0] for task in tasks}) == 2


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("kill", "killed by SIGKILL"),
        ("exit", "ended with exit status 7"),
        ("lose", "OSError: the surroundings fail"),
        pytest.param("hold", "it hung: no sign of life", marks=pytest.mark.slow),
        pytest.param("deadlock", "it hung: no sign of life", marks=pytest.mark.long),
    ],
)
def test_what_goes_wrong_is_begun_again_in_another_process(tmp_path, fault, reason):
    bad = Sum("bad", tmp_path, fault=fault, times=1, silence=3.0)
    tasks = [bad, Sum("good", tmp_path, pause=0.2)]
    failures, witness = compute(tasks)
    assert failures == {}
    assert results(tasks) == [TOTAL] * 2
    first, second = bad.tries()
    assert first != second
    [(name, words)] = witness.retries
    assert name == "bad" and reason in words and words.endswith("retry 1 of 3")
    assert len(tasks[1].tries()) == 1  # its process died alone


def test_no_more_processes_are_started_than_there_are_tasks(tmp_path):
    executor, limit = open_executor("local", 12, tmp_path, 25, 1)
    executor.submit(int).result()
    assert limit == 1 and len(multiprocessing.active_children()) == 1
    executor.shutdown()


def test_a_process_that_is_killed_between_two_tasks_is_replaced(tmp_path):
    executor, _ = open_executor("local", 1, tmp_path, 25, 1)
    first = executor.submit(os.getpid).result()
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: not is_alive(first))

    def in_another() -> bool:
        with suppress(RuntimeError, OSError):  # handed to the one that is gone, until that is noticed
            return executor.submit(os.getpid).result(timeout=60) != first
        return False

    wait_for(in_another)
    executor.shutdown()


@pytest.mark.parametrize(
    ("fault", "tries", "word"),
    [
        ("segfault", 4, "Segmentation fault"),
        ("fail", 1, "Traceback"),
        ("leave", 1, "SystemExit: 0"),
        ("refuse", 1, "put this right"),
    ],
)
def test_what_always_goes_wrong_is_given_up_and_the_others_are_computed(tmp_path, fault, tries, word):
    """An error of the task itself would be the same in each try: there is one."""
    bad, good = Sum("bad", tmp_path, fault=fault, times=99), Sum("good", tmp_path)
    failures, witness = compute([bad, good])
    assert list(failures) == ["bad"]
    assert results([bad, good]) == [None, TOTAL]
    assert [words[-6:] for _, words in witness.retries] == ["1 of 3", "2 of 3", "3 of 3"][: tries - 1]
    assert len(bad.tries()) == tries
    log = (bad.folder / LOG).read_text()
    assert ("misbehaving.py" in log) == (fault != "refuse")  # the stack, where there are no words for it
    assert log.count(word) == tries


def test_a_task_that_is_begun_again_is_not_called_failed(tmp_path):
    """A report that is made meanwhile would name it among the failures."""
    task = Sum("task", tmp_path, fault="fail", times=1)
    assert attempt(task).state == "failed"
    assert "told to fail" in last_words(task.folder)
    os.utime(task.folder / LOG, (0, 0))  # file times are coarse
    with watched(task.folder, task.silence):
        assert last_words(task.folder) == ""


def test_what_concerns_every_task_ends_the_run(tmp_path):
    tasks = [Sum("bad", tmp_path, fault="full", times=99), Sum("good", tmp_path)]
    with pytest.raises(UserError, match="no space left"):
        compute(tasks, workers=1)


def test_a_task_that_another_run_computes_is_waited_for_and_taken_over(tmp_path):
    task = Sum("task", tmp_path)
    held = locked(task.folder)
    assert held.__enter__()

    class Release(Witness):
        def tell(self, task, state, words="") -> None:
            if state == "in another run" and not self.order:
                self.order.append("released")
                held.__exit__(None, None, None)

    assert run([task], *open_executor("local", 1, tmp_path, 25, 1), Release()) == {}
    assert results([task]) == [TOTAL]
    assert len(task.tries()) == 1


class Refusing(Executor):
    def submit(self, function, /, task):  # type: ignore[override]
        raise RuntimeError("the cluster is gone")


def test_an_executor_that_takes_no_more_tasks_ends_the_run_in_one_line(tmp_path):
    with pytest.raises(UserError, match=r"takes no more tasks \(the cluster is gone\): run the same command"):
        run([Sum("task", tmp_path)], Refusing(), 1)


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


def test_on_a_narrow_terminal_the_line_stays_one(told, monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    told.tell("a", "running")
    told.display.tick()
    *_, line = capsys.readouterr().out.split("\r\x1b[K")
    assert line == "1/3 cells, 33%, 1 running, 1 waiting"[:29]
