"""What a user can put right: said in one line, without a traceback, with exit status 2."""

import errno
import io
import os
import shlex
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from agents import plugins
from agents.files import DamagedFile

USAGE = 2  # exit status: the call or the directory has to be put right first
INTERRUPTED = 130  # exit status after Ctrl-C, as a shell has it
FULL = {errno.ENOSPC, errno.EFBIG}
LEAVE = 4.0  # [s] after a signal in which the process ends in any case


class UserError(Exception):
    """Something the user can put right; the message is one line that says what to do."""


def unknown(kind: str, word: object, known: Iterable[object]) -> UserError:
    """The error for a name that does not exist, see `agents.plugins.unknown`."""
    return UserError(str(plugins.unknown(kind, str(word), map(str, known))))


def check_known(kind: str, words: Iterable[object], known: Iterable[object]) -> None:
    """Raise UserError for the first of some names that does not exist."""
    names = list(known)
    for word in words:
        if word not in names:
            raise unknown(kind, word, names)


def check_least(options: object, **least: float) -> None:
    """Raise UserError for the first of some options that is below its least value; None is always right."""
    for name, value in least.items():
        if (given := getattr(options, name)) is not None and given < value:
            raise UserError(f"--{name.replace('_', '-')} is at least {value}, not {given}")


def in_a_line(error: BaseException) -> str:
    """What went wrong: the message of a UserError, else the error with the place in the code where it was raised."""
    if isinstance(error, UserError):
        return str(error).partition("\n")[0]
    *_, (frame, line) = [(None, 0), *traceback.walk_tb(error.__traceback__)]
    place = f" ({Path(frame.f_code.co_filename).name}, line {line})" if frame else ""
    return f"{type(error).__name__}: {error}".partition("\n")[0] + place


@contextmanager
def in_words(errors: tuple[type[Exception], ...] = (ValueError,)) -> Iterator[None]:
    """Make a UserError of a ValueError, which says what is wrong with a name or a value, or of other errors."""
    try:
        yield
    except errors as error:
        raise UserError(str(error)) from None


def disk_error(error: OSError, directory: object) -> UserError:
    """A failed write in words: which place, why, and what to do."""
    place = error.filename or directory
    if error.errno in FULL:
        return UserError(
            f"no space left on the disk of {place}, or a limit on files is too low: make room and run the same "
            "command again, nothing finished is lost"
        )
    reason = error.strerror or str(error)
    return UserError(
        f"cannot read or write {place}: {reason}; change its permissions, or choose another directory with --out"
    )


@contextmanager
def writing(directory: Path) -> Iterator[None]:
    """Make a directory for results if it is missing; what cannot be written in it becomes a UserError."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        yield
    except BrokenPipeError:  # of our own output, see `run_command`
        raise
    except OSError as error:
        raise disk_error(error, directory) from None


def _open_streams() -> None:
    """Take any terminal: none (a daemon), or one whose encoding lacks a character, which becomes a question mark."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  (to the end)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def run_command(main: Callable[[], int], resumes: bool = False) -> None:
    """Run a command's `main` and leave the process with its exit status (0, 1, 2 or 130).

    SIGINT and SIGTERM end it with one line: in order, as KeyboardInterrupt, or after LEAVE seconds wherever it is,
    which harms nothing, because every file is written atomically.

    Args:
        resumes: whether the same command goes on where it was stopped, which is then said.
    """
    _open_streams()
    again = f"; what is finished is kept. To go on: {shlex.join(['python', *sys.argv])}" if resumes else ""
    said = threading.Lock()

    def say() -> None:
        if said.acquire(blocking=False):
            print(f"interrupted{again}", file=sys.stderr, flush=True)

    def leave() -> None:
        say()
        os._exit(INTERRUPTED)

    def interrupt(number: int, frame: object) -> None:
        for each in (signal.SIGINT, signal.SIGTERM):
            signal.signal(each, signal.SIG_IGN)
        timer = threading.Timer(LEAVE, leave)
        timer.daemon = True
        timer.start()
        raise KeyboardInterrupt

    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, interrupt)
    try:
        try:
            status = main()
        finally:
            sys.stdout.flush()
    except (UserError, DamagedFile) as error:
        print(f"error: {error}", file=sys.stderr)
        status = USAGE
    except ModuleNotFoundError as error:
        print(f"error: {error}: install it (make setup)", file=sys.stderr)
        status = USAGE
    except KeyboardInterrupt:
        say()
        status = INTERRUPTED
    except BrokenPipeError:  # the reader of our output (head, less) has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 1
    except OSError as error:
        if error.filename is None and error.errno not in FULL:
            raise
        print(f"error: {disk_error(error, 'the files to write')}", file=sys.stderr)
        status = USAGE
    sys.exit(status)
