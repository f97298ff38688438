"""The worker of `process.SumoProcess`: `main`, with the arguments LINK MODULE:CLASS OPTIONS.

Answers requests (command, arguments) to a simulator by (exception or None, value) until the other end is gone. The
command "fork" makes a copy of the process, which serves a socket of its own. Nothing is printed but what SUMO prints,
and only what the simulator needs is imported, because the client waits for it.
"""

import os
import pickle
import signal
import socket
import sys
import traceback
from collections.abc import Mapping
from contextlib import suppress
from pkgutil import resolve_name
from typing import Any

from sumo_env.simulator import SimulatorError
from sumo_env.sumo.paths import delete_own_folder
from sumo_env.sumo.pipe import FORKS, connect, receive, send


def make(name: str, options: Mapping[str, str]) -> Any:
    """A simulator of the class ``module:name``."""
    simulator = resolve_name(name)
    return simulator(options=options) if options else simulator()


def serve(link: socket.socket, name: str, options: Mapping[str, str]) -> None:
    """Answer requests on a socket until the client has closed its end, or has died."""
    simulator, is_copy = None, False
    with suppress(EOFError, OSError):
        while True:
            command, arguments = receive(link)
            if command == "fork":
                copied = fork(link)
                if copied is not None:
                    link.close()
                    link, is_copy = copied, True
                continue
            try:
                simulator = simulator or make(name, options)
                answer = pickle.dumps((None, getattr(simulator, command)(*arguments)), 5)
            except Exception as error:
                answer = pickle.dumps((portable(error), None), 5)
            send(link, answer)
    if simulator is not None and not is_copy:  # a copy has nothing of its own to close
        simulator.close()


def fork(link: socket.socket) -> socket.socket | None:
    """Copy this process: None in it, and in the copy a socket to go on with, whose other end goes to the client."""
    ours, theirs = socket.socketpair()
    with theirs:
        try:
            pid = os.fork()
        except OSError as error:
            ours.close()
            link.sendall(pickle.dumps((error, None)))
            return None
        if pid:
            ours.close()
            socket.send_fds(link, [pickle.dumps((None, pid))], [theirs.fileno()])
            return None
    return ours


def main() -> None:
    """Serve the socket of the command line."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the client's to handle
    if FORKS:
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for copies; the system clears them away
    link, name, *options = sys.argv[1:]
    serve(connect(link), name, dict(option.split("=", 1) for option in options))
    delete_own_folder()
    sys.stdout.flush()
    os._exit(0)  # SUMO has nothing to save, and taking down its modules takes time


def portable(error: Exception) -> Exception:
    """The exception, or one like it that survives the journey; a note says where it was raised."""
    where = "In a worker process of sumo_env:\n" + "".join(traceback.format_exception(error))
    try:
        carried: Exception = pickle.loads(pickle.dumps(error))
    except Exception:
        carried = SimulatorError(f"{type(error).__name__}: {error}")
    carried.add_note(where)
    return carried
