"""Platoon: three learning cars, with one policy for all, behind a leader of SUMO that slows down now and then.

The reward is the distance; gaps below 1.5 s, strong accelerations and crashes cost. (pip install pettingzoo supersuit)
"""

from pathlib import Path

import sumo_env

NETWORKS = Path(__file__).parent / "networks"
CONFIG = {
    "action": {"type": "ContinuousAction", "acceleration_range": [-3, 3], "lateral": False},
    "observation": {"type": "LeadersFollowers"},
    "policy_frequency": 2,
    "duration": 40,
    "progress_reward": 30,
    "gap_reward": -0.5,
    "comfort_reward": -0.02,
    "collision_reward": -10,
    "centering_position": [0.7, 0.5],  # of the first car in pictures
    "scaling": 4,
}


def make(**keywords):
    """The environment of PettingZoo."""
    network, routes = NETWORKS / "platoon.net.xml", NETWORKS / "platoon.rou.xml"
    cars = ["first", "second", "third"]
    return sumo_env.parallel_env(network, CONFIG, routes=routes, vehicles=cars, **keywords)


if __name__ == "__main__":
    from train import main

    main("platoon", make, "PPO", steps=60_000, levels=(-0.5, -0.4, -0.3, -0.2, -0.1, 0.0, 0.5))
