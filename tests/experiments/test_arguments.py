"""Any arguments of the sweep: cells, or one line that says what is wrong."""

import json
import re
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tyro.conf import Fixed

from agents.learners import LEARNERS
from agents.rules import DRIVERS
from experiments import evaluate, rare, sweep, train
from experiments.backends import BACKENDS
from experiments.study.compute.executors import EXECUTORS
from experiments.study.design.arms import EVERY_ARM
from experiments.study.design.experiment import shard
from experiments.study.design.presets import PRESETS, asked_preset, cells_of, of_preset
from experiments.study.design.traffic import ALL
from experiments.support.arguments import parsed, split_arguments
from experiments.support.errors import UserError
from experiments.sweep import Options
from sumo_env.tasks import TASKS
from tests.processes import ROOT, ended, python_again

WORDS = st.text(max_size=12)


def usual(words: Sequence[str]) -> Options:
    """What sweep.py takes for what its command line does not say."""
    return of_preset(Options, asked_preset(words))


NUMBERS = st.integers(-10, 10**7)


def some(known, other=WORDS):
    """Mostly what exists, sometimes anything."""
    return st.one_of(st.sampled_from(list(known)), other)


def several(known, most=2, other=WORDS):
    return st.lists(some(known, other), max_size=most).map(tuple)


SETTINGS = "gamma=0.9 gamma=NaN device=cpu gama=1 = n_steps=8 training_clock=[15,15] training_clock=7"
CONFIG = "collision_reward=-2 risk_law=linear none=1 = duration action.target_speeds=[5,9] action.x=1"
ARGUMENTS = {
    "backend": some(BACKENDS),
    "preset": some(PRESETS),
    "tasks": several(TASKS, 3),
    "levels": several([1, 2, 3, 9, -1, 0], 3, NUMBERS),
    "seeds": st.integers(-3, 30),
    "first_seed": NUMBERS,
    "episodes": NUMBERS,
    "first_scenario": NUMBERS,
    "updates": st.none() | NUMBERS,
    "crash_reward": st.none() | st.floats(),
    "frontier": st.booleans(),
    "unseen": st.booleans(),
    "traffics": several(ALL),
    "learner": some([*LEARNERS, "none.py:learner"]),
    "settings": several(SETTINGS.split()),
    "network": st.none() | some(["attention", "dueling", "none.py:Net", ":", "a:b:c"]),
    "policy": several(["none.py:make", "none.zip"], 1),
    "arms": several(EVERY_ARM, 3),
    "drivers": several(DRIVERS),
    "placebo": st.booleans(),
    "test_on": several(BACKENDS),
    "config": several(CONFIG.split()),
    "features": several(["x", "tcpa", "dcpa", "tcba"]),
    "shard": some(["1/1", "2/3", "3/2", "0/1", "1/0", "²/³", "1/2/3"]),
}


@settings(max_examples=300, deadline=None, derandomize=True)
@given(arguments=st.fixed_dictionaries({}, optional=ARGUMENTS))
def test_arguments_give_cells_or_one_clear_line(arguments):
    try:
        options = of_preset(Options, **arguments)
        cells = cells_of(options)
        mine = shard(cells, options.shard)
    except UserError as error:
        assert str(error).strip()
        assert "\n" not in str(error)
        return
    assert cells
    names = [cell.name for cell in cells]
    assert len(set(names)) == len(names)
    for cell in cells[:3]:
        assert json.loads(json.dumps(cell.key(), allow_nan=False)) == cell.key()
        assert len(f"{cell.name}.tmp") < 200  # a file's name
        assert "/" not in cell.name
    assert {cell.name for cell in mine} <= set(names)
    tested = [
        (cell.task, cell.level, cell.arm, cell.seed, cell.runs_on, traffic)
        for cell in cells
        if cell.arm
        for traffic in cell.tested["traffics"]
    ]
    assert len(set(tested)) == len(tested)


def test_every_argument_that_chooses_cells_is_tried():
    others = {"out", "workers", "executor", "cell", "dry_run"}
    hidden = {
        name for name, kind in get_type_hints(Options, include_extras=True).items() if Fixed in get_args(kind)
    }
    assert {field.name for field in fields(Options)} - others - hidden == set(ARGUMENTS)


