"""Before numpy is imported: threads as the commands have them, so that bits are the same.

And highway-env's classes as they were: making its intersection writes other numbers into the class of all drivers.
"""

import gc
import os
import signal
import threading
from collections.abc import Iterator

from experiments.support import limit_threads

limit_threads()

import pytest
from highway_env.vehicle.behavior import IDMVehicle

from sumo_env import unsupported
from sumo_env.sumo import process

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # pygame's windows are on a display that shows nothing
unsupported.DOCUMENTATION = ""  # messages name files, also once `make addresses` has filled it in

# A shell starts what it runs in the background with Ctrl-C ignored, and so would every process of a test.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)

LEAKED = ("DISTANCE_WANTED", "COMFORT_ACC_MAX", "COMFORT_ACC_MIN")
PRISTINE = {name: getattr(IDMVehicle, name) for name in LEAKED}


def pytest_collection_finish() -> None:
    """All modules are loaded: no garbage is to be looked for in them again (statsmodels' Holm always looks)."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def regular_drivers() -> Iterator[None]:
    """Undo what a test has left in the class of highway-env's drivers."""
    yield
    for name, value in PRISTINE.items():
        setattr(IDMVehicle, name, value)


@pytest.fixture(scope="module", autouse=True)
def sumo_is_free() -> Iterator[None]:
    """A module that leaves an environment open would send those of the next module into worker processes."""
    yield
    if process._Here._taken.locked():
        gc.collect()  # what is garbage closes itself
    assert not process._Here._taken.locked(), "a test of this module left an environment open: close it"
