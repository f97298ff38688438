"""What the commands refuse: a row is what a user asks for, and the word of the UserError that says what to do."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from experiments import attainable, rare, report, takeover, validate, watch
from experiments import evaluate as command
from experiments.study.compute.entrants import entrant_of
from experiments.study.compute.evaluate import evaluate
from experiments.study.design import experiment
from experiments.study.design.levels import choose_levels, choose_tasks
from experiments.study.design.presets import cells_of, of_preset
from experiments.study.results.loaded import load
from experiments.study.results.store import Store
from experiments.support.arguments import parsed, split_arguments
from experiments.support.errors import UserError
from experiments.support.films import check_film
from experiments.sweep import Options, sweep
from tests.experiments.computed import TINY
from tests.experiments.fake_env import make_env
from tests.experiments.study.test_experiment import cells
from tests.processes import ended

FILES = {
    "mine.py": "class Mine:\n    def __init__(self, env): pass\n    def act(self, observation): return 4\n",
    "model.zip": "no model",
    "pictures.py": "def make(env):\n    raise ValueError('trained for pictures')\n",
    "outcomes.py": "from experiments.analysis.plan import Outcome\nnothing = Outcome('Nothing', '', 0, 1)\n"
    "crashed = Outcome('Crashed', '', 0, 1, of=len)\n",
    "frozen/analysis.json": "",
}


CELLS: list[tuple[dict[str, Any], str]] = [
    ({"backend": "summo"}, "did you mean 'sumo'"),
    ({"seeds": 0}, "at least one seed"),
    ({"first_seed": -1}, "number of a training"),
    ({"arms": ("treatmen",)}, "did you mean 'treatment'"),
    ({"config": ("vehicle_count=3",)}, "did you mean 'vehicles_count'"),
    ({"config": ("risk_law=linear",)}, "of the backends replica and highway-env"),
    ({"config": ("risk=1",)}, "risk cannot be set"),
    ({"config": ("duration",)}, "KEY=VALUE"),
    ({"learner": "sb3-pp"}, "did you mean 'sb3-ppo'"),
    ({"learner": "sb3-ppo", "settings": ("gama=0.9",)}, "'gama' of the learner sb3-ppo"),
    ({"learner": "sb3-ppo", "network": "dueling"}, "'network' of the learner sb3-ppo"),
    ({"learners": lambda _: {"wam_up": 5}}, "did you mean 'warm_up'"),
    ({"settings": ("gamma",)}, "--settings takes KEY=VALUE"),
    ({"first_scenario": -1}, "the number of a scenario is from 0"),
]


RARE: list[tuple[dict[str, Any], str]] = [
    ({"task": "u-trun"}, "u-turn"),
    ({"level": "4"}, "level"),
    ({"policy": "carefull"}, "careful"),
    ({"policy": "none.py:make"}, "none.py"),
    *(({"dose": dose}, "--dose is between") for dose in (0.0, 2.0)),
    ({"reach": -1.0}, "--reach"),
    *(({name: -1}, f"--{name} is at least") for name in ("episodes", "seed", "workers")),
    *(({"rates": rates}, "LOW:HIGH") for rates in ("1e-4:x", "0", "1:2:3")),
    ({"executor": "cloud"}, "executor"),
]
TAKEOVER: list[tuple[dict[str, Any], str]] = [
    ({"task": "u-turm"}, "u-turn"),
    ({"level": "4"}, "level"),
    ({"traffics": ("risk",)}, "risky"),
    ({"others": ("careful",)}, "others"),
    ({"scenarios": 0}, "--scenarios is at least 1"),
    ({"first_scenario": -1}, "--first-scenario is from 0"),
    ({"within": ()}, "--within is"),
    ({"workers": 0}, "--workers is"),
    ({"config": ("policy_frequency",)}, "--config takes KEY=VALUE"),
    ({"config": ("target_speeds=3",)}, "it belongs in config"),
    ({"config": ('action={"type":"DiscreteMetaAction","longitudinal":false}',)}, "choose meta-actions"),
    ({"a": "slower,idle"}, "as many of both, not 2 and 1"),
    ({"a": "planner", "b": "sumo"}, "one of the two has to lead"),
    ({"b": "pictures.py:make"}, "pictures.py:make cannot make a policy: ValueError: trained for pictures"),
    ({"b": "highway-50/control"}, "trained for u-turn"),
    ({"b": "none/control"}, "unknown policy"),
]
ATTAINABLE: list[tuple[dict[str, Any], str]] = [
    ({"width": 0}, "width"),
    ({"scenarios": 1}, "scenarios"),
    ({"policies": ("careful",)}, "policies"),
    ({"tasks": ("nowhere",)}, "nowhere"),
]


def smoke(**asked: Any) -> Callable[[], Any]:
    return lambda: cells_of(of_preset(Options, "smoke", **asked))


def swept(**asked: Any) -> Callable[[], Any]:
    options = of_preset(Options, **{"out": Path("results"), **TINY, **asked})
    return lambda: sweep(options, make_env=make_env, check=lambda _: None)


def validated(**part: Any) -> Callable[[], Any]:
    return lambda: validate.validate(validate.Options(Path("results"), update=True, **part))


def evaluate_card(policy: str, **asked: Any) -> None:
    """In which nothing is driven."""
    command.evaluated(command.Options(policy, quick=True, **asked), [])


def how_rare(policy: str = "slower", task: str = "u-turn", **asked: Any) -> None:
    usual: dict[str, Any] = {"rates": "0.3,1", "dose": 0.3, "episodes": 80, "out": Path("results")}
    rare.rare(rare.Options((policy,), task, **{**usual, **asked}), [])


def taken_over(**asked: Any) -> None:
    usual = takeover.Options("faster", "careful", "u-turn", traffics=("risky",))
    takeover.takeover(replace(usual, **asked), [])


def empty() -> None:
    Store(Path("new")).write_sweep("none", [])
    load(Path("new"))


ROWS: list[tuple[Callable[[], Any], str]] = [
    (lambda: choose_tasks(["higway"]), "did you mean 'highway'"),
    (lambda: choose_levels(["highway"], [4]), "known are 1, 2, 3"),
    *((partial(cells, **asked), word) for asked, word in CELLS),
    (lambda: experiment.shard([], "3/2"), "1 <= i <= n"),
    (smoke(tasks=("highway", "u-turn"), levels=(4,)), "--tasks highway asks for nothing"),
    (smoke(test_on=("sumo", "replica")), "--test-on sumo asks for nothing"),
    (smoke(drivers=("planner", "sumo"), backend="replica"), "--drivers sumo asks for nothing"),
    (smoke(placebo=True, arms=("mixed",)), "leave out --arms"),
    (smoke(seeds=1_000_000), "at most 1,000 seeds"),
    (smoke(config=('action={"type": "ContinuousAction"}',)), "choose meta-actions"),
    (swept(cell="nobody", dry_run=True), "of 8 cells begin with 'nobody'"),
    (lambda: split_arguments(["--placebo=maybe"], Options), "true, false, yes or no, not 'maybe'"),
    (lambda: split_arguments(["--out", "-x"], Options), "written ./-x"),
    (smoke(tasks=("highway",), backend="replica", traffics=("measured",)), "measured has drivers that replica has not"),
    (lambda: evaluate(None, None, "u-turn", 1, [0], ["risk"]), "did you mean 'risky'"),
    # what would fail after the trainings is refused before them
    (swept(policy=("model.zip",)), "no model of Stable-Baselines3"),
    (swept(settings=("device=toaster",)), "device toaster"),
    (swept(executor="slurm"), "--executor slurm is for machines"),
    (partial(evaluate_card, "slower", tasks=("uturn",)), "did you mean 'u-turn'"),
    (lambda: parsed(command.Options, ["--tasks", "u-turn", "idle"], ""), "POLICY is missing: name it before"),
    (partial(evaluate_card, "nowhere.zip"), "there is no file nowhere.zip"),
    (partial(evaluate_card, "nowhere.py:make"), "there is no file nowhere.py"),
    (lambda: parsed(rare.Options, ["idle", "--task", "my.py:Mine"], ""), "There is no file my.py"),
    (partial(evaluate_card, "treatment", tasks=("merge",)), "cannot drive merge"),
    (partial(evaluate_card, "slower", tasks=("u-turn",), out=Path("mine.py")), "mine.py"),
    (partial(evaluate_card, "."), "has weights:"),
    (partial(evaluate_card, "carefull", tasks=("u-turn",)), "did you mean 'careful'"),
    (partial(evaluate_card, "highway-50/control", tasks=("u-turn",)), "cannot drive u-turn"),
    *((partial(entrant_of, policy, "u-turn", "3"), word) for policy, word in [
        ("mine.py", "mine.py is no zip file; what makes a policy in a Python file is named as mine.py:make"),
        ("results/mine", "no directory results/mine"), ("u-turn-3/contrl", "'u-turn-3/contrl': did you mean"),
    ]),
    *((partial(how_rare, **asked), word) for asked, word in RARE),
    *((partial(taken_over, **asked), word) for asked, word in TAKEOVER),
    *((partial(attainable.batches, attainable.Options(**asked)), word) for asked, word in ATTAINABLE),
    # results and what is made of them
    (lambda: load(Path("nowhere")), "no results"),
    (lambda: watch.watch(watch.Options(Path("nowhere"), scenario=-1)), "counts from 0"),
    (empty, "no finished cell"),
    *((partial(report.own_outcome, name), word) for name, word in [
        ("outcomes.py:nothing", "function `of`"), ("outcomes.py:nobody", "defines no"), ("outcomes.py", "FILE:NAME"),
        ("outcomes.py:crashed", "already"),
    ]),
    (lambda: report.write_report(Path("frozen")), "FROZEN.md"),
    (lambda: check_film(Path("film.gif.txt"), ".gif"), "ends in"),
    (lambda: check_film(Path("nowhere/film.gif"), ".gif"), "there is no folder"),
    (validated(quick=True), "--update"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "word"), ROWS, ids=[f"{k}-{row[1]}" for k, row in enumerate(ROWS)])
def test_what_is_asked_for_is_refused_in_one_line(call, word: str, tmp_path: Path, monkeypatch) -> None:
    """Before anything is written."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", "")  # on which there is no Slurm
    for name, text in FILES.items():
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(text)
    with pytest.raises(UserError) as caught:
        call()
    assert word in str(caught.value) and "\n" not in str(caught.value)
    assert not Path("results").exists()


@pytest.mark.parametrize(("typed", "shown"), [("sweep.py", ""), ("evaluate.py --help", "frozen test")])
def test_what_is_not_installed_is_told_in_a_line_beside_the_help(typed: str, shown: str) -> None:
    """After ``pip install .`` alone."""
    code = "import runpy, sys; sys.modules['tyro'] = sys.modules['pandas'] = None; "
    code += f"sys.argv = {typed.split()}; runpy.run_path('experiments/' + sys.argv[0], run_name='__main__')"
    done = ended("-c", code)
    assert done.returncode == 2 and shown in done.stdout and len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("error: pandas, tyro not installed") and "make setup" in done.stderr
