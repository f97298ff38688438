"""How close SUMO is to highway-env, task by task, as `experiments/validate.py --update` has stored it."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from experiments.study.design.sheet import task_of
from experiments.support.files import read_json

STORED = Path(__file__).resolve().parents[2] / "validation" / "verdict.json"


def verdicts(cells: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """The stored verdict on the tasks of cells, by task; empty where one of them has other dynamics or versions.

    cells: cell.json of each, on SUMO.
    """
    stored, found = read_json(STORED), {}
    for cell in cells:
        task = task_of(cell["key"]["task"])
        own = stored.get(task, {"fingerprint": None})
        if (
            cell["key"]["dynamics"] != own["fingerprint"]
            or not own["versions"].items() <= cell["versions"].items()
        ):
            return {}
        found[task] = own
    return found
