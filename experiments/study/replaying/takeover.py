"""The film of one critical moment: what led there, and how each of two drivers goes on."""

import math
from collections.abc import Mapping
from contextlib import closing
from typing import Any

import pandas as pd

from experiments.study.compute.takeover import PAIR, WINDOW, Driver, Moment, Question
from experiments.study.design.sheet import task_of
from experiments.support.films import Film, Pictures, panel


def most_telling(rows: pd.DataFrame) -> Mapping[str, Any] | None:
    """The first row of the record from whose moment one of the two crashes, or with a moment; None without one."""
    moments = rows[rows["moment"].notna()]
    crashed = [moments[f"crash_{name}"] <= WINDOW for name in PAIR]
    for chosen in (moments[crashed[0] != crashed[1]], moments):
        if len(chosen):
            return dict(chosen.iloc[0])
    return None


def films(asked: Question, row: Mapping[str, Any], names: Mapping[str, str]) -> list[tuple[str, Pictures]]:
    """Both endings of a row of the record, driven again from the reset, each under what comes of it."""
    found = []
    for name in PAIR:
        with closing(asked.open("rgb_array", **panel(task_of(asked.task), asked.config))) as env:
            driver, film = Driver(asked.drivers[name], env), Film(env)
            past: list[Any] = [env.reset(**asked.reset(row["scenario"]))]
            film.frame()
            actions = [int(digit) for digit in row["actions"]]
            for action in actions:
                past.append(env.step(action))
                film.frame()
            moment = Moment(env.unwrapped, past, actions, row["km"])
            time = driver.go_on(moment, asked.seed(row["scenario"]), WINDOW, film.frame)
        ending = "no crash" if time == math.inf else f"crash after {time:g} s"
        found.append((f"{names[name]} goes on: {ending}", film.pictures))
    return found
