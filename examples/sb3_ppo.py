"""Stable-Baselines3's PPO on 64 environments that one call steps (pip install stable-baselines3 numba).

python examples/sb3_ppo.py --steps 300000 --task u-turn --risk 0.5
"""

import argparse

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--task", default="u-turn")
parser.add_argument("--risk", type=float, default=0.0, help="dose of risky traffic, 0 to 1")
parser.add_argument("--steps", type=int, default=300_000)
parser.add_argument("--envs", type=int, default=64)
parser.add_argument("--threads", type=int, default=1, help="that drive the environments")
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


envs = gym.make_vec(
    f"sumo_env:replica/{args.task}-v0",
    num_envs=args.envs,
    autoreset_mode="SameStep",
    threads=args.threads,
    scenarios="seeded",
    config={"risk": args.risk},
)
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
model.learn(args.steps)
returns = [episode["r"] for episode in model.ep_info_buffer]
print(f"{model.num_timesteps} steps, return of the last {len(returns)} episodes {np.mean(returns):.2f}")
model.env.close()
