"""What is possible at all: the returns and crashes of a driver who knows the future, found by search on the replica.

    python -m experiments.study.clairvoyant --task two-way --level 1 --traffic risky

A beam search over copies of the environment: of the states after each step the best by return and some at random are
kept. What it finds is possible, and more may be, so that its crash rate is an upper bound of the least one. Agents do
not know the future; the distance to this driver says how much of a crash rate is due to the task.
"""

from __future__ import annotations

import copy
import sys
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import tyro

from experiments.backends import make_env
from experiments.study.arms import TRAFFICS
from experiments.study.grid import env_config
from experiments.study.seeds import scenario_seed
from experiments.support.threads import limit_threads


@dataclass(frozen=True)
class Options:
    """Search the best drives through some scenarios (the gates' ones, on which no result is reported)."""

    task: str = "two-way"
    """highway, two-way, roundabout, intersection or u-turn."""
    level: int = 1
    """Traffic level, 1 is the lightest."""
    traffic: Literal["regular", "risky"] = "regular"
    """Traffic to drive in."""
    scenarios: int = 50
    """Number of scenarios."""
    width: int = 40
    """States that are kept after each step; the time is proportional to it."""


def best_drive(env: Any, width: int, rng: np.random.Generator) -> tuple[float, bool]:
    """The largest return found from the present state of an environment that can be copied, and whether it crashes."""
    open_ends: list[tuple[float, Any]] = [(0.0, env)]
    found = (-np.inf, True)
    while open_ends:
        reached: dict[Any, tuple[float, Any]] = {}
        for total, before in open_ends:
            for action in range(before.action_space.n):
                after = copy.deepcopy(before)
                _, reward, terminated, truncated, info = after.step(action)
                drive = total + float(reward), bool(info["crashed"])
                if terminated or truncated:
                    found = max(found, drive, key=lambda drive: drive[0])
                elif (place := _place(after)) not in reached or reached[place][0] < drive[0]:
                    reached[place] = drive[0], after
        best = sorted(reached.values(), key=lambda end: -end[0])
        half = width // 2
        chance = rng.permutation(np.arange(half, len(best)))[: width - half]
        open_ends = best[:half] + [best[k] for k in chance]
    return found


def _place(env: Any) -> tuple[Any, ...]:
    """Of states that agree in this the best is kept: the ego within a metre and 1 m/s, with the same targets."""
    scene, ego = env.scene, env.ego_state
    return (*np.round([scene.x[0], scene.y[0], scene.speed[0]]).tolist(), ego.target_lane, ego.speed_index)


def main() -> int:
    """Command line."""
    options = tyro.cli(Options, description=__doc__)
    limit_threads()
    env = make_env("replica", options.task, env_config("replica", options.task, options.level))
    drives = []
    for number in range(options.scenarios):
        seed = scenario_seed(options.task, options.level, number, "gate")
        env.reset(seed=seed, options={"config": {"risk": TRAFFICS[options.traffic]}})
        drives.append(best_drive(env.unwrapped, options.width, np.random.default_rng(number)))
        returns, crashed = np.array(drives).T
        print(
            f"\r{options.task}, level {options.level}, {options.traffic}: {len(drives)} scenarios, "
            f"return {returns.mean():.2f}, crashed {crashed.mean():.2f}",
            end="", flush=True,
        )  # fmt: skip
    print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
