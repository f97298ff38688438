"""Trains an agent of Stable-Baselines3 in one of these examples (pip install stable-baselines3).

On 100 seeds that it has not trained on, the agent is compared with every constant action and with SUMO's driver.
"""

import argparse
import json
import time
from itertools import product
from pathlib import Path

import gymnasium as gym
import numpy as np
import stable_baselines3
import torch
from PIL import Image
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

TEST, OTHERS = 10_000, 20_000  # first seeds of the test, and of the choice of two constant actions for it
SETTINGS = {
    "DQN": {
        **{"learning_starts": 1000, "buffer_size": 50_000, "batch_size": 64, "train_freq": 4},
        **{"gradient_steps": 4, "target_update_interval": 500, "exploration_fraction": 0.3},
        **{"learning_rate": lambda left: 5e-4 * left, "policy_kwargs": {"net_arch": [128, 128]}},
    },
    "PPO": {"n_steps": 512, "batch_size": 128, "learning_rate": 1e-3},
}


class Several(gym.Env):
    """Learning cars as one environment, of PettingZoo's: a row for each car, zeros for a car that has crashed.

    An action is a row for each car, or one for all. The reward is the mean of the cars, a crash is that of any of them.
    """

    def __init__(self, env):
        self.cars = [env.cars[agent] for agent in env.possible_agents]
        self.env, self.action_space = env, self.cars[0].action_space
        self.shape = (len(self.cars), *self.cars[0].observation_space.shape)

    def rows(self, observations):
        """The observations as an array."""
        seen = np.zeros(self.shape, np.float32)
        for agent in self.env.agents:
            seen[self.env.possible_agents.index(agent)] = observations[agent]
        return seen

    def reset(self, seed=None, options=None):
        """As of gymnasium."""
        observations, _ = self.env.reset(seed, options)
        return self.rows(observations), {}

    def step(self, action):
        """As of gymnasium."""
        each = np.broadcast_to(action, (len(self.cars), *self.action_space.shape))
        acting = dict(zip(self.env.possible_agents, each, strict=True))
        observations, rewards, *_ = self.env.step({agent: acting[agent] for agent in self.env.agents})
        reward = sum(rewards.values()) / len(self.cars)
        info = {"crashed": any(car.ego_state.crashed for car in self.cars)}
        return self.rows(observations), reward, not self.env.agents, False, info

    def hand_over(self):
        """Let SUMO drive all cars."""
        for car in self.cars:
            car.hand_over()

    def render(self):
        """The scene."""
        return self.env.render()

    def close(self):
        """Close the simulator."""
        self.env.close()


def learning(env):
    """The environments of a training: one, or one for each of several learning cars, which share a policy."""
    if isinstance(env, gym.Env):
        return DummyVecEnv([lambda: gym.wrappers.FlattenObservation(env)])
    import supersuit

    cars = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(env))
    together = supersuit.concat_vec_envs_v1(cars, 1, base_class="stable_baselines3")
    together.venv.seed = lambda seed: together.venv.reset(seed=seed)  # which SuperSuit lacks
    return together


def constants(space, levels):
    """Actions that a driver may take for ever, by name."""
    if isinstance(space, gym.spaces.Discrete):
        return {str(number): number for number in range(space.n)}
    axes = (levels, *[(-1.0, 0.0, 1.0)] * (space.shape[0] - 1))
    return {str(values): np.array(values, np.float32) for values in product(*axes)}


def returns(env, act, seeds, sumo_drives=False):
    """Returns of episodes, and how many of them ended with a crash."""
    totals, crashes = [], 0
    inner = env.unwrapped
    env = inner if sumo_drives else env
    for seed in seeds:
        observation, info = env.reset(seed=seed)
        total, over = 0.0, False
        while not over:
            if sumo_drives:
                inner.hand_over()
            observation, reward, terminated, truncated, info = env.step(act(observation))
            total, over = total + reward, terminated or truncated
        totals.append(total)
        crashes += info["crashed"]
    return np.array(totals), crashes


def main(name, make, learner, steps, levels=(-1.0, -0.5, 0.0, 0.5, 1.0), **settings):
    """Train, test, and write down what was found; options of the command line change the sizes.

    levels: of the first number of constant actions.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=steps)
    parser.add_argument("--episodes", type=int, default=100, help="of the test")
    parser.add_argument("--out", type=Path, default=Path("results.json"))
    parser.add_argument("--picture", type=Path, help="file for a picture of a test episode")
    given = parser.parse_args()
    torch.set_num_threads(1)
    begin = time.process_time()
    seen = VecNormalize(learning(make()), norm_reward=False)
    kind = getattr(stable_baselines3, learner)
    model = kind("MlpPolicy", seen, seed=0, gamma=0.98, device="cpu", **SETTINGS[learner] | settings)
    model.learn(given.steps)
    seen.close()
    cost = time.process_time() - begin

    def act(observation):
        return model.predict(seen.normalize_obs(observation), deterministic=True)[0]

    env = make(render_mode="rgb_array")
    env = gym.wrappers.FlattenObservation(env) if isinstance(env, gym.Env) else Several(env)
    seeds = range(TEST, TEST + given.episodes)
    agent, crashes = returns(env, act, seeds)
    tried = constants(env.action_space, levels)
    first = {
        name: returns(env, lambda _, a=a: a, range(OTHERS, OTHERS + min(10, given.episodes)))[0].mean()
        for name, a in tried.items()
    }
    few = sorted(first, key=first.get)[-2:]
    tried = {name: returns(env, lambda _, a=tried[name]: a, seeds)[0] for name in few}
    sumo, sumo_crashes = returns(env, lambda _: env.action_space.sample(), seeds, sumo_drives=True)
    best = max(tried, key=lambda name: tried[name].mean())
    ahead = agent - tried[best]
    row = {
        "learner": learner,
        "steps": given.steps,
        "training CPU s": round(cost),
        "episodes": given.episodes,
        "return": float(agent.mean()),
        "crashes": crashes,
        "SUMO drives": float(sumo.mean()),
        "its crashes": sumo_crashes,
        "best constant": best,
        "its return": float(tried[best].mean()),
        "ahead": float(ahead.mean()),
        "standard error": float(ahead.std(ddof=1)) / len(ahead) ** 0.5,
    }
    row = {key: round(value, 3) if isinstance(value, float) else value for key, value in row.items()}
    print(name, row)
    rows = json.loads(given.out.read_text()) if given.out.exists() else {}
    given.out.write_text(json.dumps({**rows, name: row}, indent=1) + "\n")
    if given.picture:
        observation, _ = env.reset(seed=TEST)
        for _ in range(12):
            observation, _, terminated, truncated, _ = env.step(act(observation))
            if terminated or truncated:
                break
        Image.fromarray(env.render()).quantize(32).save(given.picture)
    env.close()


def table(rows):
    """The results as a table in Markdown."""
    lines = ["| example | agent | best constant action | SUMO's driver |", "|---|---|---|---|"]
    for name, row in sorted(rows.items()):
        bold = "**" if row["ahead"] > 2 * row["standard error"] else ""
        agent = f"{row['learner']} {bold}{row['return']:.2f}{bold}"
        lines.append(f"| `{name}` | {agent} | {row['its return']:.2f} | {row['SUMO drives']:.2f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(json.loads((Path(__file__).parent / "results.json").read_text())))
