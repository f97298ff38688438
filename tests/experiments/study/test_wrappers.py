"""What training changes about an environment: the end of its episodes, the time in view, the dose of risk."""

from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from agents.streams import episode_seed
from experiments.backends import make_env as make_sumo
from experiments.study.compute.cells import Worth
from experiments.study.compute.evaluate import evaluate
from experiments.study.compute.wrappers import TimeObserved, TrainingEnv, observed
from experiments.study.design.arms import EVERY_ARM
from experiments.study.design.levels import env_config
from experiments.study.design.traffic import ALL
from experiments.study.design.training_rules import TrainingRules
from sumo_env.env import DrivingEnv
from tests.experiments.fake_env import FakeEnv, make_env

PLAIN = TrainingRules()
SLOWER = 4


def test_the_time_is_a_column_of_the_ego() -> None:
    env = observed(make_env("sumo", "u-turn", {"policy_frequency": 2}), TrainingRules(time_observed=5))
    plain = make_env("sumo", "u-turn")
    assert env.observation_space.shape == (2, 6)
    for episode in range(2):  # which begins at 0 again
        seen, raw = env.reset(seed=episode)[0], plain.reset(seed=episode)[0]
        for step in range(11):
            assert env.observation_space.contains(seen)
            np.testing.assert_array_equal(seen[:, :-1], raw)
            assert seen[0, -1] == pytest.approx(step / 10)
            assert (seen[1:, -1] == 0).all()
            if step < 10:
                seen, *_, truncated, _ = env.step(SLOWER)
                raw = plain.step(SLOWER)[0]
    assert truncated


def test_the_limit_is_terminal_in_training_and_truncates_in_the_test() -> None:
    rules = TrainingRules(training_clock=[10, 10])
    test = observed(make_env("sumo", "u-turn"), rules)
    ends = []
    for env in (TrainingEnv(test, rules, ALL["regular"], 0), test):
        env.reset(seed=0)
        for _ in range(10):
            _, _, terminated, truncated, _ = env.step(SLOWER)
        ends.append((terminated, truncated))
    assert ends == [(True, False), (False, True)]


def test_gymnasium_accepts_the_environment() -> None:
    check_env(TimeObserved(DrivingEnv("roundabout"), 11), skip_render_check=True)


def test_a_clock_observed_on_the_trainings_scale_shows_the_same_in_a_shorter_test() -> None:
    """After five seconds an agent sees 5/13, in a training of 13 s as in a test of 10 s, and never 1 in the test."""
    rules = TrainingRules(training_clock=[13, 13], time_observed=13)
    training = TrainingEnv(
        observed(make_env("sumo", "u-turn", {"duration": 13}), rules), rules, ALL["regular"], 0
    )
    test = observed(make_env("sumo", "u-turn"), rules)
    assert training.observation_space == test.observation_space
    for env in (training, test):
        assert env.reset(seed=0)[0][0, -1] == 0
        seen = [env.step(SLOWER)[0][0, -1] for _ in range(5)]
        assert seen == pytest.approx([step / 13 for step in range(1, 6)])


def test_the_dose_is_a_column_of_the_ego() -> None:
    plain = make_env("sumo", "u-turn")
    assert observed(plain, PLAIN) is plain
    env = observed(make_env("sumo", "u-turn"), TrainingRules(dose_observed=True))
    for risk in (0.0, 0.25, 1.0):
        seen, _ = env.reset(seed=0, options={"config": {"risk": risk}})
        assert env.observation_space.contains(seen) and seen.shape == (2, 6)
        assert seen[0, -1] == risk and seen[1, -1] == 0
        assert env.step(SLOWER)[0][0, -1] == risk


def test_an_episode_has_a_dose_that_its_seed_draws() -> None:
    doses = [ALL["mixed"].dose_of(seed) for seed in range(400)]
    assert np.mean(doses) == pytest.approx(0.5, abs=0.06)
    assert set(doses) == {0.0, 1.0}
    env = TrainingEnv(make_env("sumo", "u-turn"), PLAIN, ALL["mixed"], 0)
    env.reset(seed=17, options={"config": {"risk": 0.25}})
    assert env.get_wrapper_attr("config")["risk"] == doses[17]


@pytest.mark.parametrize(("arm", "task"), [("no-brake", "highway"), ("no-cut-in", "u-turn")])
def test_one_kind_of_event_can_be_left_out_of_a_training(arm: str, task: str) -> None:
    """All others are there, and so is the kind in the test of the same environment."""
    with closing(make_sumo("sumo", task, env_config("sumo", task, 1))) as inner:
        env = TrainingEnv(inner, PLAIN, EVERY_ARM[arm].traffic, 0)
        kinds = []
        for own in (env, inner):
            own.reset(seed=3, options={"config": {"risk": 1.0}})
            kinds.append({event.kind for event in inner.unwrapped.scenario.events})  # type: ignore[attr-defined]
        assert kinds[1] - kinds[0] == {arm.removeprefix("no-")} and kinds[0]


def test_the_environments_of_a_training_share_its_episodes_out() -> None:
    """Resets without a seed begin the training's episodes in their order, in one environment or in three."""
    expected = [episode_seed(5, k) for k in range(6)]
    for count in (1, 3):
        envs = [
            TrainingEnv(make_env("sumo", "u-turn"), PLAIN, ALL["risky"], 5, first, count)
            for first in range(count)
        ]
        FakeEnv.met.clear()
        for k in range(6):
            envs[k % count].reset()
        assert [seed for seed, _, _ in FakeEnv.met] == expected
        assert {dose for _, dose, _ in FakeEnv.met} == {1.0}


def test_a_crash_reward_is_added_to_the_step_that_crashes_alone() -> None:
    faster = 3
    env = TrainingEnv(make_env("sumo", "two-way"), TrainingRules(crash_reward=-2.0), ALL["regular"], 0)
    plain = make_env("sumo", "two-way")
    env.reset(seed=1)
    plain.reset(seed=1)
    crashed = False
    while not crashed:
        reward, (_, own, crashed, _, info) = env.step(faster)[1], plain.step(faster)
        assert float(reward) == float(own) - 2.0 * crashed
        assert info["crashed"] == crashed


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
    evaluate(worth, agent, "u-turn", 1, range(12), ["risky"])
    return worth, env


def test_what_an_agent_gets_is_the_discounted_sum_and_what_it_still_expects_at_the_limit() -> None:
    worth, env = driven(PLAIN)
    ends = [crashed[-1] for _, crashed in env.kept]
    assert any(ends) and not all(ends)
    got = [
        sum(GAMMA**k * r for k, r in enumerate(rewards)) + (0.0 if end else GAMMA ** len(rewards) * 3.0)
        for (rewards, _), end in zip(env.kept, ends, strict=True)
    ]
    record = worth.record()
    assert (record["episodes"], record["expected"]) == (12, 7.0)
    assert record["got"] == pytest.approx(np.mean(got))
    assert record["size"] == pytest.approx(np.sqrt(np.mean(np.square(got))))


def test_the_price_of_a_crash_in_training_is_in_it() -> None:
    free, priced = (driven(TrainingRules(crash_reward=x))[0].record()["got"] for x in (0.0, -2.0))
    assert priced < free
