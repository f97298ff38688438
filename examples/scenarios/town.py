"""Town: three trips through a small town with lights and side roads, among the traffic of a route file.

The car brakes for red lights by itself. The agent controls the target speed, has to give way and to keep its
distance; SUMO chooses the lanes.
"""

from pathlib import Path

from sumo_env.scenarios import SumoDrivingEnv

NETWORKS = Path(__file__).parent / "networks"
TRIPS = [("-225", "202"), ("-301", "308"), ("-198", "225")]
CONFIG = {
    "action": {"type": "DiscreteMetaAction", "lateral": "sumo", "target_speeds": [0, 5, 9, 13.9]},
    "obey_traffic_lights": True,
    "warm_up": 60,
    "simulation_frequency": 5,
    "duration": 150,
}


def make(**keywords):
    """The environment."""
    files = NETWORKS / "town.net.xml", NETWORKS / "town.rou.xml"
    return SumoDrivingEnv(*files, config=CONFIG, ego_trips=TRIPS, **keywords)


if __name__ == "__main__":
    from train import main

    main("town", make, "DQN", steps=6_000)
