"""Safer, or only slower? Published agents drive with a cap on their speed (from a clone, with torch).

    python examples/speed_cap.py roundabout     # in 200 risky scenarios of the frozen test; u-turn 40: in 40

Where FASTER would lead above the cap, the car gets IDLE.
"""

import sys
from contextlib import closing

import gymnasium as gym
import numpy as np

import agents
from sumo_env.benchmark import SETTINGS, benchmark_scenarios


class Capped(gym.ActionWrapper):
    """Refuses FASTER where it leads to a target speed above the cap [m/s]."""

    def action(self, action: int) -> int:
        """IDLE where FASTER is refused."""
        env = self.unwrapped
        ladder, names = np.array(env.action_type.target_speeds), list(env.actions.values())
        following = min(np.abs(ladder - env.vehicle.speed).argmin() + 1, len(ladder) - 1)
        refused = names[action] == "FASTER" and ladder[following] > self.cap
        return names.index("IDLE") if refused else action


task, count = sys.argv[1], int([*sys.argv, "200"][2])
setting = f"{task}-{SETTINGS[task][0]}"
scenarios = [one for one in benchmark_scenarios([task]) if one.group == f"{setting}-risky"][:count]
for arm in ("control", "treatment"):
    policy, config = agents.load(setting, arm), agents.card(setting, arm)["config"]
    with closing(Capped(gym.make(f"sumo_env:sumo/{task}-v0", config=config))) as env:
        for cap in env.unwrapped.action_type.target_speeds[:0:-1]:
            env.cap, crashes, speeds = cap, 0, []
            for one in scenarios:
                seen, over = env.reset(seed=one.seed, options=one.options)[0], False
                policy.reset()
                while not over:
                    seen, _, terminated, truncated, info = env.step(policy.act(seen))
                    speeds.append(info["speed"])
                    over = terminated or truncated
                crashes += info["crashed"]
            print(f"{arm:10}{cap:g} m/s: crashes {100 * crashes / count:.1f} %, {np.mean(speeds):.1f} m/s")
