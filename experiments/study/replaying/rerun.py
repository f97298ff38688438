"""A stored test episode again: the same policy on the same scenario, and whether the same numbers come out."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import pandas as pd

from agents import pretrained
from agents.policies import Policy
from agents.rules.constant import Constant
from experiments.study.compute.evaluate import Drive, play
from experiments.study.compute.policies import driver
from experiments.study.design.cell import RESULT_SCHEMA, installed, test_of, tested_on
from experiments.study.design.fingerprint import dynamics
from experiments.study.results.store import Store
from experiments.support.errors import UserError


@dataclass(frozen=True)
class Case:
    """A test episode of a stored cell.

    cell: name of the cell. record: its cell.json. row: the episode in its table, or its `traffic` and `scenario` alone;
        where it has `actions`, neither weights nor code are needed to play it again. code: FILE:NAME or a zip file of
        the cell's own policy, network or learner, as the user has named it.
    """

    store: Store
    cell: str
    record: Mapping[str, Any]
    row: Mapping[str, Any]
    code: str | None = None

    @property
    def name(self) -> str:
        """What its files are called."""
        return f"{self.cell}-{self.row['traffic']}-{self.row['scenario']}"


def play_again(
    case: Case, env: gym.Env[Any, Any], on_step: Callable[[], None] | None = None, closed_loop: bool = False
) -> dict[str, Any]:
    """Play a test episode again and return its row of `schema.COLUMNS`.

    env: of its test, see `cell.tested_on`. closed_loop: drive the policy itself also where the actions are stored.

    Raises:
        UserError: the weights are not here, code is needed that is not named, or one of them does not fit.
    """
    key, actions = case.record["key"], case.row.get("actions")
    weights = None
    drive = Drive(key["task"], key["level"], str(case.row["traffic"]), int(case.row["scenario"]))
    # SUMO's own driver does not act by the actions that are stored.
    if actions is not None and not closed_loop and key["policy"] != "sumo":
        return play(env, Constant(*map(int, actions)), drive, on_step)
    if key["kind"] == "test":
        raise UserError(
            f"{case.cell} is a further test of an agent, whose stored actions alone can be played: replay the agent's "
            "own cell"
        )
    if key["kind"] == "agent":
        weights = case.store.weights(case.cell)
        if weights is None and (policy := published(case)) is not None:
            return play(env, policy, drive, on_step)
        if weights is None:
            raise UserError(
                f"the weights of {case.cell} are not here: train it again with the command in sweep.json, "
                f"--cell {case.cell} and another --out"
            )
    return play(*driver(key, case.code, env, weights), drive, on_step)


def published(case: Case) -> Policy | None:
    """The agent of a cell from the folder's own file of agents, or that of the repository; None if it is in neither."""
    for file in (case.store.directory / pretrained.FILE.name, pretrained.FILE):
        if file.exists():
            for label, about in pretrained.cards(file).items():
                if about["cell"] == case.cell:
                    setting, arm = label.split("/")
                    return pretrained.load(setting, arm, file)
    return None


def ending(row: Mapping[str, Any]) -> str:
    """How an episode ended, in words."""
    if row["crashed"]:
        speed = row["crash_closing_speed"]
        return f"{row['crash_type']} crash after {row['crash_time']:.1f} s, closing at {speed:.0f} m/s"
    return "reaches its goal" if row["arrived"] else "no crash until the time is up"


def differences(stored: Mapping[str, Any], row: Mapping[str, Any]) -> list[str]:
    """Columns in which a replayed episode is not the stored one, in words; empty if it is reproduced."""
    return [
        f"{name} {row[name]} instead of {old}"
        for name, old in stored.items()
        if old != row[name] and not (pd.isna(old) and pd.isna(row[name]))
    ]


def changed_versions(record: Mapping[str, Any]) -> list[str]:
    """Versions that differ from those of a stored cell, in words; its learner's packages are among them."""
    key = record["key"]
    backend, task, _ = tested_on(key)
    now: dict[str, Any] = {"schema": RESULT_SCHEMA, "dynamics": dynamics(backend, task)}
    for package in record["versions"].keys() - now.keys():
        with suppress(UserError):  # the stored actions may need none of it
            now[package] = installed(package)
    return [
        f"{name} {now.get(name, 'not installed')} (was {old})"
        for name, old in {**record["versions"], "dynamics": test_of(key)["dynamics"]}.items()
        if now.get(name) != old
    ]
