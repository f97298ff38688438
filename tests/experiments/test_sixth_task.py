"""A task more in the catalogue: all commands start, and what lacks the task says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.processes import ROOT, ended, python, python_again

PRELUDE = "import tests.experiments.ramp as ramp\n"
COMMANDS = sorted(
    path.stem
    for path in (ROOT / "experiments").glob("*.py")
    if "__main__" in path.read_text(encoding="utf-8")
)
CALL = """
import runpy, sys
for command in {commands}:
    sys.argv = [f"experiments/{{command}}.py", *{arguments}]
    try:
        runpy.run_path(sys.argv[0], run_name="__main__")
    except SystemExit as exit:
        assert not exit.code, (command, exit.code)
    print(f"{{command}} has ended")
"""


def called(*commands: str, arguments: tuple[str, ...]) -> str:
    """What commands print, in one process."""
    return python_again("-c", PRELUDE + CALL.format(commands=commands, arguments=arguments))


def test_every_command_starts() -> None:
    said = called(*COMMANDS, arguments=("--help",))
    assert COMMANDS and all(f"{command} has ended" in said for command in COMMANDS)


def test_a_dry_run_starts_no_simulator(tmp_path: Path) -> None:
    code = PRELUDE + CALL.format(
        commands=("sweep",),
        arguments=(
            "--tasks",
            "on-ramp",
            "u-turn",
            "--preset",
            "smoke",
            "--dry-run",
            "--out",
            str(tmp_path / "x"),
        ),
    )
    result = ended("-c", code)
    assert result.returncode == 0, result.stderr
    assert "a simulator starts" not in result.stderr
    assert "on-ramp: not in fingerprints.json" in result.stdout and "4 agents" in result.stdout


LACKING = """
from experiments.sweep import Options, UserError, sweep

for asked in ({"backend": "replica"}, {"test_on": ("highway-env",)}):
    try:
        sweep(Options(tasks=("on-ramp",), dry_run=True, **asked))
    except UserError as error:
        print(error)
"""


def test_a_backend_that_lacks_it_says_so() -> None:
    said = python_again("-c", PRELUDE + LACKING).splitlines()
    lacks = "the backend {} has no task on-ramp: it has highway, two-way, roundabout, intersection, u-turn"
    assert said == [lacks.format("replica"), lacks.format("highway-env")]


SWEEP = """
import sys
from pathlib import Path
from experiments import report, sweep
from experiments.study.results.store import load
from experiments.sweep import Options

options = Options(out=Path(sys.argv[1]), tasks=("on-ramp",), preset="smoke", seeds=2, updates=40, workers=2)
assert sweep.sweep(options, make_env=ramp.make_env, check=list) == 0
analysis = report.analyse(load(options.out))
assert set(analysis.effects["task"]) == {"on-ramp"} and set(analysis.claims["right"]) == {0}
assert set(analysis.claims["verdict"]) == {"not decided"} and set(analysis.effects["family"].fillna("")) == {""}
from experiments.study.design.sheet import SHEETS
del SHEETS["on-ramp"]
try:
    sweep.cells_of(options)
except report.UserError as error:
    print(error)
"""


@pytest.mark.slow
def test_it_is_studied_and_without_its_sheet_an_error_names_the_file(tmp_path: Path) -> None:
    said = python("-c", PRELUDE + SWEEP, str(tmp_path / "ramp"))
    assert "on-ramp" in (tmp_path / "ramp" / "appendix.html").read_text()
    assert said.splitlines()[-1].endswith(
        "add its sheet there (there are highway, two-way, roundabout, intersection, u-turn)"
    )
