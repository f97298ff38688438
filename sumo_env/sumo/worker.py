"""The process of `remote.RemoteSimulator`: ``python -m sumo_env.sumo.worker DESCRIPTOR MODULE:CLASS FOLDER OPTIONS``.

Answers requests (command, arguments) to a simulator by (exception or None, value) until the other end is gone.
Temporary files are made in FOLDER, which is removed at the end. Nothing is printed but what SUMO prints, and only what
the simulator needs is imported, because the client waits for it.
"""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import socket
import sys
import tempfile
import traceback
from contextlib import suppress
from typing import Any

from sumo_env.simulator import SimulatorError
from sumo_env.sumo.options import make

PORTABLE = ("builtins", "gymnasium", "sumo_env")  # packages whose exceptions keep their class


def main() -> None:
    """Serve until the client is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the client's to handle
    descriptor, name, folder, *options = sys.argv[1:]
    tempfile.tempdir = folder
    stream = socket.socket(fileno=int(descriptor)).makefile("rwb")
    simulator: Any = None
    with suppress(EOFError, OSError):  # the client has closed its end, or has died
        while True:
            command, arguments = pickle.load(stream)
            try:
                if simulator is None:
                    simulator = make(name, tuple(options))
                answer = pickle.dumps((None, getattr(simulator, command)(*arguments)), 5)
            except Exception as error:
                answer = pickle.dumps((portable(error), None), 5)
            stream.write(answer)
            stream.flush()
    if simulator is not None:
        simulator.close()
    shutil.rmtree(folder, ignore_errors=True)


def portable(error: Exception) -> Exception:
    """The exception, or one like it that survives the journey; a note says where it was raised."""
    where = "In a worker process of sumo_env:\n" + "".join(traceback.format_exception(error))
    try:
        if type(error).__module__.partition(".")[0] not in PORTABLE:
            raise TypeError("of a package that the client may not have imported")
        carried: Exception = pickle.loads(pickle.dumps(error))
    except Exception:
        carried = SimulatorError(f"{type(error).__name__}: {error}")
    carried.add_note(where)
    return carried


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)  # SUMO has nothing to save, and taking down its modules takes time
