"""The search for the best sequences of actions of an episode of the replica."""

from contextlib import closing
from itertools import product
from typing import Any

import pytest

from agents.policies import Policy
from agents.rules import make_policy
from agents.rules.constant import Constant
from experiments.backends import make_env
from experiments.study.compute.evaluate import play_from
from experiments.study.compute.foresight import Found, batch_of_one, search
from experiments.study.design.arms import scenario_seed
from experiments.study.design.levels import env_config, level_names
from experiments.study.design.sheet import task_of

SETTINGS = [("highway", 1), ("two-way", 1), ("two-way-brakes", -1)]
SETTINGS += [("roundabout", 1), ("intersection", -1), ("u-turn", -1)]


class Setting:
    """A setting on the replica, driven alone and searched."""

    def __init__(self, task: str, level: int, **changes: Any) -> None:
        self.task, level = task_of(task), level if level > 0 else len(level_names(task))
        self.level, self.config = level, env_config("replica", task, level, changes)
        self.envs = batch_of_one(self.task, self.config)

    def seed(self, number: int) -> int:
        return scenario_seed(self.task, self.level, number, "attainable")

    def search(self, number: int, risk: float, width: int = 256) -> Found:
        return search(self.envs, self.seed(number), risk, width)

    def play(self, env: Any, policy: Policy, number: int, risk: float) -> dict[str, Any]:
        policy.reset(number)
        return play_from(env, policy, self.seed(number), {"config": {"risk": risk}})


@pytest.mark.parametrize(("task", "level"), SETTINGS)
@pytest.mark.slow
def test_what_is_found_can_be_driven_and_a_safe_episode_is_never_called_impossible(
    task: str, level: int
) -> None:
    """At the standard width, whoever drives: the return is at least theirs."""
    setting, safe = Setting(task, level, **({"duration": 10} if task == "highway" else {})), 0
    with closing(make_env("replica", setting.task, setting.config)) as env:
        policies = [make_policy(name, env) for name in ("random", "slower", "careful", "idm")]
        for number, risk in product(range(1 if task == "highway" else 2), (0.0, 1.0)):
            found = setting.search(number, risk)
            for one in filter(None, found):
                again = setting.play(env, Constant(*map(int, one.actions)), number, risk)
                assert again["return"] == pytest.approx(one.value, abs=1e-9)
                assert again["crashed"] == (one is found.crashing) and again["length"] == len(one.actions)
            for policy in policies:
                driven = setting.play(env, policy, number, risk)
                assert found.best.value > driven["return"] - 1e-9
                if not driven["crashed"]:
                    safe += 1
                    assert found.safe is not None and found.safe.value > driven["return"] - 1e-9
    assert safe >= 2 or task == "two-way"


@pytest.mark.parametrize("task", ["intersection", "u-turn"])
def test_of_a_short_episode_the_best_sequence_is_found(task: str) -> None:
    """All sequences are driven."""
    setting = Setting(task, -1, duration=3)
    actions = range(int(setting.envs.single_action_space.n))  # type: ignore[attr-defined]
    with closing(make_env("replica", setting.task, setting.config)) as env:
        for number in range(3):
            found = setting.search(number, 1.0)
            rows = [setting.play(env, Constant(*one), number, 1.0) for one in product(actions, repeat=3)]
            for driven, crashed in ((found.safe, False), (found.crashing, True)):
                values = [row["return"] for row in rows if row["crashed"] == crashed]
                assert (driven is None) == (not values)
                assert driven is None or driven.value == pytest.approx(max(values), abs=1e-9)


def test_with_a_narrow_beam_the_search_finds_less_and_the_same_again() -> None:
    setting = Setting("two-way", 1)
    narrow, again, wide = (setting.search(3, 1.0, width) for width in (2, 2, 256))
    assert narrow == again and narrow.best.value < wide.best.value
