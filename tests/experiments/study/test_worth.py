"""Whether an agent's values come true: against sums by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.study.compute.evaluate import drives, evaluate
from experiments.study.compute.worth import Worth
from experiments.study.design.rules import TrainingRules
from tests.experiments.fake_env import FakeEnv

GAMMA = 0.9


class Kept(FakeEnv):
    """Keeps the rewards and the ends of its episodes."""

    def reset(self, **options):
        self.kept = [*getattr(self, "kept", []), ([], [])]
        return super().reset(**options)

    def step(self, action):
        result = super().step(action)
        rewards, crashed = self.kept[-1]
        rewards.append(float(result[1]))
        crashed.append(bool(result[2]))
        return result


def driven(rules: TrainingRules) -> tuple[Worth, Kept]:
    """Some risky episodes of an agent whose values are 7 in the beginning and then 3."""
    env = Kept("u-turn", {"duration": 10})
    agent = SimpleNamespace(
        act=lambda _: 1, reset=lambda _: None, q=lambda _: np.array([0.0, 3.0 if env.time else 7.0])
    )
    worth = Worth(env, agent, GAMMA, rules)
    evaluate(worth, agent, drives("u-turn", 1, range(12), ["risky"]))
    return worth, env


@pytest.mark.parametrize("rules", [TrainingRules(), TrainingRules(finite_horizon=True)])
def test_what_an_agent_gets_is_the_discounted_sum_and_what_it_still_expects_at_the_limit(rules) -> None:
    worth, env = driven(rules)
    ends = [crashed[-1] for _, crashed in env.kept]
    assert any(ends) and not all(ends)
    got = [
        sum(GAMMA**k * r for k, r in enumerate(rewards))
        + (0.0 if end or rules.finite_horizon else GAMMA ** len(rewards) * 3.0)
        for (rewards, _), end in zip(env.kept, ends, strict=True)
    ]
    record = worth.record()
    assert (record["episodes"], record["expected"]) == (12, 7.0)
    assert record["got"] == pytest.approx(np.mean(got))
    assert record["size"] == pytest.approx(np.sqrt(np.mean(np.square(got))))


def test_the_price_of_a_crash_in_training_is_in_it() -> None:
    free, priced = (driven(TrainingRules(crash_reward=x))[0].record()["got"] for x in (0.0, -2.0))
    assert priced < free
