"""Every command takes every task, one of a user's own as well: each at its smallest size, one after the other."""

import json
import pickle
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
from PIL import Image

from experiments import (
    attainable,
    doses,
    evaluate,
    rare,
    replay,
    report,
    sweep,
    takeover,
    train,
    validate,
    watch,
)
from experiments.backends import has
from experiments.study.design.levels import tasks_known
from experiments.study.design.presets import of_preset, tuned
from experiments.study.design.sheet import SHEETS, own_task, task_of
from experiments.study.results.store import Store
from experiments.support.arguments import parsed
from experiments.support.errors import UserError
from experiments.support.films import PANEL
from sumo_env.tasks import TASKS
from tests.processes import ended

OWN = "own-road"


MINE = """
from experiments.study.design.sheet import Sheet
from sumo_env.tasks.highway import Highway


class OwnRoad(Highway):
    name = "own-road"
    reference = None
    versions = ()
    levels = {"5": {"vehicles_count": 5, "duration": 4}, "8": {"vehicles_count": 8, "duration": 4}}
    sheet = Sheet(return_range=4.0, episode_length=4)
"""


@pytest.fixture
def own(tmp_path: Path) -> Iterator[str]:
    """A task in a file of a user's, on SUMO alone, as a command line names it."""
    file = tmp_path / "mine.py"
    file.write_text(MINE)
    yield f"{file}:OwnRoad"
    for known in (TASKS, SHEETS):
        known.pop(OWN, None)
    gym.registry.pop(f"sumo/{OWN}-v0", None)


@pytest.fixture
def small(here: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, and few episodes where no option says so."""
    monkeypatch.setattr("sumo_env.benchmark.QUICK", 2)
    monkeypatch.setattr(evaluate, "POLICIES", ("slower", "careful"))
    monkeypatch.setattr(rare, "BATCH", 4)
    monkeypatch.setattr(rare, "PILOT", 4)
    monkeypatch.setattr(doses, "DOSES", ("regular", "risky"))


def every_command(task: str, home: Path) -> None:
    trained = home / "trained"
    learners = partial(tuned, updates=20, warm_up=20)
    few: dict[str, Any] = {"tasks": (task,), "levels": (1,), "seeds": 1, "episodes": 1, "learners": learners}
    options = of_preset(train.Options, "smoke", **few, arms=("treatment",), out=trained)
    assert train.train(options, []) == 0
    [(name, record)] = Store(trained).agents().items()
    assert (record["key"]["arm"], record["key"]["profile"]["updates"]) == ("treatment", 20)
    assert min(Image.open(trained / f"{name}.png").size) > 200  # its learning curve
    tested = evaluate.Options(str(trained), quick=True, film=True, out=home / "card")
    assert evaluate.evaluate(tested, []) == 0
    drivers = json.loads((home / "card" / evaluate.CARD).read_text())["drivers"]
    assert {*drivers.values()} == {name}  # also at levels that it was not trained in
    assert watch.watch(watch.Options(trained, scenario=0)) == 0
    film: Any = Image.open(trained / f"{name.rpartition('-')[0]}-0.gif")
    width: Any = PANEL["screen_width"]
    assert film.size[0] > 2 * width and film.n_frames > 1  # at both risks
    with pytest.raises(UserError, match=re.escape(f"there are: {name}")):
        watch.watch(watch.Options(trained, agent="control"))
    assert replay.replay(replay.Options(f"{trained}/cells/{name}:risky:0", policy=True)) == 0
    curve = rare.Options(
        (str(trained),), task, rates="1", dose=1.0, episodes=4, plain=True, out=home / "curve"
    )
    assert rare.rare(curve, []) == 0
    two = takeover.Options(
        str(trained), "slower", task, traffics=("risky",), scenarios=1, others=(), out=home / "two"
    )
    assert takeover.takeover(two, []) == 0
    assert sweep.sweep(of_preset(sweep.Options, "smoke", **few, out=home / "sweep")) == 0
    assert report.write_report(home / "sweep").is_file()
    of_search = attainable.Options(tasks=(task,), levels=(1,), scenarios=2, width=2, out=home / "attainable")
    second: list[Callable[[], Any]] = [lambda: attainable.run(of_search, [])]
    if task == task_of(task):  # of a variant the traffic is its task's
        table = doses.doses(doses.Options(home / "doses", tasks=(task,), scenarios=1, workers=1))
        assert set(table["traffic"]) == {"regular", "risky"}
        few = {"tasks": (task,), "levels": (1,), "scenarios": 1}
        second.append(lambda: validate.validate(validate.Options(home / "one", quick=True, workers=1, **few)))
    for command in second:
        if has("replica", task_of(task)):
            command()
        else:
            with pytest.raises(UserError, match=f"the backend replica has no task {task}"):
                command()


def test_every_command_takes_a_task_of_one_s_own(
    own: str, small: None, words_alone: None, tmp_path: Path
) -> None:
    """In a report without figures, which are in the long lane."""
    [task] = parsed(doses.Options, ["--out", "x", "--task", own], "").tasks
    assert parsed(rare.Options, ["idle", "--tasks", own], "").task is task == OWN
    every_command(task, tmp_path)


def test_a_process_that_is_sent_the_name_of_a_task_of_one_s_own_has_it(own: str, tmp_path: Path) -> None:
    name = pickle.dumps(own_task(own))
    script = (
        f"import pickle; from sumo_env.tasks import TASKS; print(TASKS[pickle.loads({name!r})].levels.keys())"
    )
    assert "['5', '8']" in ended("-c", script).stdout
    (tmp_path / "mine.py").write_text(MINE + "\n")
    assert "has changed since this command began" in ended("-c", script).stderr


def test_a_file_without_a_task_and_its_sheet_says_what_is_missing(own: str, tmp_path: Path) -> None:
    for name, words in (("Highway", "attribute sheet"), ("Other", "defines no Other")):
        with pytest.raises(UserError, match=words):
            own_task(own.replace("OwnRoad", name))
    (tmp_path / "mine.py").write_text(MINE.replace(OWN, "highway"))
    with pytest.raises(UserError, match="there is a task 'highway' already"):
        own_task(own)


@pytest.mark.long
@pytest.mark.parametrize("task", tasks_known())
def test_every_command_takes_the_task(task: str, small: None, tmp_path: Path) -> None:
    every_command(task, tmp_path)
