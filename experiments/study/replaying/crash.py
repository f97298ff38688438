"""The worst crash of a driver in each task of the frozen test, filmed beside another driver in the same scenario."""

from collections.abc import Mapping
from contextlib import closing, suppress
from typing import Any, NamedTuple

import pandas as pd

from experiments.study.compute.entrants import Entrant, Place, entrant_of
from experiments.study.compute.frozen_test import episode, opened
from experiments.study.design.sheet import task_of
from experiments.study.replaying.rerun import ending
from experiments.support.errors import UserError
from experiments.support.films import Film, Pictures, panel, side_by_side
from sumo_env.benchmark import BenchmarkScenario

OTHERS = ("careful", "sumo", "slower")  # who may drive beside it, the first choice first


class Crash(NamedTuple):
    """A driver's crash in a scenario. speed: at which the vehicles closed [m/s]."""

    driver: Entrant
    scenario: BenchmarkScenario
    speed: float


def worst_crashes(
    who: Mapping[Place, Entrant],
    groups: Mapping[str, list[BenchmarkScenario]],
    driven: Mapping[str, tuple[pd.DataFrame, str]],
) -> list[Crash]:
    """The crash of each task at the highest closing speed; none of a task without crashes.

    who, groups: as `frozen_test.take` takes them; driven: what it returns.
    """
    rows = pd.concat(frame.assign(group=group) for group, (frame, _) in driven.items())
    rows = rows[rows["crashed"]].sort_values("crash_closing_speed", ascending=False, kind="stable")
    found = []
    for row in rows.drop_duplicates("task").to_dict("records"):
        scenario = groups[row["group"]][row["scenario"]]
        found.append(Crash(who[scenario.task, scenario.level], scenario, float(row["crash_closing_speed"])))
    return found


def beside_another(crash: Crash, name: str) -> Pictures:
    """The film of a crash, beside the first of OTHERS that has none there.

    name: of the crash's driver in the film.

    Raises:
        UserError: the driver fails, or has changed.
    """
    of, films = crash.scenario, [_film(name, crash.driver, crash.scenario)]
    words = f"Nobody of {', '.join(OTHERS)} drives there without a crash."
    for rule in (rule for rule in OTHERS if rule != name):
        with suppress(UserError):  # it does not fit the task
            title, pictures, crashes = _film(rule, entrant_of(rule, of.task, of.level), of)
            if not crashes:
                films.append((title, pictures, crashes))
                words = f"Beside it drives the first of {', '.join(OTHERS)} that has no crash there."
                break
    where = f"{of.task} {of.level}, {of.traffic}, scenario {of.number}"
    caption = [f"{where}: the crash at the highest closing speed, {crash.speed:.0f} m/s.", words]
    return side_by_side([(title, pictures) for title, pictures, _ in films], caption=caption)


def _film(name: str, driver: Entrant, scenario: BenchmarkScenario) -> tuple[str, Pictures, bool]:
    """A title, the pictures, and whether the driver crashes."""
    with closing(
        opened(scenario, driver, "rgb_array", **panel(task_of(scenario.task), scenario.config))
    ) as env:
        film = Film(env)
        row: dict[str, Any] = episode(driver, *driver.make(env), scenario, film.frame)
    return f"{name}: {ending(row)}", film.pictures, row["crashed"]
