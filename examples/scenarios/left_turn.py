"""Left turn: across the oncoming traffic of a crossing without lights, to which SUMO's drivers give way by its rules.

The agent has the target speed alone. Nobody stops for it, and it crashes if it drives into a gap that is too small.
After 14,000 steps the agent is not ahead of a constant action (docs/examples.md).
"""

from pathlib import Path

from sumo_env.env import SumoDrivingEnv

NETWORK = Path(__file__).parent / "networks" / "left_turn.net.xml"
ROUTES = [["nc", "cs"], ["nc", "cs"], ["wc", "ce"], ["ec", "cw"]]  # half of the cars come towards the ego
CONFIG = {
    "action": {"type": "DiscreteMetaAction", "lateral": False, "target_speeds": [0, 6, 12]},
    "vehicles_count": 6,
    "spawn_probability": 0.5,
    "duration": 40,
}


def make(**keywords):
    """The environment."""
    return SumoDrivingEnv(NETWORK, ROUTES, ["sc", "cw"], CONFIG, **keywords)


if __name__ == "__main__":
    from train import main

    main("left_turn", make, "DQN", steps=14_000)
