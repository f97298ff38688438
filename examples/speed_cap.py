"""Safer, or only slower? Published agents drive with a cap on their speed (from a clone, with torch).

    python examples/speed_cap.py --tasks roundabout   # by default the five of the study

Where FASTER would lead above the cap, the car gets IDLE. Each line: the risky scenarios of the frozen test.
"""

import argparse
from contextlib import closing
from itertools import product

import gymnasium as gym
import numpy as np

import agents
from sumo_env.benchmark import SETTINGS, benchmark_scenarios


class Capped(gym.ActionWrapper):
    """Refuses FASTER where it leads to a target speed above the cap [m/s]."""

    cap = np.inf

    def action(self, action: int) -> int:
        """IDLE where FASTER is refused."""
        env = self.unwrapped
        ladder = np.array(env.action_type.target_speeds)
        following = min(np.abs(ladder - env.vehicle.speed).argmin() + 1, len(ladder) - 1)
        if env.actions[action] != "FASTER" or ladder[following] <= self.cap:
            return action
        return next(number for number, name in env.actions.items() if name == "IDLE")


def main(tasks: list[str], count: int) -> None:
    """Drive and print."""
    for task, arm in product(tasks, ("control", "treatment")):
        setting = f"{task}-{SETTINGS[task][0]}"
        policy, config = agents.load(setting, arm), agents.card(setting, arm)["config"]
        scenarios = [one for one in benchmark_scenarios([task]) if one.group == f"{setting}-risky"][:count]
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
                rate = 100 * crashes / len(scenarios)
                print(
                    f"{task:13}{arm:10} at most {cap:g} m/s: crashes {rate:.1f} %, {np.mean(speeds):.1f} m/s"
                )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", nargs="+", choices=SETTINGS, default=list(SETTINGS))
    parser.add_argument("--scenarios", type=int, default=200)
    main(*vars(parser.parse_args()).values())
