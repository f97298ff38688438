"""A Ray cluster: that of RAY_ADDRESS, else one of this machine that ends with the sweep."""

import os
import signal
import socket
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # read when ray is imported

import ray

from experiments.support import VARIABLES
from experiments.support.errors import UserError

PATIENCE = 10.0  # [s] for an answer of a cluster
ROOT = Path(__file__).resolve().parents[4]


class RayExecutor(Executor):
    """Ray tasks of one core each. Retries are the runner's, so that they are counted and logged alike everywhere.

    The nodes must see the checkout, the Python environment and the result directory under the same paths.

    workers: cores of a cluster that has to be started; all of the machine's by default.
    """

    def __init__(self, workers: int | None, tasks_per_process: int) -> None:
        handler = signal.getsignal(signal.SIGTERM)
        environment = {"env_vars": {"PYTHONPATH": str(ROOT), **dict.fromkeys(VARIABLES, "1")}}
        common: dict[str, Any] = {
            "runtime_env": environment,
            "log_to_driver": False,
            "logging_level": "ERROR",
        }
        if address := os.environ.get("RAY_ADDRESS"):
            try:
                _ask(address)
                ray.init(address=address, **common)
            except Exception as error:
                why = str(error).partition("\n")[0]
                raise UserError(
                    f"the Ray cluster of RAY_ADDRESS={address} cannot be joined ({why}): start it, or unset "
                    "RAY_ADDRESS to compute on this machine alone"
                ) from error
        else:  # whoever else's cluster runs here
            ray.init(address="local", num_cpus=workers, include_dashboard=False, **common)
        signal.signal(signal.SIGTERM, handler)  # Ray puts its own in the place of ours
        self._call = ray.remote(num_cpus=1, max_retries=0, max_calls=tasks_per_process)(_call)
        self._references: set[Any] = set()
        self.workers = max(int(ray.cluster_resources().get("CPU", 1)), 1)  # cores of the cluster
        where = f"the cluster of RAY_ADDRESS={address}" if address else "a cluster of this machine alone"
        print(f"Ray computes on {where}, with {self.workers} cores", flush=True)

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function in a process of the cluster."""
        reference = self._call.remote(os.getcwd(), partial(function, *args, **kwargs))
        self._references.add(reference)
        future: Future[Any] = reference.future()
        future.add_done_callback(lambda _: self._references.discard(reference))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster, when all tasks are done; with `cancel_futures`, end them at once."""
        for reference in list(self._references) if cancel_futures else ():
            ray.cancel(reference, force=True)
        ray.shutdown()


def _ask(address: str) -> None:
    """Raise OSError where nobody listens at HOST:PORT, after which Ray itself looks for some minutes."""
    host, _, port = address.rpartition("/")[2].rpartition(":")
    if port.isdecimal():
        socket.create_connection((host.strip("[]"), int(port)), PATIENCE).close()


def _call(folder: str, function: Callable[[], Any]) -> Any:
    os.chdir(folder)  # relative paths mean the same on all nodes
    return function()
