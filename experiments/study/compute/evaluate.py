"""The test of a policy: the same regular and risky scenarios for every arm, training seed and policy."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd

from agents.policies import Policy
from experiments.study.compute.wrappers import UnseenRisk
from experiments.study.design.arms import scenario_seed, stream_seed
from experiments.study.design.traffic import traffic_named
from experiments.study.results.schema import ACTIONS, COLUMNS, OF_CRASH
from experiments.support.errors import UserError

STOPPED = 1.0  # [m/s] an ego slower than this stands


class Drive(NamedTuple):
    """A test episode: a scenario of a task and level (1 is the lightest) in a traffic of `traffic.ALL`.

    scenario: its number. purpose: "test", or "gate" for what an agent is judged on before.
    """

    task: str
    level: int
    traffic: str
    scenario: int
    purpose: str = "test"

    @property
    def seed(self) -> int:
        """Seed of the environment's reset; it does not depend on the traffic."""
        return scenario_seed(self.task, self.level, self.scenario, self.purpose)


def play(
    env: gym.Env[Any, Any],
    policy: Policy,
    drive: Drive,
    on_step: Callable[[], None] | None = None,
    options: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Play one test episode and return its row of COLUMNS.

    Args:
        env: an environment of the drive's task and level.
        on_step: called after the reset and after every step (a recorder).
        options: of the reset, in addition to the dose of risk.
    """
    traffic = traffic_named(drive.traffic)
    if traffic.is_unseen:
        env = UnseenRisk(env, traffic)
    policy.reset(stream_seed("policy", drive.task, drive.level, drive.traffic, drive.scenario))
    asked = {**traffic.options(drive.seed), **(options or {})}
    row = play_from(env, policy, drive.seed, asked, on_step)
    return {"traffic": drive.traffic, "scenario": drive.scenario, **row}


def play_from(
    env: gym.Env[Any, Any],
    policy: Policy,
    seed: int,
    options: Mapping[str, Any],
    on_step: Callable[[], None] | None = None,
) -> dict[str, Any]:
    """Play the episode of a reset with this seed and options: its row of COLUMNS but for traffic and scenario.

    policy: is reset. on_step: as in `play`.
    """
    observation, info = env.reset(seed=seed, options=dict(options))
    if on_step:
        on_step()
    rewards: list[float] = []
    steps: list[dict[str, Any]] = []
    actions: list[int] = []
    terminated = truncated = False
    while not (terminated or truncated):
        action = policy.act(observation)
        if isinstance(action, tuple):
            raise UserError(
                f"act returned the tuple {action}, not an action: of model.predict return the first part"
            )
        observation, reward, terminated, truncated, info = env.step(action)
        rewards.append(float(reward))
        steps.append(info)
        actions.append(int(action))
        if on_step:
            on_step()
    speeds = np.array([step["speed"] for step in steps])
    crash = info["crash"] if info["crashed"] else {}
    return {
        "return": math.fsum(rewards),
        "length": len(rewards),
        "crashed": bool(info["crashed"]),
        "arrived": bool(info["arrived"]),
        "truncated": bool(truncated and not terminated),
        "mean_speed": float(speeds.mean()),
        "distance": math.fsum(step["distance"] for step in steps),
        "min_ttc": min(float(step["min_ttc_before_contact"]) for step in steps),
        "near_misses": sum(bool(step["near_miss"]) for step in steps),
        "density": float(np.mean([step["density"] for step in steps])),
        "stopped": float((speeds < STOPPED).mean()),
        **{f"action_{number}": actions.count(number) for number in range(ACTIONS)},
        **{name: crash.get(name.removeprefix("crash_")) for name in OF_CRASH},
        "actions": "".join(map(str, actions)),
    }


def repeat(env: Any, action: int, times: int) -> tuple[tuple[int, ...], bool, bool]:
    """Take an action until the episode ends: what was taken, whether the ego crashed, whether it ended."""
    for number in range(1, times + 1):
        *_, terminated, truncated, info = env.step(action)
        if info["crashed"] or terminated or truncated:
            return (action,) * number, bool(info["crashed"]), True
    return (action,) * times, False, False


def limits(values: pd.Series, is_share: bool, confidence: float = 0.95) -> list[float]:
    """The mean of an outcome of episodes, and the ends of its interval over them; NaN for less than two.

    Wilson's of a share of episodes, Student's of any other mean.
    """
    from scipy import stats

    if is_share:
        found = stats.binomtest(int(values.sum()), len(values))
        return [float(value) for value in (found.statistic, *found.proportion_ci(confidence, "wilson"))]
    mean, half = values.mean(), stats.t.ppf(0.5 + confidence / 2, len(values) - 1) * values.sem()
    return [float(value) for value in (mean, mean - half, mean + half)]


def driving(episodes: pd.DataFrame) -> dict[str, list[float]]:
    """How a policy drives in some test episodes: crash_rate, return and speed [m/s], each as `limits`."""
    columns = {"crash_rate": "crashed", "return": "return", "speed": "mean_speed"}
    return {name: limits(episodes[column], column == "crashed") for name, column in columns.items()}


def evaluate(
    env: gym.Env[Any, Any],
    policy: Policy,
    task: str,
    level: int,
    scenarios: Sequence[int],
    traffics: Iterable[str],
    purpose: str = "test",
    on_episode: Callable[[], None] = lambda: None,
) -> pd.DataFrame:
    """Test a policy on these scenarios of a task and level in each of the traffics; one row of COLUMNS each.

    The result depends on the arguments alone, not on what `env` did before.
    """
    rows = []
    for traffic, number in product(traffics, scenarios):
        rows.append(play(env, policy, Drive(task, level, traffic, number, purpose)))
        on_episode()
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)
