"""One stored episode again: the same numbers, as a picture, an animation or a scenario for SUMO."""

from __future__ import annotations

import shutil

import pytest
from PIL import Image

from experiments.replay import Options, find_cell, parse_case, replay
from experiments.study import store
from experiments.study.attempt import Ended, attempt
from experiments.study.cell import CellTask
from experiments.study.rerun import stored_policy
from experiments.support.errors import UserError
from experiments.sweep import Options as SweepOptions
from experiments.sweep import cells_of
from tests.experiments.fake_env import make_env


@pytest.fixture(scope="module")
def cells(tmp_path_factory):
    """Directories of a stored agent and of a stored baseline."""
    home = tmp_path_factory.mktemp("results")
    wanted = cells_of(SweepOptions(preset="smoke", tasks=("highway",), updates=100, episodes=3))
    chosen = [cell for cell in wanted if cell.arm == "control" or cell.policy == "random"]
    for cell in chosen:
        assert attempt(CellTask(cell, home, make_env)) == Ended("done")
    return [home / "cells" / cell.name for cell in chosen]


def episodes(cell):
    return store.tables_of(cell.parents[1], cell.name)[store.EPISODES]


@pytest.mark.parametrize("case", ["", ":regular:2", ":risky:1"])
def test_an_episode_is_reproduced(cells, case, tmp_path, capsys):
    for number, cell in enumerate(cells):
        picture = tmp_path / f"{number}.png"
        assert replay(Options(f"{cell}{case}", out=picture), make_env) == 0
        assert "reproduced" in capsys.readouterr().out
        width, height = Image.open(picture).size
        assert width % 64 == 60  # whole pictures of 60 x 20 with gaps of 4
        assert height % 24 == 20


def test_an_episode_that_comes_out_differently_is_told(cells, tmp_path, capsys):
    def other_env(*arguments):
        env = make_env(*arguments)
        env.target_speeds = (10.0, 19.0, 29.0)
        return env

    assert replay(Options(f"{cells[1]}:regular:0", out=tmp_path / "a.png"), other_env) == 1
    errors = capsys.readouterr().err
    assert "not reproduced" in errors
    assert "instead of" in errors


def test_a_film_has_the_frames_of_the_episode(cells, tmp_path):
    path = tmp_path / "episode.gif"
    replay(Options(f"{cells[0]}:risky:0", out=path, gif=True), make_env)
    length = episodes(cells[0]).query("traffic == 'risky' and scenario == 0")["length"].item()
    assert Image.open(path).n_frames in (length, length + 1)  # equal neighbours are merged


def test_by_default_the_first_crash_is_shown(cells):
    for cell in cells:
        table = episodes(cell)
        crashes = table[table["crashed"]][["traffic", "scenario"]].to_numpy().tolist()
        case = parse_case(str(cell))
        assert [case.traffic, case.scenario] == (crashes[0] if crashes else ["regular", 0])
    assert any(episodes(cell)["crashed"].any() for cell in cells)


def test_the_beginning_of_a_name_is_enough():
    names = [
        "sumo-u-turn-3-control-s0-aa",
        "sumo-u-turn-3-control-s1-bb",
        *(f"sumo-highway-{k}-x" for k in range(9)),
    ]
    assert find_cell("sumo-u-turn-3-control-s1", names) == "sumo-u-turn-3-control-s1-bb"
    with pytest.raises(
        UserError, match="2 cells begin with 'sumo-u-turn'; did you mean sumo-u-turn-3-control-s0-aa"
    ):
        find_cell("sumo-u-turn", names)
    with pytest.raises(UserError) as error:
        find_cell("highway", names)
    assert str(error.value).count("sumo-") <= 5


def test_an_episode_is_exported_for_sumo(cells, tmp_path, capsys):
    """By the environment (tests/sumo_env/test_export.py), once the episode is over."""
    steps = []

    def exporting(*arguments):
        env = make_env(*arguments)
        env.export = lambda folder: steps.append((folder, env.time))
        return env

    assert replay(Options(f"{cells[1]}:regular:1", out=tmp_path / "episode", sumo=True), exporting) == 0
    row = episodes(cells[1]).query("traffic == 'regular' and scenario == 1").iloc[0]
    assert steps == [(tmp_path / "episode", row["length"])]
    assert "episode.sumocfg" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{cell}:regulr:0", "did you mean 'regular'"),
        ("{cell}x", "did you mean"),
        ("nowhere/cells/x", "there is no cell"),
        ("{cell}:risky:99", "no 99"),
    ],
)
def test_a_case_that_does_not_exist_is_named(cells, text, message, tmp_path):
    with pytest.raises(UserError) as error:
        replay(Options(text.format(cell=cells[0]), out=tmp_path / "x.png"), make_env)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_an_episode_replays_without_weights_and_weights_that_are_needed_are_told(cells, tmp_path):
    home = tmp_path / "results"
    shutil.copytree(cells[0].parents[1], home)
    (home / store.PUBLISHED).write_text("left out on purpose")
    (home / "cells" / cells[0].name / store.WEIGHTS).unlink()
    case = home / "cells" / cells[0].name
    assert replay(Options(str(case), out=tmp_path / "x.png"), make_env) == 0  # from its actions
    record = store.read_cell(case)
    with pytest.raises(UserError, match=r"weights of .* are not here: train it again"):
        stored_policy(case, record, make_env("sumo", "highway"))


def test_a_case_is_split_from_the_right(cells):
    case = parse_case(f"{cells[0]}:risky:1")
    assert (case.path, case.traffic, case.scenario) == (cells[0], "risky", 1)
