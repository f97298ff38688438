"""The process of `remote.RemoteSimulator`: ``python -m sumo_env.sumo.worker DESCRIPTOR MODULE:CLASS FOLDER OPTIONS``.

Answers requests (command, arguments) to a simulator by (exception or None, value) until the other end is gone. The
command "fork" makes a copy of the process, which serves a socket of its own. Temporary files are made in FOLDER, which
is removed at the end. Nothing is printed but what SUMO prints, and only what the simulator needs is imported, because
the client waits for it.
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


class Server:
    """The process's end of the socket."""

    def __init__(self, descriptor: int, folder: str) -> None:
        self._connect(descriptor, folder)
        self._simulator: Any = None
        self._is_copy = False

    def serve(self, name: str, options: tuple[str, ...]) -> None:
        """Answer requests until the client has closed its end, or has died."""
        with suppress(EOFError, OSError):
            while True:
                command, arguments = pickle.load(self._stream)
                if command == "fork":
                    self._fork(*arguments)
                    continue
                try:
                    if self._simulator is None:
                        self._simulator = make(name, options)
                    self._answer(None, getattr(self._simulator, command)(*arguments))
                except Exception as error:
                    self._answer(portable(error), None)
        if self._simulator is not None and not self._is_copy:  # a copy has nothing of its own to close
            self._simulator.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _connect(self, descriptor: int, folder: str) -> None:
        self._link, self._folder = socket.socket(fileno=descriptor), folder
        self._stream = self._link.makefile("rwb")
        tempfile.tempdir = folder

    def _answer(self, error: Exception | None, value: Any) -> None:
        self._stream.write(pickle.dumps((error, value), 5))
        self._stream.flush()

    def _fork(self, folder: str) -> None:
        """Make a copy of this process, which goes on with `folder` and the socket that the client sends now."""
        self._stream.write(b".")  # the request is read: what comes next is the socket
        self._stream.flush()
        _, (descriptor,), _, _ = socket.recv_fds(self._link, 1, 1)
        try:
            pid = os.fork()
        except OSError as error:
            os.close(descriptor)
            self._answer(error, None)
            return
        if pid:
            os.close(descriptor)
            self._answer(None, pid)
        else:
            os.close(self._link.detach())  # without flushing: the original answers
            self._is_copy = True
            self._connect(descriptor, folder)


def main() -> None:
    """Serve the socket of the command line."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the client's to handle
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for copies; the system clears them away
    descriptor, name, folder, *options = sys.argv[1:]
    Server(int(descriptor), folder).serve(name, tuple(options))


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
