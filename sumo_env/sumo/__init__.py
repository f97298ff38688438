"""SUMO: the session with libsumo, an episode driven in it, and a process of its own for each further environment."""

from sumo_env.sumo.provider import open_simulator

__all__ = ["open_simulator"]
