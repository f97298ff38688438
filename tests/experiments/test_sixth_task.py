"""A task more in the catalogue: it is studied without any other change, and what lacks the task says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.processes import ended

STUDY = """
import sys
from pathlib import Path

import tests.experiments.ramp as ramp
from experiments import report, sweep
from experiments.study.design.sheet import SHEETS
from experiments.study.results.store import load
from experiments.sweep import Options, UserError

def refused(function, options):
    try:
        function(options)
    except UserError as error:
        print(error)

asked = {"out": Path(sys.argv[1]), "tasks": ("on-ramp",), "preset": "smoke", "seeds": 2, "updates": 40, "workers": 2}
assert sweep.sweep(Options(**asked, dry_run=True)) == 0
for lacking in ({"backend": "replica"}, {"test_on": ("highway-env",)}):
    refused(sweep.sweep, Options(**asked, **lacking, dry_run=True))
print("the dry runs have ended", file=sys.stderr)
assert sweep.sweep(Options(**asked), make_env=ramp.make_env, check=list) == 0
analysis = report.analyse(load(asked["out"]))
assert set(analysis.effects["task"]) == {"on-ramp"} and set(analysis.claims["right"]) == {0}
assert set(analysis.claims["verdict"]) == {"not decided"} and set(analysis.effects["family"].fillna("")) == {""}
del SHEETS["on-ramp"]
refused(sweep.cells_of, Options(**asked))
"""


@pytest.mark.slow
def test_it_is_studied_and_what_lacks_it_says_so(tmp_path: Path) -> None:
    """In a process of its own, in which the task is registered. A dry run starts no simulator."""
    done = ended("-c", STUDY, tmp_path / "ramp")
    assert done.returncode == 0, done.stderr
    assert "a simulator starts" not in done.stderr.partition("the dry runs have ended")[0]
    assert "on-ramp: not in fingerprints.json" in done.stdout and "4 agents" in done.stdout
    assert "on-ramp" in (tmp_path / "ramp" / "appendix.html").read_text()
    there = "highway, two-way, roundabout, intersection, u-turn"
    lacks = [f"the backend {name} has no task on-ramp: it has {there}" for name in ("replica", "highway-env")]
    assert all(line in done.stdout.splitlines() for line in lacks)
    assert done.stdout.rstrip().endswith(f"add its sheet there (there are {there})")
