"""Where SUMO writes the files of each episode."""

from __future__ import annotations

import tempfile
from pathlib import Path

from sumo_env.sumo.paths import is_output

TO_THE_ROOT = "../" * 64  # from any folder
NO_FILES = ("stdout", "stderr", "/dev/null", "NUL", "nul")  # that SUMO can write to


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
