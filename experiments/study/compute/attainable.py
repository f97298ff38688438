"""What can be had in a setting: episodes of drivers without foresight, and the best sequences of actions."""

from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, fields
from functools import cached_property, partial
from math import nan
from typing import Any

from agents.rules.constant import Constant
from experiments.backends import make_env
from experiments.study.compute import batches
from experiments.study.compute.entrants import Entrant, Env, Made
from experiments.study.compute.evaluate import Drive, play
from experiments.study.compute.foresight import Driven, batch_of_one, search
from experiments.study.compute.progress import step_cost
from experiments.study.design.attainable import SEARCH
from experiments.study.design.levels import level_names
from experiments.study.design.sheet import task_of
from experiments.study.design.traffic import traffic_named

PURPOSE = "attainable"  # of the scenarios, which no test and no training meets
COLUMNS = {  # of an episode, or of the sequences of actions with the best returns in one
    "scenario": "int64",
    "return": "float64",
    "crashed": "bool",
    "actions": "str",
    "safe_return": "float64",  # of the best one without a crash; missing where none was found
    "safe_actions": "str",
}


@dataclass(frozen=True)
class Batch(batches.Batch):
    """Some scenarios of a setting in a traffic.

    task: may be a variant. config: of the environment. dynamics: what the simulator does, see `fingerprint.dynamics`.
    driver: is resolved, and drives on SUMO; None for the search on the replica, of this width. first, count: of the
    scenarios.
    """

    task: str
    level: int
    traffic: str
    config: Mapping[str, Any]
    dynamics: str
    driver: Entrant | None
    width: int
    first: int
    count: int
    columns = COLUMNS

    @property
    def who(self) -> str:
        """Name of the driver."""
        return self.driver.name if self.driver else SEARCH

    @cached_property
    def name(self) -> str:
        """By setting, traffic, driver and first scenario."""
        who = "".join(letter if letter.isalnum() or letter in ".-" else "_" for letter in self.who)
        where = f"{self.task}-{level_names(self.task)[self.level - 1]}-{self.traffic}"
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "directory"}
        digest = self.driver.digest if self.driver else ""
        return batches.named(f"{where}-{who}-{self.first:04d}", {**own, "driver": self.who, "digest": digest})

    @property
    def episodes(self) -> dict[str, range]:
        """Numbers of the scenarios."""
        return {"scenario": range(self.first, self.first + self.count)}

    @property
    def size(self) -> float:
        """A planner's episodes take long."""
        return self.count * step_cost(self.who, "sumo")

    def drive(self) -> Iterator[dict[str, Any]]:
        """Drive or search them."""
        drives = [Drive(self.task, self.level, self.traffic, k, PURPOSE) for k in self.episodes["scenario"]]
        return self._driven(drives) if self.driver else self._searched(drives)

    def _driven(self, drives: list[Drive]) -> Iterator[dict[str, Any]]:
        assert self.driver
        with closing(make_env("sumo", task_of(self.task), self.config)) as env:
            seen, policy = self.driver.make(env)
            for drive in drives:
                row = play(seen, policy, drive)
                safe = Driven(nan, "") if row["crashed"] else Driven(row["return"], row["actions"])
                yield {**row, "safe_return": safe.value, "safe_actions": safe.actions}

    def _searched(self, drives: list[Drive]) -> Iterator[dict[str, Any]]:
        envs, risk = batch_of_one(task_of(self.task), self.config), traffic_named(self.traffic).dose
        for drive in drives:
            found = search(envs, drive.seed, risk, self.width)
            best, safe = found.best, found.safe or Driven(nan, "")
            yield {
                "scenario": drive.scenario,
                "return": best.value,
                "crashed": best is found.crashing,
                "actions": best.actions,
                "safe_return": safe.value,
                "safe_actions": safe.actions,
            }


def always(action: str) -> Entrant:
    """The driver that takes one action at every step."""
    return Entrant(action, None, partial(_always, action))


def _always(action: str, env: Env) -> Made:
    numbers: dict[int, str] = env.unwrapped.actions  # type: ignore[attr-defined]
    [number] = [number for number, name in numbers.items() if name == action]
    return env, Constant(number), ""
