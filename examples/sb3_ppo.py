"""Stable-Baselines3's PPO on 64 environments that one call steps (pip install stable-baselines3 numba).

    python examples/sb3_ppo.py --steps 300000 --task u-turn --risk 0.5
    python examples/sb3_ppo.py --minutes 10               # trains for ten minutes
    python examples/sb3_ppo.py --minutes 10 --learner dqn # DQN on one environment, to compare

The agent then drives 200 scenarios, always the same ones.
"""

import argparse
import time

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--task", default="u-turn")
parser.add_argument("--risk", type=float, default=0.0, help="dose of risky traffic, 0 to 1")
parser.add_argument("--learner", choices=("ppo", "dqn"), default="ppo")
parser.add_argument("--steps", type=int, default=300_000)
parser.add_argument("--minutes", type=float, help="train for so long instead")
parser.add_argument("--scenarios", type=int, default=200, help="that the agent drives in the end")
parser.add_argument("--save", help="file for a model with the observation of sumo/*, for evaluate.py")
parser.add_argument("--envs", type=int, default=64)
parser.add_argument("--rollout", type=int, default=32, help="steps of each environment between two updates")
args = parser.parse_args()


class Batch(VecEnv):
    """A vector environment of gymnasium, made with autoreset_mode="SameStep", for Stable-Baselines3."""

    def __init__(self, envs):
        self.envs = envs
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self):
        """Start an episode in every environment."""
        seed = self._seeds[0]
        self._reset_seeds()
        return self.envs.reset(seed=seed)[0]

    def step_async(self, actions):
        """Take the actions of the next step."""
        self.actions = actions

    def step_wait(self):
        """Drive it; an episode that is over has its last observation in its info."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self.actions)
        over = terminated | truncated
        details = [{"TimeLimit.truncated": late} for late in (truncated & ~terminated).tolist()]
        for row in np.flatnonzero(over):
            details[row]["terminal_observation"] = infos["final_obs"][row]
        return observations, rewards.astype(np.float32), over, details

    def close(self):
        """End the threads."""
        self.envs.close()

    def get_attr(self, name, indices=None):
        """An attribute, which the environments share."""
        return [getattr(self.envs, name)] * len(list(self._get_indices(indices)))

    def set_attr(self, name, value, indices=None):
        """Not here."""
        raise NotImplementedError("the environments share their attributes")

    def env_method(self, name, *method_args, indices=None, **method_kwargs):
        """Not here."""
        raise NotImplementedError("the environments are rows of tables and have no methods")

    def env_is_wrapped(self, wrapper_class, indices=None):
        """No environment is wrapped by itself."""
        return [False] * len(list(self._get_indices(indices)))


torch.set_num_threads(1)  # several times faster with small networks
version = {"roundabout": 1, "intersection": 2, "u-turn": 1}.get(args.task, 0)  # highway-env's current ones
name = f"sumo_env:replica/{args.task}-v{version}"
traffic = {"scenarios": "seeded", "config": {"risk": args.risk}}
if args.save:
    on_sumo = gym.make(f"sumo_env:sumo/{args.task}-v0").unwrapped
    traffic["config"]["observation"] = on_sumo.config["observation"]
if args.learner == "ppo":
    envs = gym.make_vec(name, args.envs, autoreset_mode="SameStep", **traffic)
    model = PPO(
        "MlpPolicy",
        VecMonitor(Batch(envs)),
        n_steps=args.rollout,
        batch_size=args.envs * args.rollout // 4,
        n_epochs=4,
        gamma=0.9,
        learning_rate=5e-4,
        policy_kwargs={"net_arch": [128, 128]},
        seed=0,
        device="cpu",
    )
else:  # with the settings of highway-env's example
    model = DQN(
        "MlpPolicy",
        gym.make(name, **traffic),
        policy_kwargs={"net_arch": [256, 256]},
        learning_rate=5e-4,
        buffer_size=15_000,
        learning_starts=200,
        gamma=0.8,
        train_freq=1,
        target_update_interval=50,
        seed=0,
        device="cpu",
    )
end = time.monotonic() + 60 * (args.minutes or np.inf)
steps = 10**9 if args.minutes else args.steps
model.learn(steps, callback=lambda _, __: time.monotonic() < end)
model.env.close()
if args.save:
    model.save(args.save)

env, returns, crashes = gym.make(name, **traffic), [], []
for seed in range(args.scenarios):
    observation, info = env.reset(seed=1_000_000 + seed)
    total, over = 0.0, False
    while not over:
        action, _ = model.predict(observation, deterministic=True)
        observation, reward, terminated, truncated, info = env.step(int(action))
        total, over = total + reward, terminated or truncated
    returns.append(total)
    crashes.append(info["crashed"])
env.close()
print(
    f"{args.learner}, {args.task}, risk {args.risk:g}: {model.num_timesteps} steps; "
    f"return {np.mean(returns):.2f}, crashes in {np.mean(crashes):.0%} of {args.scenarios} scenarios"
)
