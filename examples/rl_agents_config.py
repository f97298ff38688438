"""A configuration file of rl-agents, used as its `load_environment` does.

    python examples/rl_agents_config.py examples/rl_agents_intersection.json

With rl-agents installed, pass the same file to its scripts/experiments.py. Files of rl-agents' own work with "id" and
"import_module" changed to "sumo/...-v0" and "sumo_env"; what cannot be driven on SUMO is a ConfigError. Planners (MCTS,
DeterministicPlanner) copy the environment, which works; the preprocessor "simplify" does not exist.
"""

import argparse
import json
from pathlib import Path

import gymnasium as gym

import sumo_env  # noqa: F401  (registers its environments)

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument(
    "file", nargs="?", type=Path, default=Path(__file__).with_name("rl_agents_intersection.json")
)
parser.add_argument("--steps", type=int, default=100)
args = parser.parse_args()

config = json.loads(args.file.read_text())
# rl-agents imports any module that a file names; nothing is imported here
if config["import_module"] != "sumo_env" or ":" in config["id"]:
    parser.error(f'{args.file}: "import_module" must be sumo_env, and "id" one of its environments')
env = gym.make(config["id"], render_mode="rgb_array")
env.unwrapped.configure(config)  # the whole file, "id" and "import_module" included

observation, info = env.reset(seed=0)
episodes = crashes = 0
for _ in range(args.steps):
    action = env.unwrapped.action_type.actions_indexes["IDLE"]
    observation, reward, terminated, truncated, info = env.step(action)
    if terminated or truncated:
        episodes, crashes = episodes + 1, crashes + info["crashed"]
        observation, info = env.reset()
print(f"observation {observation.shape}; {crashes} crashes in {episodes} episodes")
env.close()
