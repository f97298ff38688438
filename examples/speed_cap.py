"""Safer, or only slower? Published agents drive with a cap on their speed (from a clone, with torch).

python examples/speed_cap.py roundabout     # in 200 risky scenarios of the frozen test; u-turn 40: in 40
"""

import argparse
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
        wanted = ladder[min(np.abs(ladder - env.vehicle.speed).argmin() + 1, len(ladder) - 1)]
        return names.index("IDLE") if names[action] == "FASTER" and wanted > self.cap else action


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("task", choices=SETTINGS)
parser.add_argument("--quick", action="store_true")
task, quick = vars(parser.parse_args()).values()
setting = f"{task}-{SETTINGS[task][0]}"
scenarios = [one for one in benchmark_scenarios([task], quick) if one.group == f"{setting}-risky"]
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
            crashed, speed = 100 * crashes / len(scenarios), np.mean(speeds)
            print(f"{arm:10}{cap:g} m/s: crashes {crashed:.1f} %, {speed:.1f} m/s")