def test_the_help_names_all_that_can_be_asked_for(capsys):
    with pytest.raises(SystemExit):
        parsed(Options, ["--help"], "", default=lambda _: of_preset(Options))
    said = set(re.findall(r"[\w-]+", capsys.readouterr().out))
    assert {*PRESETS, *EVERY_ARM, *BACKENDS, *TASKS, *EXECUTORS, *LEARNERS, *DRIVERS} <= said
    assert "--learners" not in said  # presets alone


@pytest.mark.parametrize(("command", "default"), [(sweep, usual), (train, train.default)])
def test_the_examples_of_the_help_ask_for_what_there_is(command, default):
    lines = re.findall(rf"experiments/{Path(command.__file__).name}([^#\n]*)", command.__doc__)
    assert lines
    for line in lines:
        assert cells_of(parsed(command.Options, line.split(), "", default=default))


def test_a_repeated_option_adds_values_and_a_comma_separates_them():
    words = ["--policy", "a:make", "--seeds=2", "--policy", "b.zip", "--placebo", "--policy=c"]
    found = split_arguments([*words, "--tasks", "highway,u-turn", "--out", "a,b"], Options)
    expected = "--policy a:make b.zip c --seeds 2 --tasks highway u-turn --out a,b --placebo"
    assert found == expected.split()


def test_one_task_or_several_are_named_alike():
    for words in (["idle", "--tasks", "u-turn"], ["--task", "u-turn", "idle"], ["--task=u-turn", "idle"]):
        asked = parsed(rare.Options, words, "")
        assert (asked.task, asked.policies) == ("u-turn", ("idle",))
    assert parsed(evaluate.Options, ["idle", "--task=u-turn,merge"], "").tasks == ("u-turn", "merge")


def test_an_option_sets_a_preset_back(monkeypatch):
    """An empty list is a value."""
    monkeypatch.setitem(PRESETS, "quick", replace(PRESETS["quick"], traffics=("measured",)))
    found = parsed(Options, ["--traffics", "--levels", "--arms", "control", "treatment"], "", usual)
    assert (found.traffics, found.levels, found.arms) == ((), (), ("control", "treatment"))
    assert parsed(Options, ["--preset", "study"], "", usual) == of_preset(Options, "study")


@pytest.mark.parametrize(
    "no", ["--placebo=False", "--placebo=no", "--placebo no", "--no-placebo", "--no-placebo=yes"]
)
def test_a_flag_is_what_is_written(no):
    for yes in ("--placebo", "--placebo=True", "--placebo yes", "--no-placebo=no", f"{no} --placebo"):
        assert parsed(Options, yes.split(), "", usual).placebo
    assert not parsed(Options, no.split(), "", usual).placebo
    assert split_arguments(["--plain", "a", "--task", "b"], rare.Options) == ["a", "--task", "b", "--plain"]


@pytest.mark.slow
def test_a_wrong_command_line_is_answered_without_a_traceback(tmp_path):
    """From any folder. What cannot be written: study/test_foreign_files.py."""
    with pytest.raises(SystemExit):
        parsed(Options, ["--seeds", "1.5"], "", usual)
    result = ended(ROOT / "experiments/sweep.py", "--preset", "quik", cwd=tmp_path)
    assert result.returncode == 2, result
    assert "Traceback" not in result.stderr + result.stdout
    assert result.stderr.strip()
    assert not list(tmp_path.iterdir())


def test_every_command_starts_and_hides_nothing_of_the_standard_library() -> None:
    """No script leaves its own folder on the path."""
    code = f"""
import runpy, sys
from pathlib import Path
from typing import get_args, get_type_hints

for script in sorted(Path({str(ROOT / "experiments")!r}).glob("*.py")):
    if "__main__" in script.read_text():
        sys.argv, sys.path[0] = [str(script), "--help"], str(script.parent)
        try:
            runpy.run_path(str(script), run_name="__main__")
        except SystemExit as end:
            assert not end.code, script
        assert sys.path[0] != str(script.parent), script
"""
    python_again("-c", code)
