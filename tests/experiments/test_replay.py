"""One stored episode again: the same numbers, as a picture, an animation or a scenario for SUMO."""

import shutil
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from PIL import Image

import agents
from agents import pretrained
from experiments import watch
from experiments.replay import Options, parse_case, replay
from experiments.study.compute.policies import driver
from experiments.study.design.cell import tested_on as environment_of
from experiments.study.replaying.rerun import Case, changed_versions, differences, play_again
from experiments.study.results import store
from experiments.study.results.schema import EPISODES
from experiments.study.results.store import find_cell
from experiments.support.errors import UserError
from tests.experiments.computed import compute, tasks_of
from tests.experiments.fake_env import make_env, make_other_env


@pytest.fixture(scope="module")
def cells(tmp_path_factory):
    """Directories of a stored agent, of a baseline that crashes, and of one that does not."""
    home = tmp_path_factory.mktemp("results")
    tasks = tasks_of(home, tasks=("highway",), updates=100, network=None)
    chosen = [t for t in tasks if t.cell.arm == "control" or t.cell.policy in ("random", "slower")]
    compute(chosen)
    return [home / "cells" / task.name for task in chosen]


def episodes(cell):
    return store.Store(cell.parents[1]).tables(cell.name)[EPISODES]


def first(cells, crashed):
    """The first episode with a crash, or without one: its case and its row."""
    rows = ((cell, row) for cell in cells for row in episodes(cell).to_dict("records"))
    cell, row = next((cell, row) for cell, row in rows if row["crashed"] == crashed)
    return f"{cell}:{row['traffic']}:{row['scenario']}", row


def test_the_policy_itself_drives_and_its_actions_are_compared(cells, tmp_path, capsys):
    """Not the actions that it once chose, which say nothing about the agent."""
    for number, cell in enumerate(cells):
        options = Options(f"{cell}:risky:1", out=tmp_path / f"{number}.gif")
        assert replay(options, make_env) == 0
        assert "from the stored actions" in capsys.readouterr().out
        assert replay(replace(options, policy=True), make_env) == 0
        assert "the agent chose the stored actions" in capsys.readouterr().out
    case = parse_case(f"{cells[0]}:risky:1")
    others = "0" if case.row["actions"][0] != "0" else "1"
    wrong = replace(case, row={**case.row, "actions": others + case.row["actions"][1:]})
    driven = play_again(wrong, make_env(*environment_of(case.record["key"])), closed_loop=True)
    assert driven["actions"] == case.row["actions"]
    assert differences(wrong.row, driven) == [
        f"actions {case.row['actions']} instead of {wrong.row['actions']}"
    ]


def test_a_published_agent_drives_its_stored_episode_again(cells, tmp_path, capsys):
    """From the file of agents in the folder, in half precision."""
    home = Path(shutil.copytree(cells[0].parents[1], tmp_path / "results"))
    agent = store.Store(home)
    name, record = next(iter(agent.agents().items()))
    env: Any = make_env(*environment_of(record["key"]))
    policy: Any
    seen, policy = driver(record["key"], None, env, agent.weights(name))
    shape, actions = seen.observation_space.shape, int(env.action_space.n)
    about = {**agents.card("u-turn-3", "control"), "task": "highway", "cell": name, "time_observed": 0}
    about |= {"network": record["key"]["profile"]["network"], "observations": [*shape], "actions": actions}
    pretrained.save({"highway-50/control": (about, policy)}, home / "agents.npz")
    agent.weights(name).unlink()
    case = f"{home / 'cells' / name}:risky:{episodes(home / 'cells' / name)['scenario'][0]}"
    assert replay(Options(case, out=tmp_path / "film.gif", policy=True), make_env) == 0
    assert "the agent chose the stored actions" in capsys.readouterr().out


def by_backend(backend, *arguments):
    """Two simulators of different dynamics."""
    return (make_other_env if backend == "replica" else make_env)(backend, *arguments)


def test_a_further_test_is_replayed_on_its_own_simulator_and_in_its_own_traffic(tmp_path, capsys):
    tasks = tasks_of(
        tmp_path, tasks=("highway",), arms=("control", "dose25"), test_on=("replica",), episodes=6
    )
    chosen = [replace(task, make_env=by_backend) for task in tasks if task.cell.arm == "control"]
    compute(sorted(chosen, key=lambda task: task.cell.kind))
    away, doses = (
        next(task for task in chosen if task.cell.slug.endswith(end)) for end in ("-on-replica", "-doses")
    )
    for case in (away.name, f"{away.name}:risky:2", doses.name, f"{doses.name}:dose75:1"):
        path = tmp_path / "cells" / case
        assert replay(Options(str(path), out=tmp_path / "film.gif"), by_backend) == 0
        assert "reproduced" in capsys.readouterr().out
    assert changed_versions(parse_case(f"{tmp_path}/cells/{away.name}:risky:2").record) == []
    with pytest.raises(UserError, match="unknown traffic 'risky': known are dose25, dose50, dose75"):
        parse_case(f"{tmp_path / 'cells' / doses.name}:risky:1")
    with pytest.raises(UserError, match="a case is DIR/cells"):
        parse_case(f"{tmp_path / 'cells' / doses.name}:dose75")


