"""Ray and Slurm's interface give the same results, and lose nothing when a process or a node is killed."""

import os
import re
import signal
import socket

import pytest

from experiments.study.compute.executors import open_executor
from experiments.study.compute.run import run
from experiments.support.errors import UserError
from tests.experiments.study.misbehaving import Sum
from tests.experiments.study.test_run import TOTAL, Witness, results

pytestmark = pytest.mark.slow


def test_jobs_of_submitit_are_retried_or_fail_at_their_time_limit(tmp_path, monkeypatch):
    """submitit's processes on this machine: its scripts, messages and logs are those of Slurm."""
    core = pytest.importorskip("submitit.core.core")
    # [s], no 15, until a killed job's result is given up
    monkeypatch.setattr(core.Job, "_results_timeout_s", 1)
    from experiments.study.compute.executors.slurm import SlurmExecutor

    dies, slow = (
        Sum("dies", tmp_path, fault="kill", times=1),
        Sum("slow", tmp_path, pause=60.0, silence=900.0),
    )

    class Limit(Witness):
        """Sends the signal that Slurm sends before the time limit."""

        sent = False

        def tick(self) -> None:
            if not self.sent and (tmp_path / "slow.tries").exists() and slow.tries():
                self.sent = True
                os.kill(slow.tries()[0], signal.SIGUSR2)

    witness = Limit()
    failures = run([dies, slow], SlurmExecutor(tmp_path / "slurm", cluster="local"), 2, witness)
    assert results([dies, slow]) == [TOTAL, None]
    assert [len(task.tries()) for task in (dies, slow)] == [2, 1]  # the other would take as long again
    [(name, reason)] = witness.retries
    assert name == "dies" and str(tmp_path / "slurm") in reason  # submitit's log
    assert list(failures) == ["slow"] and re.search(r"time limit after \d+ s", failures["slow"])


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
    with socket.create_server(("127.0.0.1", 0)) as there:
        port = there.getsockname()[1]
        monkeypatch.setenv("RAY_ADDRESS", f"127.0.0.1:{port}")
        with pytest.raises(UserError, match=rf"RAY_ADDRESS=127.0.0.1:{port} .*\(nobody is there\)"):
            open_executor("ray", 2, tmp_path, 25, 3)
    with pytest.raises(UserError, match=r"cannot be joined .*refused.*unset RAY_ADDRESS"):
        open_executor("ray", 2, tmp_path, 25, 3)  # at once, Ray is not asked
    monkeypatch.delenv("RAY_ADDRESS")
    with pytest.raises(ConnectionError):
        open_executor("ray", 2, tmp_path, 25, 3)
    assert asked == [f"127.0.0.1:{port}", "local"]


def test_ray_computes_and_retries_on_a_cluster_of_its_own(tmp_path, ray):
    tasks = [
        Sum("good", tmp_path),
        Sum("dies", tmp_path, fault="segfault", times=1),
        Sum("fails", tmp_path, fault="lose", times=1),
    ]
    failures = run(tasks, *open_executor("ray", 2, tmp_path, 25, 3), Witness())
    assert failures == {}
    assert results(tasks) == [TOTAL] * 3
    assert [len(task.tries()) for task in tasks] == [1, 2, 2]
