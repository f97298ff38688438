"""Files that SUMO reads and writes: names that it understands, and folders of this process."""

import atexit
import os
import re
import shutil
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from sumo_env.config import ConfigError

try:
    import fcntl
except ImportError:  # as on Windows
    fcntl: Any = None  # type: ignore[no-redef]

TO_THE_ROOT = "../" * 64  # from any folder
NO_FILES = ("stdout", "stderr", "/dev/null", "NUL", "nul")  # that SUMO can write to
LOGS = {"log", "message-log", "error-log", "netstate-dump", "device.ssm.file", "device.toc.file"}
LOGS |= {"pedestrian.jupedsim.wkt", "pedestrian.jupedsim.py"}


PREFIX = "sumo_env-"  # of temporary folders
_folders: dict[int, Path] = {}  # by the process that has them


def is_output(option: str) -> bool:
    """Whether an option of SUMO names a file that it writes."""
    return (option.endswith("output") and option != "human-readable-output") or option in LOGS


class EpisodeFolders:
    """The folders ``environment-.../episode-1``, ... of a simulator, in a user's `output_dir`."""

    def __init__(self, parent: str) -> None:
        """parent: the user's folder."""
        self._parent, self._folder, self._episodes = parent, "", 0

    def new(self) -> Path:
        """A new folder, for the next episode."""
        if not self._folder:
            Path(self._parent).mkdir(parents=True, exist_ok=True)
            self._folder = tempfile.mkdtemp(prefix="environment-", dir=self._parent)
        self._episodes += 1
        folder = Path(self._folder) / f"episode-{self._episodes}"
        folder.mkdir()
        return folder


def prefix(folder: Path) -> dict[str, str]:
    """The option with which SUMO writes all its files into a folder.

    SUMO puts the prefix between the folder and the name of every file that it writes.
    """
    return {"output-prefix": f"{TO_THE_ROOT}{str(folder).lstrip('/')}/"}


def written(options: dict[str, str]) -> list[str]:
    """Those of SUMO's options that name files which SUMO writes."""
    return [name for name, value in options.items() if is_output(name) and value not in NO_FILES]


def listed(*files: str | Path | None) -> str:
    """Files as one option of SUMO names them; there may be none in a place."""
    return ",".join(str(file) for file in files if file)


def plain_path(path: Path) -> Path:
    """A path to a file that SUMO understands: to it a comma ends a name, and ``${...}`` is a variable.

    Raises:
        ConfigError: there is none, because all folders for temporary files have such names.
    """
    return path if _is_plain(path) else _linked(path, os.getpid())


@cache
def _linked(path: Path, process: int) -> Path:
    """A link to a file: of this process, because a copy of it may live longer."""
    folder = own_folder() / "links"
    folder.mkdir(exist_ok=True)
    ending = re.search(r"(\.\w+)*$", path.name)
    assert ending is not None
    link = folder / f"{len(list(folder.iterdir()))}{ending[0]}"
    if not _is_plain(path.name):
        link.symlink_to(path)
        return link
    link.symlink_to(path.parent, target_is_directory=True)  # files beside this one can be found as well
    return link / path.name


def _is_plain(path: str | Path) -> bool:
    name = str(path)
    return name.isprintable() and "," not in name and "${" not in name  # in the locale C umlauts are no text


def temporary_folder() -> str:
    """A folder for temporary files with a name that SUMO understands.

    Raises:
        ConfigError: there is none.
    """
    folders = (tempfile.gettempdir(), "/tmp", "/var/tmp")
    for folder in folders:
        if _is_plain(folder) and os.access(folder, os.W_OK):
            return folder
    raise ConfigError(f"SUMO takes no folders with a comma or $: set TMPDIR (tried: {'; '.join(folders)})")


def own_folder() -> Path:
    """A folder for files of this process, which deletes it at its end; a copy of the process has its own.

    That of a process that was killed is deleted by a later one, which finds its lock free.
    """
    if os.getpid() not in _folders:
        parent = temporary_folder()
        for lock in Path(parent).glob(f"{PREFIX}*/lock"):
            with suppress(OSError), lock.open("rb") as left:
                _hold(left.fileno())
                shutil.rmtree(lock.parent, ignore_errors=True)
        folder = _folders[os.getpid()] = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        with suppress(OSError):
            _hold(os.open(folder / "new", os.O_CREAT | os.O_WRONLY))  # which stays open
            (folder / "new").rename(folder / "lock")  # once it is not free
        atexit.register(delete_own_folder)
    return _folders[os.getpid()]


def delete_own_folder() -> None:
    """Delete the folder of this process, if it has one."""
    if folder := _folders.pop(os.getpid(), None):
        shutil.rmtree(folder, ignore_errors=True)


def _hold(lock: int) -> None:
    """Hold the lock of an open file until this process and all its copies have ended; OSError where that cannot be."""
    if fcntl is None:
        raise OSError("this system has no such locks")
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
