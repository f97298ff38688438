"""Ring, with mixed autonomy: 21 cars of SUMO and the agent's, which can calm their waves. A ring has no arrival.

The reward is the mean speed of all cars, the ego included.
"""

from pathlib import Path

from sumo_env.env import DrivingEnv
from sumo_env.scenarios import NetworkTask

NETWORKS = Path(__file__).parent / "networks"
CONFIG = {
    "action": {"type": "ContinuousAction", "acceleration_range": [-3, 1.5], "lateral": False},
    "observation": {"type": "LeadersFollowers"},
    "warm_up": 60,
    "simulation_frequency": 5,
    "duration": 60,
}


class Ring(NetworkTask):
    """The reward is of all cars."""

    defaults = NetworkTask.defaults | {"progress_reward": 0, "mean_speed_reward": 0.2}

    def rewards(self, ego, config):
        """The terms, by name."""
        return {**super().rewards(ego, config), "mean_speed_reward": float(ego.scene.speed.mean())}


def make(**keywords):
    """The environment."""
    task = Ring(NETWORKS / "ring.net.xml", NETWORKS / "ring.rou.xml", ego_vehicle="car0")
    return DrivingEnv(task, CONFIG, **keywords)


if __name__ == "__main__":
    from train import main

    main("ring", make, "PPO", steps=10_000, levels=(-0.5, -0.1, -0.05, 0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0))
