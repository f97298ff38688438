"""Every command takes every task, one of a user's own as well: each at its smallest size, one after the other."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import pytest
from PIL import Image

import sumo_env
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
from experiments.analysis.scores import TASK_ORDER
from experiments.backends import has
from experiments.study.design.levels import tasks_known
from experiments.study.design.presets import of_preset, tuned
from experiments.study.design.sheet import SHEETS, task_of
from experiments.study.results.store import Store
from experiments.support.errors import UserError
from experiments.support.films import PANEL
from sumo_env.tasks import TASKS
from sumo_env.tasks.highway import Highway

OWN = "own-road"


class OwnRoad(Highway):
    """On SUMO alone."""

    name = OWN
    reference = None
    versions: ClassVar[Any] = ()
    levels: ClassVar[Any] = {
        "5": {"vehicles_count": 5, "duration": 4},
        "8": {"vehicles_count": 8, "duration": 4},
    }


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A task that a user has added, with its sheet and its id."""
    monkeypatch.setitem(TASKS, OWN, OwnRoad())
    monkeypatch.setitem(SHEETS, OWN, SHEETS["highway"])
    monkeypatch.setitem(TASK_ORDER, OWN, len(TASK_ORDER))  # which is made of TASKS at the import
    sumo_env.register(f"sumo/{OWN}-v0", OwnRoad())
    yield
    del gym.registry[f"sumo/{OWN}-v0"]


@pytest.fixture
def small(here: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, and few episodes where no option says so."""
    monkeypatch.setattr("sumo_env.benchmark.QUICK", 2)
    monkeypatch.setattr(evaluate, "POLICIES", ("slower", "careful"))
    monkeypatch.setattr(rare, "BATCH", 4)
    monkeypatch.setattr(rare, "PILOT", 4)
    monkeypatch.setattr(doses, "DOSES", ("regular", "risky"))
    for command in (attainable, doses, evaluate, rare, takeover, train, validate):
        monkeypatch.setattr(command, "check_dynamics", lambda _: None)


def every_command(task: str, home: Path) -> None:
    trained = home / "trained"
    learners = tuned({task: 20, task_of(task): 20}, warm_up=20)
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
    with pytest.raises(UserError, match=f"there are: {name}"):
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
    own: None, small: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a report without figures, which are in the long lane."""
    monkeypatch.setattr("experiments.reporting.page.drawn", lambda *_: defaultdict(lambda: None))
    every_command(OWN, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("task", tasks_known())
def test_every_command_takes_the_task(task: str, small: None, tmp_path: Path) -> None:
    every_command(task, tmp_path)
