"""Stable-Baselines3's DQN with an EvalCallback (pip install stable-baselines3).

    python examples/sb3_dqn.py --steps 20000

Training and evaluation environment live in one process: the first has SUMO, the second gets a worker.
"""

import argparse

import gymnasium as gym
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--steps", type=int, default=20_000)
parser.add_argument("--risk", type=float, default=0.0, help="dose of risky traffic in training, 0 to 1")
parser.add_argument("--out", default="sb3_dqn")
args = parser.parse_args()

config = {"vehicles_count": 20, "duration": 20}
env = gym.make("sumo_env:sumo/highway-v0", config={**config, "risk": args.risk})
eval_env = Monitor(gym.make("sumo_env:sumo/highway-v0", config=config))
model = DQN(
    "MlpPolicy",
    env,
    policy_kwargs={"net_arch": [256, 256]},
    learning_rate=5e-4,
    buffer_size=15_000,
    learning_starts=min(200, args.steps // 2),
    batch_size=32,
    gamma=0.8,
    train_freq=1,
    target_update_interval=50,
    verbose=1,
)
evaluation = EvalCallback(
    eval_env, eval_freq=max(args.steps // 4, 1), n_eval_episodes=2, best_model_save_path=args.out
)
model.learn(args.steps, callback=evaluation)
model.save(f"{args.out}/last")

model = DQN.load(f"{args.out}/last")
for risk in (0.0, 1.0):
    eval_env.unwrapped.configure({"risk": risk})
    mean, deviation = evaluate_policy(model, eval_env, n_eval_episodes=5)
    print(f"risk {risk:g}: return {mean:.2f} +- {deviation:.2f}")
env.close()
eval_env.close()
