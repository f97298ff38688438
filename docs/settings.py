"""Settings of Stable-Baselines3 that learn: ``python docs/settings.py`` makes the rows that docs/settings.json lacks.

A row is TASK/RISK/DRIVER: the seed of a training, "random", or an action that is always taken. Tasks have the defaults
of their ids, which are light traffic. ``make pages`` makes a table of the rows (`trainings`).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import closing
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any

import gymnasium as gym
import pandas as pd

ROWS = Path(__file__).with_suffix(".json")
# Policy steps of an episode; each pays at most 1.
TASKS = {"highway-fast": 30, "two-way": 15, "roundabout": 11, "intersection": 13, "u-turn": 10}
RISKS, SEEDS = (0, 1), ("0", "1", "2")
SCENARIOS, STEPS = range(5000, 5100), 15_000  # README's; 100 scenarios, so that crashes are in %
DIGITS = {"return": 1, "crashes": 0, "speed": 1}
DQN = {
    "learning_rate": 5e-4,
    "gamma": 0.9,
    "batch_size": 64,
    "buffer_size": 30_000,
    "learning_starts": 500,
    "train_freq": 1,
    "target_update_interval": 100,
    "exploration_fraction": 0.5,
    "policy_kwargs": {"net_arch": [256, 256]},
}


def drive(env: gym.Env[Any, Any], act: Callable[[Any], Any]) -> dict[str, float]:
    """Mean return, crashes [%] and mean speed [m/s] in the scenarios."""
    returned, crashes, speeds = 0.0, 0, []
    for seed in SCENARIOS:
        seen, over = env.reset(seed=seed)[0], False
        while not over:
            seen, reward, terminated, truncated, info = env.step(act(seen))
            returned, over = returned + float(reward), terminated or truncated
            speeds.append(info["speed"])
        crashes += info["crashed"]
    return {"return": returned / 100, "crashes": crashes, "speed": fmean(speeds)}


def row(env: gym.Env[Any, Any], driver: str, actions: dict[str, int]) -> dict[str, float]:
    """What a driver does, and the CPU seconds of its training."""
    if driver not in SEEDS:
        env.action_space.seed(0)
        return drive(env, lambda _: actions[driver] if driver in actions else env.action_space.sample())
    from stable_baselines3 import DQN as Learner
    from torch import set_num_threads

    set_num_threads(1)
    began = time.process_time()
    model = Learner("MlpPolicy", env, seed=int(driver), **DQN).learn(STEPS)  # type: ignore[arg-type]
    seconds = time.process_time() - began
    return {"seconds": seconds, **drive(env, lambda seen: model.predict(seen, deterministic=True)[0])}


def trainings() -> str:
    """The lines of the table: agents (median, least, most), random, the best constant action, how far agents lead."""
    rows, lines = json.loads(ROWS.read_text()), []
    for task, risk in product(TASKS, RISKS):
        of = {name.split("/")[2]: row for name, row in rows.items() if name.startswith(f"{task}/{risk}/")}
        agents = pd.DataFrame([of.pop(seed) for seed in SEEDS if seed in of])
        best = max((name for name in of if name != "random"), key=lambda name: of[name]["return"])
        cells = [task, f"{risk}"]
        for key, digits in DIGITS.items():
            least, middle, most = (f"{value:.{digits}f}" for value in agents[key].quantile([0, 0.5, 1]))
            cells.append(middle if key == "speed" else f"{middle} ({least}–{most})")
        for name in ("random", best):
            cells.append("/".join(f"{of[name][key]:.{digits}f}" for key, digits in DIGITS.items()))
        cells[-1] = f"{best} {cells[-1]}"
        lead = 100 * (agents["return"].median() - max(row["return"] for row in of.values())) / TASKS[task]
        lines.append(f"| {' | '.join(cells)} | {f'**{lead:+.0f}**' if lead >= 5 else f'{lead:+.0f}'} |")
    return "\n".join(lines)


def main() -> None:
    """Make the rows."""
    for task, risk in product(TASKS, RISKS):
        with closing(gym.make(f"sumo_env:sumo/{task}-v0", config={"risk": risk})) as env:
            actions = {name: number for number, name in env.unwrapped.actions.items()}  # type: ignore[attr-defined]
            for driver in (*SEEDS, "random", *actions):
                rows = json.loads(ROWS.read_text()) if ROWS.exists() else {}
                if (name := f"{task}/{risk}/{driver}") not in rows:
                    rows[name] = {key: round(value, 3) for key, value in row(env, driver, actions).items()}
                    ROWS.write_text(json.dumps(rows, indent=1) + "\n")
                    print(name, rows[name], flush=True)


if __name__ == "__main__":
    main()
