"""Several learning cars that share one policy: PPO of Stable-Baselines3 through PettingZoo and SuperSuit.

    pip install -e '.[multi-agent,study]' stable-baselines3
    python examples/several_cars.py --out examples/several_cars.json      # some minutes

Three cars drive on the highway. A car that has crashed sees zeros until the episode ends (SuperSuit's `black_death`).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import supersuit
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

import sumo_env

CARS, STEPS, EPISODES = 3, 30_000, 100
CONFIG = {
    "controlled_vehicles": CARS,
    "vehicles_count": 20,
    "duration": 20,
    "action": {"type": "DiscreteMetaAction", "lateral": True},
}


def returns(model: PPO, episodes: int, deterministic: bool) -> list[float]:
    """The mean return of the cars in episodes of seeds that no training has seen."""
    env, found = sumo_env.parallel_env("sumo/highway-v0", CONFIG), []
    for seed in range(10_000, 10_000 + episodes):
        observations, _ = env.reset(seed=seed)
        total = 0.0
        while env.agents:
            chosen = model.predict(
                np.array([observations[agent] for agent in env.agents]), deterministic=deterministic
            )
            observations, rewards, *_ = env.step(dict(zip(env.agents, map(int, chosen[0]), strict=True)))
            total += sum(rewards.values())
        found.append(total / CARS)
    env.close()
    return found


def trained(seed: int, steps: int, episodes: int) -> dict[str, Any]:
    """What one training has reached."""
    set_random_seed(seed)
    env: Any = supersuit.black_death_v3(sumo_env.parallel_env("sumo/highway-v0", CONFIG))
    env = supersuit.pettingzoo_env_to_vec_env_v1(env)
    env = supersuit.concat_vec_envs_v1(env, 1, base_class="stable_baselines3")
    env.venv.reset(seed=seed)  # of the traffic of all episodes; Stable-Baselines3 cannot give it to SuperSuit
    model = PPO("MlpPolicy", env, n_steps=256, batch_size=96, n_epochs=10, gamma=0.8, learning_rate=1e-3,
                ent_coef=0.01, device="cpu")  # fmt: skip
    tried = {"untrained, sampled": returns(model, episodes, False)}
    tried["untrained, greedy"] = returns(model, episodes, True)
    model.learn(steps)
    tried["trained, greedy"] = returns(model, episodes, True)
    result: dict[str, Any] = {"steps": steps, "episodes": episodes}
    for name, values in tried.items():
        error = np.std(values, ddof=1) / len(values) ** 0.5
        result[name] = {"return": round(float(np.mean(values)), 3), "standard error": round(float(error), 3)}
    return result


def main() -> None:
    """Train once for each seed, and compare with the network before its training."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=STEPS, help="steps of all cars together")
    parser.add_argument("--episodes", type=int, default=EPISODES, help="for the comparison")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="one training each")
    parser.add_argument("--out", type=Path, help="trainings that are in this file already are kept")
    given = parser.parse_args()

    done = json.loads(given.out.read_text()) if given.out and given.out.exists() else {}
    for seed in given.seeds:
        if str(seed) in done:
            continue
        done[str(seed)] = trained(seed, given.steps, given.episodes)
        print(seed, json.dumps(done[str(seed)], indent=1))
        if given.out:
            given.out.write_text(json.dumps(done, indent=1) + "\n")


if __name__ == "__main__":
    main()
