"""A sweep of the fake task, without its report: python fake_sweep.py DIRECTORY OPTIONS, which are JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

if __name__ == "__main__":  # and not in its workers
    module = ModuleType("experiments.report")
    module.print_report = module.report_placebo = print
    sys.modules["experiments.report"] = module
    from experiments.support.errors import run_command
    from experiments.sweep import Options, sweep
    from tests.experiments.fake_env import make_env

    options = Options(out=Path(sys.argv[1]), **json.loads(sys.argv[2]))
    run_command(lambda: sweep(options, make_env=make_env))
