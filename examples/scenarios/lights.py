"""Corridor of lights, with fuel: the agent chooses a speed, so that it meets the next light at green.

The car brakes for red lights by itself (obey_traffic_lights). The reward is the distance, less the fuel.
After 6,000 steps the agent is behind a constant action (docs/examples.md).
"""

from pathlib import Path

from sumo_env.scenarios import SumoDrivingEnv

NETWORK = Path(__file__).parent / "networks" / "lights.net.xml"
MAIN = ["in", "m0", "m1", "m2", "m3"]
ROUTES = [MAIN, *([f"down{k}", f"leave{k}"] for k in range(4))]
FEATURES = ["presence", "x", "vx", "light", "light_distance", "light_seconds", "leader_gap", "leader_closing"]
CONFIG = {
    "action": {"type": "DiscreteMetaAction", "lateral": False, "target_speeds": [4, 6, 8, 10, 12, 14]},
    "observation": {"type": "Kinematics", "vehicles_count": 1, "features": FEATURES},
    "obey_traffic_lights": True,
    "vehicles_count": 8,
    "spawn_probability": 0.2,
    "duration": 240,
    "progress_reward": 20,
    "fuel_reward": -0.2,
}


def make(**keywords):
    """The environment: the ego comes on the main road, at any of its first lights' phases."""
    return SumoDrivingEnv(NETWORK, ROUTES, [MAIN, MAIN[1:], MAIN[2:]], CONFIG, **keywords)


if __name__ == "__main__":
    from train import main

    main("lights", make, "DQN", steps=6_000)
