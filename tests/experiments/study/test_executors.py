"""Ray and Slurm's interface give the same results, and lose nothing when a process or a node is killed."""

from __future__ import annotations

import os
import re
import signal

import pytest

from experiments.study.compute.executors import open_executor
from experiments.study.compute.run import run
from experiments.study.results.working import fraction_done
from experiments.support.errors import UserError
from tests.experiments.study.misbehaving import Sum
from tests.experiments.study.test_run import TOTAL, Witness, results

pytestmark = pytest.mark.slow


def test_jobs_of_submitit_are_computed_and_retried(tmp_path):
    """submitit's processes on this machine: its scripts, messages and logs are those of Slurm."""
    pytest.importorskip("submitit")
    from experiments.study.compute.executors.slurm import SlurmExecutor

    tasks = [
        Sum("good", tmp_path),
        Sum("dies", tmp_path, fault="kill", times=1),
    ]
    witness = Witness()
    failures = run(tasks, SlurmExecutor(tmp_path / "slurm", cluster="local"), 4, witness)
    assert failures == {}
    assert results(tasks) == [TOTAL] * 2
    assert [len(task.tries()) for task in tasks] == [1, 2]
    [reason] = [words for name, words in witness.retries if name == "dies"]
    assert str(tmp_path / "slurm") in reason  # submitit's log


def test_a_job_at_its_time_limit_fails_and_names_the_time(tmp_path):
    pytest.importorskip("submitit")
    from experiments.study.compute.executors.slurm import SlurmExecutor

    task = Sum("long", tmp_path, pause=0.5)
    executor = SlurmExecutor(tmp_path / "slurm", cluster="local")

    class Limit(Witness):
        """Sends the signal that Slurm sends before the time limit."""

        sent = False

        def tick(self) -> None:
            if fraction_done(task.folder) >= 0.3 and not self.sent:
                self.sent = True
                os.kill(task.tries()[0], signal.SIGUSR2)

    witness = Limit()
    [reason] = run([task], executor, 1, witness).values()
    assert witness.sent and not witness.retries and len(task.tries()) == 1  # it would take as long again
    assert re.search(r"time limit after \d+ s", reason)


@pytest.fixture
def ray():
    """Ray without a cluster: one is started, and must be gone afterwards."""
    module = pytest.importorskip("ray")
    assert not module.is_initialized()
    yield module
    assert not module.is_initialized()


def test_ray_joins_the_cluster_of_its_address_or_none(tmp_path, ray, monkeypatch):
    """`ray.init` would join any cluster of the machine."""
    asked = []

    def init(address, **_):
        asked.append(address)
        raise ConnectionError("nobody is there\nand more")

    monkeypatch.setattr(ray, "init", init)
    monkeypatch.setenv("RAY_ADDRESS", "somewhere:6379")
    with pytest.raises(UserError, match="RAY_ADDRESS=somewhere:6379"):
        open_executor("ray", 2, tmp_path, 25)
    monkeypatch.delenv("RAY_ADDRESS")
    with pytest.raises(ConnectionError):
        open_executor("ray", 2, tmp_path, 25)
    assert asked == ["somewhere:6379", "local"]


def test_ray_computes_and_retries_on_a_cluster_of_its_own(tmp_path, ray):
    tasks = [
        Sum("good", tmp_path),
        Sum("dies", tmp_path, fault="segfault", times=1),
        Sum("fails", tmp_path, fault="lose", times=1),
    ]
    failures = run(tasks, *open_executor("ray", 2, tmp_path, 25), Witness())
    assert failures == {}
    assert results(tasks) == [TOTAL] * 3
    assert [len(task.tries()) for task in tasks] == [1, 2, 2]
