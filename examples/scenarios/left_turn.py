"""Left turn across oncoming traffic, to which the ego has to give way, at a crossing without lights.

The agent controls only its target speed. No car stops for it, and it crashes if it takes a gap that is too small.
After 14,000 steps the agent is not ahead of a constant action (docs/examples.md).
"""

from pathlib import Path

from sumo_env.scenarios import SumoDrivingEnv

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
