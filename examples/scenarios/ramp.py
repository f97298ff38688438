"""Ramp merge: the agent has pedals and lanes (ContinuousAction) on the acceleration lane of a motorway.

It arrives only if it finds a gap among the cars of the motorway before its lane ends. After 16,000 steps the
agent is not ahead of a constant action (docs/examples.md).
"""

from pathlib import Path

from sumo_env.scenarios import SumoDrivingEnv

NETWORK = Path(__file__).parent / "networks" / "ramp.net.xml"
CONFIG = {
    "action": {"type": "ContinuousAction", "acceleration_range": [-4, 3]},
    "observation": {"type": "LeadersFollowers", "features": ["lane_end", "lane_end_left"]},
    "vehicles_count": 10,
    "spawn_probability": 0.6,
    "policy_frequency": 2,
    "duration": 60,
}


def make(**keywords):
    """The environment."""
    main_road, ego = [["main", "merge", "out"]], ["ramp", "merge", "out"]
    return SumoDrivingEnv(NETWORK, main_road, ego, CONFIG, **keywords)


if __name__ == "__main__":
    from train import main

    main("ramp", make, "PPO", steps=16_000, levels=(-1.0, -0.5, 0.0, 0.1, 0.2, 0.3, 0.5, 1.0))
