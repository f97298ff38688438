"""How this process starts a worker and gets a socket to it, and messages on that socket."""

import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

from sumo_env.simulator import SimulatorError

# Whether a process that has loaded SUMO can be forked. macOS has fork, but libraries of the system may fail after it.
FORKS = sys.platform.startswith("linux")
SIZE = 8  # bytes of a message's length


def start(
    program: list[str], arguments: list[str], environment: Mapping[str, str]
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start a program that calls `connect` with its first argument; the process, and the socket to it."""
    options: dict[str, Any] = {
        "env": environment,
        "start_new_session": True,  # Ctrl-C in the terminal is for this process alone; the same on Windows:
        "creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    }
    try:
        os.getcwd()
    except FileNotFoundError:  # somebody has deleted it, and Python does not start there
        options["cwd"] = os.sep
    ours, theirs = socket.socketpair()
    with theirs:  # closed here, so that reading ends when the worker does
        if sys.platform == "win32":
            child = subprocess.Popen([*program, "shared", *arguments], stdin=subprocess.PIPE, **options)
            assert child.stdin is not None
            with child.stdin:
                child.stdin.write(theirs.share(child.pid))
        else:
            number = theirs.fileno()
            command = [*program, str(number), *arguments]
            child = subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=(number,), **options)
    return child, ours


def connect(number: str) -> socket.socket:
    """In the worker: the other end of the socket."""
    if sys.platform == "win32":
        return socket.fromshare(sys.stdin.buffer.read())
    return socket.socket(fileno=int(number))


def interpreter() -> str:
    """A program that runs Python: that of this process, or where Python is embedded, the one beside its library.

    ``multiprocessing.set_executable`` chooses another one.

    Raises:
        SimulatorError: there is none.
    """
    try:
        from multiprocessing.spawn import get_executable  # late: a worker does not need it
    except TypeError:  # Python 3.11.2 where sys.executable is None
        chosen = ""
    else:
        chosen = os.fsdecode(get_executable() or "")
    is_python = chosen != sys.executable or "python" in os.path.basename(chosen)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    found = chosen if is_python and chosen else os.path.join(sys.exec_prefix, "bin", version)
    if not os.access(found, os.X_OK):
        raise SimulatorError(
            f"a further environment needs a Python of its own, and there is none at {found!r}: call "
            f"multiprocessing.set_executable with the path of {version}"
        )
    return found


def send(link: socket.socket, pickled: bytes) -> None:
    """Send a message, for `receive`."""
    link.sendall(len(pickled).to_bytes(SIZE, "big") + pickled)


def receive(link: socket.socket) -> Any:
    """The next message; EOFError once the other end is closed.

    Not through a buffered stream: a thread that waits holds its lock, for good in a process that another one forks.
    """
    return pickle.loads(_exactly(link, int.from_bytes(_exactly(link, SIZE), "big")))


def _exactly(link: socket.socket, count: int) -> bytearray:
    data = bytearray(count)
    rest = memoryview(data)
    while rest:
        if not (size := link.recv_into(rest)):
            raise EOFError("the other end is closed")
        rest = rest[size:]
    return data
