"""Write the golden results anew, then review the difference: see README.md in this folder.

python tests/golden/regenerate.py                     # everything, half a minute
python tests/golden/regenerate.py outcomes merge      # some parts (scenes, outcomes), some tasks
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
if __name__ == "__main__":  # run as a file: import from the project, not from this folder
    sys.path[0] = str(ROOT)

from experiments.support import limit_threads

limit_threads()

from sumo_env.tasks import TASKS
from tests.golden import outcomes, scenes

FOLDER = Path(__file__).resolve().parent
WIDTH = 110


PARTS = {"scenes": scenes.table, "outcomes": outcomes.table}  # of a task: one file each


def pretty(value: Any, indent: int = 0) -> str:
    """JSON with one line for everything that fits into one, so that a difference shows which value changed."""
    line = json.dumps(value)
    if len(line) + indent <= WIDTH or not isinstance(value, dict | list) or not value:
        return line
    pad, end = "\n" + " " * (indent + 1), "\n" + " " * indent
    if isinstance(value, dict):
        items = [f"{json.dumps(key)}: {pretty(item, indent + 1)}" for key, item in value.items()]
        return "{" + pad + f",{pad}".join(items) + end + "}"
    return "[" + pad + f",{pad}".join(pretty(item, indent + 1) for item in value) + end + "]"


def read(name: str) -> Any:
    """A golden result by the name of its file."""
    return json.loads((FOLDER / name).read_text())


def main(names: list[str]) -> None:
    """Write the files of some parts and some tasks; of all by default."""
    if unknown := set(names) - {*PARTS, *TASKS}:
        raise SystemExit(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join([*PARTS, *TASKS])}")
    parts, tasks = ([name for name in names if name in known] or known for known in (PARTS, TASKS))
    for part in parts:
        for task in tasks:
            (FOLDER / part / f"{task}.json").write_text(pretty(PARTS[part](task)) + "\n")
            print(f"{part}/{task}.json", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
