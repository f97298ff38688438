"""Write the golden results anew.

    python tests/golden/regenerate.py            # of all tasks
    python tests/golden/regenerate.py merge      # of some

scenes/TASK.json has four policy steps of two seeds, lightest and densest level, risk 0 and 1, within 1e-6. An intended
change of behaviour changes these files in the same commit, regenerated and reviewed; the message says why.
"""

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
from tests.golden import scenes

FOLDER = Path(__file__).resolve().parent / "scenes"
WIDTH = 110


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


def read(task: str) -> Any:
    """The golden scenes of a task."""
    return json.loads((FOLDER / f"{task}.json").read_text())


def main(tasks: list[str]) -> None:
    """Write the files of some tasks, of all by default."""
    if unknown := set(tasks) - {*TASKS}:
        raise SystemExit(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(TASKS)}")
    for task in tasks or TASKS:
        (FOLDER / f"{task}.json").write_text(pretty(scenes.table(task)) + "\n")
        print(f"{task}.json", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