def test_an_episode_that_comes_out_differently_is_told(cells, tmp_path, capsys):
    case, _ = first(cells, True)
    assert replay(Options(case, out=tmp_path / "a.gif"), make_other_env) == 1
    errors = capsys.readouterr().err
    assert "not reproduced" in errors and "instead of" in errors
    with pytest.raises(UserError, match="is not reproduced: "):
        replay(Options(case, avoid=True), make_other_env)


def test_versions_that_have_changed_are_told_of_the_learner_s_packages_too(cells):
    """Of what is not installed as well, which the stored actions need not have."""
    record = parse_case(f"{cells[0]}:risky:1").record
    assert record["versions"]["numba"] and changed_versions(record) == []
    changed = {**record, "versions": {**record["versions"], "numba": "0.1", "jaxlib": "0.2"}}
    told = [f"numba {version('numba')} (was 0.1)", "jaxlib not installed (was 0.2)"]
    assert changed_versions(changed) == told


def test_the_beginning_of_a_name_is_enough():
    names = [
        "sumo-u-turn-3-control-s0-aa",
        "sumo-u-turn-3-control-s1-bb",
        "sumo-u-turn-3-control-s1-on-replica-cc",
    ]
    assert find_cell("sumo-u-turn-3-control-s1", names) == "sumo-u-turn-3-control-s1-bb"
    for name in ("sumo-u-turn-3", "u-turn-3-control-s0"):
        with pytest.raises(UserError, match="did you mean"):
            find_cell(name, names)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("{cell}:regulr:0", {}, "did you mean 'regular'"),
        ("{cell}x", {}, "did you mean"),
        ("nowhere/cells/x", {}, "there is no cell"),
        ("{folder}", {}, "name one of its cells"),
        ("{cell}:risky:99", {}, "no 99"),
        ("{safe}", {}, "has no crash that could be avoided"),
        ("{safe}", {"sumo": True}, "--avoid writes a film of its own"),
        ("{safe}", {"horizon": 0}, "at least 1, not 0"),
        ("{safe}", {"policy": True}, "leave out --policy"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(cells, text, options, message, tmp_path):
    case = text.format(cell=cells[0], safe=first(cells, False)[0], folder=Path(cells[0]).parents[1])
    with pytest.raises(UserError, match=message) as error:
        replay(Options(case, out=tmp_path / "x.gif", avoid=text == "{safe}", **options), make_env)
    assert "\n" not in str(error.value)


def test_an_episode_replays_without_weights_and_weights_that_are_needed_are_told(cells, tmp_path):
    home = tmp_path / "results"
    shutil.copytree(cells[0].parents[1], home)
    store.Store(home).pack()
    shutil.rmtree(home / "weights")
    for cell in cells:  # from their actions
        assert replay(Options(f"{home}/cells/{cell.name}:risky:1"), make_env) == 0
        assert (home / f"{cell.name}-risky-1.gif").is_file()  # beside the results
    record = store.Store(home).record(cells[0].name)
    case = Case(store.Store(home), cells[0].name, record, {"traffic": "risky", "scenario": 0})
    with pytest.raises(UserError, match=r"weights of .* are not here: train it again"):
        play_again(case, make_env("sumo", "highway"))


def test_the_last_moment_to_avoid_a_crash_is_told_and_filmed(cells, tmp_path, capsys):
    """What the search finds is compared with all sequences in tests/experiments/study/test_avoid.py."""
    case, row = first(cells, True)
    film = tmp_path / "both.gif"
    assert replay(Options(case, out=film, avoid=True, horizon=3), make_env) == 0
    *searched, last, _ = capsys.readouterr().out.splitlines()[1:]
    moments = [float(line.split()[1]) for line in searched]
    assert moments == [row["length"] - back for back in range(1, len(moments) + 1)]
    assert ["not found" in line for line in searched] == [True] * (len(moments) - 1) + [False]
    left = row["crash_time"] - moments[-1]
    assert f"point of no return: {moments[-1]:g} s, {left:.1f} s before the contact" in last
    assert Image.open(film).size == (60, 2 * (20 + 22))  # one above the other, each with a title


def test_the_scenario_is_chosen_by_a_rule_that_is_said() -> None:
    columns = ("traffic", "scenario", "near_misses", "crashed")
    rows = [("regular", 0, 3, False), ("risky", 0, 0, False), ("risky", 1, 2, True), ("risky", 2, 1, False)]
    table = pd.DataFrame(rows, columns=columns)
    here = Path()
    assert watch.scenario_of(table, watch.Options(here)) == (2, watch.NEARLY)
    assert watch.scenario_of(table, watch.Options(here, crash=True)) == (1, watch.CRASHES)
    assert watch.scenario_of(table[:3], watch.Options(here))[0] == 0
    assert watch.scenario_of(table[2:3], watch.Options(here)) == (1, watch.CRASHES)
    assert watch.scenario_of(table, watch.Options(here, scenario=7)) == (7, "chosen by hand")
