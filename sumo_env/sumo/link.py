"""How this process starts a worker and gets a socket to it, on every system, and messages on that socket.

Where a process can hand an open socket to one that it starts, it does so. Elsewhere, as on Windows, the worker connects
to a port of this machine that is open for this alone, and shows a key that it was given on its standard input.
"""

from __future__ import annotations

import hmac
import os
import pickle
import secrets
import socket
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from sumo_env.simulator import SimulatorError

INHERITS = os.name == "posix"  # whether a process can be given an open socket when it is started
# Whether a process that has loaded SUMO can be forked. macOS has fork, but libraries of the system may fail after it.
FORKS = sys.platform.startswith("linux")
KEY = 32  # bytes
SIZE = 8  # bytes of a message's length
PATIENCE = 1.0  # [s] between two looks at whether a worker is still alive, and for its key


def start(
    program: list[str], arguments: list[str], environment: Mapping[str, str]
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start a program that calls `connect` with its first argument; the process, and the socket to it.

    If the program ends before it connects, the socket is one that nobody answers.
    """
    options: dict[str, Any] = {
        "env": environment,
        "start_new_session": True,  # Ctrl-C in the terminal is for this process alone; the same on Windows:
        "creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    }
    try:
        os.getcwd()
    except FileNotFoundError:  # somebody has deleted it, and Python does not start there
        options["cwd"] = os.sep
    if INHERITS:
        ours, theirs = socket.socketpair()
        with theirs:  # closed here, so that reading ends when the worker does
            descriptor, number = [f"descriptor:{theirs.fileno()}"], theirs.fileno()
            child = subprocess.Popen(
                [*program, *descriptor, *arguments], stdin=subprocess.DEVNULL, pass_fds=(number,), **options
            )
        return child, ours
    key = secrets.token_bytes(KEY)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = f"port:{server.getsockname()[1]}"
        child = subprocess.Popen([*program, port, *arguments], stdin=subprocess.PIPE, **options)
        assert child.stdin is not None
        with suppress(OSError), child.stdin:
            child.stdin.write(key)
        server.settimeout(PATIENCE)
        while child.poll() is None:
            with suppress(OSError):
                ours, _ = server.accept()
                if _knows(ours, key):
                    ours.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    return child, ours
                ours.close()
    ours, theirs = socket.socketpair()
    theirs.close()
    return child, ours


def interpreter() -> str:
    """A program that runs Python; where Python is embedded, ``multiprocessing.set_executable`` chooses it.

    Raises:
        SimulatorError: there is none.
    """
    from multiprocessing.spawn import get_executable

    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    chosen, usual = os.fsdecode(get_executable() or ""), os.path.join(sys.exec_prefix, "bin", version)
    own = sys.executable or ""
    programs = [chosen, own, usual]
    if chosen in ("", own) and "python" not in os.path.basename(own):
        programs.reverse()  # `own` is a program in which Python is embedded
    for program in programs:
        if os.access(program, os.X_OK):
            return program
    raise SimulatorError(
        f"a further environment needs a Python of its own, and there is none at {chosen or usual!r}: call "
        f"multiprocessing.set_executable with the path of {version}"
    )


def _knows(other: socket.socket, key: bytes) -> bool:
    """Whether the other end sends the key."""
    other.settimeout(PATIENCE)
    with suppress(OSError), other.makefile("rb") as stream:
        return hmac.compare_digest(stream.read(KEY), key)
    return False


def connect(where: str) -> socket.socket:
    """In the worker: the other end of the socket."""
    kind, _, number = where.partition(":")
    if kind == "descriptor":
        return socket.socket(fileno=int(number))
    link = socket.create_connection(("127.0.0.1", int(number)))
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    link.sendall(sys.stdin.buffer.read(KEY))
    return link


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
