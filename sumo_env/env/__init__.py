"""The environments: of one learning car in a task or in any SUMO scenario, and of several cars in one simulation."""

from sumo_env.env.driving import DrivingEnv
from sumo_env.env.own_network import SumoDrivingEnv

__all__ = ["DrivingEnv", "SumoDrivingEnv"]
