"""Proximal policy optimisation (Schulman et al. 2017) in one file, in the manner of CleanRL (pip install torch).

python examples/ppo.py --steps 50000 --task u-turn --risk 0.5
"""

import argparse

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--task", default="u-turn")
parser.add_argument("--risk", type=float, default=0.0)
parser.add_argument("--steps", type=int, default=50_000, help="environment steps")
parser.add_argument("--envs", type=int, default=4, help="environments, each with a SUMO process of its own")
parser.add_argument("--rollout", type=int, default=64, help="steps of each environment between two updates")
parser.add_argument("--seed", type=int, default=0)
args = parser.parse_args()

GAMMA, LAMBDA, CLIP, EPOCHS, BATCHES = 0.9, 0.95, 0.2, 4, 4
torch.manual_seed(args.seed)
torch.set_num_threads(1)

envs = gym.make_vec(f"sumo_env:sumo/{args.task}-v0", num_envs=args.envs, config={"risk": args.risk})
inputs, actions_count = int(np.prod(envs.single_observation_space.shape)), envs.single_action_space.n


def network(outputs):
    """Two layers of 128 units on the flat observation."""
    layers = nn.Linear(inputs, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), nn.Linear(128, outputs)
    return nn.Sequential(nn.Flatten(), *layers)


actor, critic = network(actions_count), network(1)
optimizer = torch.optim.Adam([*actor.parameters(), *critic.parameters()], lr=5e-4)

observation = torch.as_tensor(envs.reset(seed=args.seed)[0])
# whether the last step of an environment ended its episode: the next one is its reset
over = torch.zeros(args.envs)
returns, running, steps = [], np.zeros(args.envs), 0
while steps < args.steps:
    rows = []
    for _ in range(args.rollout):
        with torch.no_grad():
            policy, value = Categorical(logits=actor(observation)), critic(observation)[:, 0]
        action = policy.sample()
        following, reward, terminated, truncated, _ = envs.step(action.numpy())
        valid = 1.0 - over  # a step that is a reset has no action and no reward
        outcome = torch.as_tensor(reward).float(), torch.as_tensor(terminated).float()
        rows.append((observation, action, policy.log_prob(action), value, *outcome, valid))
        running += reward
        ended = terminated | truncated
        returns += running[ended].tolist()
        running[ended] = 0.0
        observation, over = torch.as_tensor(following), torch.as_tensor(ended).float()
        steps += args.envs
    seen, action, log_prob, value, reward, terminated, valid = map(torch.stack, zip(*rows, strict=True))
    with torch.no_grad():
        following_value = torch.cat([value[1:], critic(observation)[:, 0][None]])
    # the advantage of a step, summed over the rest of its episode (an episode goes on until the next invalid step)
    going_on = torch.cat([valid[1:], 1.0 - over[None]])
    difference = reward + GAMMA * (1.0 - terminated) * following_value - value
    advantage, later = torch.zeros_like(value), torch.zeros(args.envs)
    for step in reversed(range(args.rollout)):
        later = difference[step] + GAMMA * LAMBDA * going_on[step] * later
        advantage[step] = later
    kept = valid.flatten().bool()
    flat = [part.flatten(0, 1)[kept] for part in (seen, action, log_prob, advantage, advantage + value)]
    for _ in range(EPOCHS):
        for rows_of_batch in torch.randperm(len(flat[0])).chunk(BATCHES):
            x, taken, old, gain, target = (part[rows_of_batch] for part in flat)
            policy = Categorical(logits=actor(x))
            ratio = (policy.log_prob(taken) - old).exp()
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            surrogate = torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain)
            error = (critic(x)[:, 0] - target).square()
            loss = (0.5 * error - surrogate - 0.01 * policy.entropy()).mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_([*actor.parameters(), *critic.parameters()], 0.5)
            optimizer.step()
    if returns:
        print(f"{steps} steps, return of the last {len(returns[-50:])} episodes {np.mean(returns[-50:]):.2f}")
envs.close()
