"""Terms of the reward by name, for networks of one's own; their weights are keys of the configuration, 0 by default.

Each is a cost: a weight is negative where it is to be avoided. All are sums over time, so that a weight means the same
at any policy frequency.
"""

from sumo_env.config import Config, pace
from sumo_env.tasks.base import EgoState

TERMS: Config = {
    "comfort_reward": 0,  # for each m2/s3: the square of the acceleration, over time
    "gap_reward": 0,  # for each second with a time gap of 0, half of it with half of `time_gap`
    "fuel_reward": 0,  # for each gram of fuel, by SUMO's emission class of the ego's type
    "electricity_reward": 0,  # for each watt-hour
    "braking_reward": 0,  # for each m/s that the vehicle behind the ego loses
    "measure_energy": False,  # whether `info` has fuel and electricity
    "time_gap": 1.5,  # [s] to the leader, from which on `gap_reward` costs nothing
}
STANDING = 0.1  # [m/s] slower than this, no time gap is kept


def measures_energy(config: Config) -> bool:
    """Whether SUMO is asked for what the ego consumes, because a term or `info` needs it."""
    return bool(config["measure_energy"] or config["fuel_reward"] or config["electricity_reward"])


def terms(ego: EgoState, config: Config) -> dict[str, float]:
    """The raw terms of one policy step."""
    place = ego.place
    dt = 1.0 / pace(int(config["simulation_frequency"]), int(config["policy_frequency"]))
    follower, before = place.neighbours[3], {}
    if ego.before is not None and ego.before.place is not None:
        before = {neighbour.id: neighbour.speed for neighbour in ego.before.place.neighbours[1::2]}
    gap = max(place.neighbours[2].gap, 0.0) / ego.speed if ego.speed > STANDING else config["time_gap"]
    return {
        "comfort_reward": ego.acceleration**2 * dt,
        "gap_reward": max(1.0 - gap / config["time_gap"], 0.0) * dt,
        "fuel_reward": place.fuel / 1000.0,
        "electricity_reward": place.electricity,
        "braking_reward": max(before.get(follower.id, follower.speed) - follower.speed, 0.0),
    }
