"""A sweep of the fake task, without its report: python fake_sweep.py DIRECTORY OPTIONS, which are JSON."""

import json
import sys
from pathlib import Path

from experiments.study.design.presets import cells_of, of_preset
from experiments.study.results.store import Store
from experiments.support.errors import run_command
from experiments.sweep import Options, compute
from tests.experiments.fake_env import make_env


def main() -> int:
    """As of experiments/sweep.py."""
    directory = Path(sys.argv[1])
    cells = cells_of(of_preset(Options, **json.loads(sys.argv[2])))
    Store(directory).write_sweep("sweep", cells)
    return bool(compute(cells, directory, make_env, workers=2))


if __name__ == "__main__":  # and not in its workers
    run_command(main, resumes=True)
