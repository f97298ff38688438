"""Highway: the agent changes lanes, and SUMO has the pedals (longitudinal: "sumo").

Slow cars are in all lanes. The reward is the distance in 40 s, so the agent has to find the free lanes.
After 10,000 steps the agent is not ahead of a constant action (docs/examples.md).
"""

from pathlib import Path

from sumo_env.scenarios import SumoDrivingEnv

NETWORKS = Path(__file__).parent / "networks"
CONFIG = {
    "action": {"type": "DiscreteMetaAction", "longitudinal": "sumo"},
    "observation": {"type": "LeadersFollowers"},
    "warm_up": 60,
    "duration": 40,
    "progress_reward": 20,
    "arrived_reward": 0,
}


def make(**keywords):
    """The environment."""
    files = NETWORKS / "highway.net.xml", NETWORKS / "highway.rou.xml"
    return SumoDrivingEnv(*files, ["in", "road"], CONFIG, ego_type="ego", **keywords)


if __name__ == "__main__":
    from train import main

    main("highway", make, "DQN", steps=10_000, gradient_steps=2)
