"""Any SUMO scenario: a user's own files, which SUMO loads and drives, with one learning car or several in them.

`SumoDrivingEnv` is the environment, `NetworkTask` its task, to derive from. The files are looked into by `file_checks`
and driven by `simulator`, where `route_ego` keeps the learning car on its way. `HandOver` leaves the car to SUMO at
times. Several learning cars: `sumo_env.parallel_env`.
"""

from sumo_env.scenarios.env import SumoDrivingEnv
from sumo_env.scenarios.hand_over import HandOver
from sumo_env.scenarios.network import NetworkTask

__all__ = ["HandOver", "NetworkTask", "SumoDrivingEnv"]
