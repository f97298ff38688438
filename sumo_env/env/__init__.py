"""The environments of one learning car, and of several cars in one simulation."""

from sumo_env.env.driving import DrivingEnv

__all__ = ["DrivingEnv"]
