"""Drivers from equal critical moments: every row of the record is recomputed without copies, by driving again."""

import math
from collections.abc import Callable
from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest

from agents.rules import make_policy
from experiments.backends import make_env
from experiments.study.compute.entrants import Entrant
from experiments.study.compute.takeover import PAIR, Driver, compared
from experiments.study.compute.wrappers import TimeObserved
from tests.experiments.fake_env import FakeEnv

BOUNDS = (3.0, 2.0, 4.0)
U_TURN = {"vehicles_count": 3, "risk": 1.0}


class Remembers:
    """Acts by all that it has seen since the reset, by its clock, and by draws of its own; at first it speeds up."""

    def __init__(self, factor: float) -> None:
        self._factor = factor

    def reset(self, seed: int | None = None) -> None:
        self.seen: list[np.ndarray] = []
        self._draws = np.random.default_rng(seed)

    def act(self, observation: np.ndarray) -> int:
        self.seen.append(observation)
        whole = sum(float(one.sum()) / (k + 1) for k, one in enumerate(self.seen))
        chance = (self._factor * whole + 0.37 * len(self.seen) + self._draws.random()) % 1.0
        return 3 if len(self.seen) < 3 else (4, 4, 3, 1)[int(4 * chance)]


def remembers(name: str, factor: float) -> Entrant:
    """It observes the time by a wrapper of its own."""
    return Entrant(name, None, lambda env: (TimeObserved(env, 10), Remembers(factor), ""))


def rule(name: str) -> Entrant:
    return Entrant(name, None, lambda env: (env, make_policy(name, env), ""))


def by_hand(open_env: Callable[[], gym.Env], who: dict[str, Entrant], leader: str, seed: int, bound: float):
    """A row of the record, with a new environment for whatever goes on from a step."""

    def again(actions: list[int]) -> tuple[gym.Env, list[Any]]:
        env = open_env()
        return env, [env.reset(seed=seed), *(env.step(action) for action in actions)]

    def driven(name: str, past: list[int], most: int) -> tuple[list[int], int | None]:
        """The actions of a driver that takes over after `past`, and the step in which it crashes."""
        env, results = again(past)
        with closing(env):
            given = iter(results)
            shown = type(
                "Shown",
                (gym.Wrapper,),
                {"reset": lambda *_, **__: next(given), "step": lambda *_: next(given)},
            )
            seen, policy = who[name].make(shown(env))
            policy.reset(99)
            observation, _ = seen.reset()
            for action in past if name not in ("sumo", "planner") else ():
                policy.act(observation)
                observation = seen.step(action)[0]
            actions: list[int] = []
            while len(actions) < most:
                actions.append(int(policy.act(observation)))
                result = env.step(actions[-1])
                if result[2] or result[3]:
                    return actions, len(actions) if result[4]["crashed"] else None
                given = iter([result])
                observation = seen.step(actions[-1])[0]
        return actions, None

    actions, crash = driven(leader, [], 1000)
    for step in range(1, len(actions)):
        env, results = again(actions[:step])
        info = results[-1][-1]
        with closing(env):
            for _ in range(int(bound)):
                result = env.step(1)
                if result[2] or result[3]:
                    break
        if result[4]["crashed"]:
            times = {name: driven(name, actions[:step], 1000 if name in PAIR else 5)[1] for name in who}
            return (
                step,
                info["speed"],
                False,
                {name: math.inf if at is None else at for name, at in times.items()},
            )
    return None, None, crash is not None, {}


def check(open_env: Callable[[], gym.Env], who: dict[str, Entrant], seeds: range) -> pd.DataFrame:
    """All rows are those by hand; returns them."""
    rows = []
    with closing(open_env()) as env:
        drivers = {name: Driver(entrant, env) for name, entrant in who.items()}
        for seed in seeds:
            for leader in (name for name in PAIR if drivers[name].leads):
                for row in compared(env, drivers, leader, {"seed": seed}, 99, BOUNDS):
                    moment, speed, sudden, times = by_hand(open_env, who, leader, seed, row["within"])
                    assert (row.get("moment"), row.get("speed"), row["sudden"]) == (moment, speed, sudden)
                    assert {name: row.get(f"crash_{name}") for name in times} == times
                    rows.append({"seed": seed, **row})
    return pd.DataFrame(rows)


def fake() -> gym.Env:
    return FakeEnv("fake", {"risk": 0.7})


def test_memory_clock_and_draws_of_all_drivers_go_on() -> None:
    who = {
        "a": remembers("one", 10.0),
        "b": remembers("other", 17.0),
        "slower": rule("slower"),
        "random": rule("random"),
    }
    rows = check(fake, who, range(40))
    assert rows["moment"].notna().sum() > 60 and rows["sudden"].any() and rows["moment"].isna().any()
    assert (rows["crash_a"] != rows["crash_b"])[rows["moment"].notna()].any()
    first = rows.pivot(index=["seed", "leader"], columns="within", values="moment").fillna(np.inf)
    assert (first[4.0] <= first[3.0]).all() and (first[3.0] <= first[2.0]).all()


def test_a_driver_against_itself_differs_in_nothing() -> None:
    one = remembers("one", 10.0)
    rows = check(fake, {"a": one, "b": one}, range(20))
    both = [rows[rows["leader"] == leader].drop(columns="leader").reset_index(drop=True) for leader in PAIR]
    pd.testing.assert_frame_equal(*both)
    met = rows[rows["moment"].notna()]
    assert len(met) > 20 and (met["crash_a"] == met["crash_b"]).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "who", [("faster", "careful", "slower"), ("faster", "sumo", "planner")], ids="-".join
)
def test_copies_on_sumo_are_what_driving_again_gives(who: tuple[str, str, str]) -> None:
    """Those that go on with IDLE disturb nothing; SUMO's own driver and the planner take over without having led."""
    entrants = dict(zip((*PAIR, who[2]), map(rule, who), strict=True))
    rows = check(lambda: make_env("sumo", "u-turn", U_TURN), entrants, range(1 if "planner" in who else 2))
    assert rows["moment"].notna().sum() >= 3
    assert set(rows["leader"]) == ({"a"} if "sumo" in who else {"a", "b"})
