"""TorchRL on the environments (pip install torchrl).

python examples/torchrl_rollout.py
"""

import argparse

import sumo_env  # noqa: F401  (registers the ids)

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--steps", type=int, default=20)
args = parser.parse_args()

from torchrl.envs import GymEnv, StepCounter, TransformedEnv  # noqa: E402  (--help works without it)
from torchrl.envs.utils import check_env_specs  # noqa: E402

env = TransformedEnv(GymEnv("sumo/roundabout-v0", config={"risk": 0.5}), StepCounter())
check_env_specs(env)
rollout = env.rollout(args.steps, break_when_any_done=False)
print(rollout["observation"].shape, f"mean reward {rollout['next', 'reward'].mean():.3f}")
env.close()
