"""The five tasks on SUMO as classes to derive from, in the modules and under the names of ``highway_env.envs``."""

from sumo_env.envs.highway_env import HighwayEnv, HighwayEnvFast
from sumo_env.envs.intersection_env import IntersectionEnv
from sumo_env.envs.roundabout_env import RoundaboutEnv
from sumo_env.envs.two_way_env import TwoWayEnv
from sumo_env.envs.u_turn_env import UTurnEnv

__all__ = ["HighwayEnv", "HighwayEnvFast", "IntersectionEnv", "RoundaboutEnv", "TwoWayEnv", "UTurnEnv"]
