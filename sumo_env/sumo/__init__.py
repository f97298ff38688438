"""SUMO: the session with libsumo, an episode driven in it, and a process of its own for each further environment."""

from __future__ import annotations

from sumo_env.simulator import Simulator


def open_simulator() -> Simulator:
    """SUMO for one more environment."""
    from sumo_env.sumo.world import SumoSimulator

    return SumoSimulator()
