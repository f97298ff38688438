"""Ray and Slurm's interface give the same results, and lose nothing when a process or a node is killed."""

from __future__ import annotations

import os
import re
import signal

import pytest

from experiments.study.compute.executors import open_executor
from experiments.study.compute.run import run
from experiments.study.results.working import fraction_done
from tests.experiments.study.misbehaving import Sum
from tests.experiments.study.test_run import TOTAL, Witness, results
from tests.processes import python

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


# Two nodes with one core each; the second one is killed as soon as both compute.
NODES = """
import os, sys
from pathlib import Path
from ray.cluster_utils import Cluster
from experiments.study.compute.executors import open_executor
from experiments.study.compute.run import run
from experiments.study.results.working import fraction_done
from tests.experiments.study.misbehaving import Sum
from tests.experiments.study.test_run import Witness

cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
second = cluster.add_node(num_cpus=1)
os.environ["RAY_ADDRESS"] = cluster.address
here = Path(sys.argv[1])
tasks = [Sum(f"t{number}", here, pause=0.3) for number in range(8)]

class Killer(Witness):
    killed = 0

    def tick(self):
        if not self.killed and sum(fraction_done(task.folder) > 0.2 for task in tasks) == 2:
            self.killed = 1
            cluster.remove_node(second, allow_graceful=False)

executor, limit = open_executor("ray", None, here, 25)
witness = Killer()
failures = run(tasks, executor, limit, witness)
print(limit, witness.killed, failures, witness.retries, flush=True)
cluster.shutdown()
"""


@pytest.mark.long
def test_a_ray_node_that_is_killed_costs_nothing_but_time(tmp_path):
    pytest.importorskip("ray")
    script = tmp_path / "nodes.py"
    script.write_text(NODES)
    printed = python(script, tmp_path)
    assert "\n2 1 {} [(" in f"\n{printed}", printed  # two cores, one killed, none failed, some retried
    tasks = [Sum(f"t{number}", tmp_path) for number in range(8)]
    assert results(tasks) == [TOTAL] * 8
    assert sum(len(task.tries()) for task in tasks) == 9
    assert not list((tmp_path / "work").iterdir())
