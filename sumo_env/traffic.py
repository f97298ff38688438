"""Who drives the other vehicles: SUMO itself, or highway-env's rules computed in `models` and commanded to SUMO.

A `Rule` drives the traffic of one task under one traffic model. ``matched`` takes from SUMO what agrees with
highway-env and replaces the rest (docs/decisions.md, "traffic model"); ``sumo`` is SUMO's own behaviour.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from sumo_env.bends import Bends, GiveWay
from sumo_env.computed import SWERVE_TIME, Mobil, Strip
from sumo_env.drivers import RiskEvent
from sumo_env.loop import Progress, Traffic
from sumo_env.native import CENTRED, Native
from sumo_env.networks.roads import Road
from sumo_env.simulation import NO_LANE_CHANGES, OWN_LANE_CHANGES, REGULAR

if TYPE_CHECKING:
    from sumo_env.world import World


class Rule(Protocol):
    """Drives the regular traffic. Rows of the world's arrays: 0 is the ego, which no rule touches."""

    speed_mode: int
    lane_change_mode: int

    def start(self, world: World, first: int) -> None:
        """Look at the vehicles at the start of an episode, or after some came or went: new ones from row `first` on."""

    def act(self, world: World) -> None:
        """Command the vehicles for the next simulation step."""

    def drive(self, world: World, traffic: Traffic, count: int, progress: Progress) -> Progress:
        """Drive up to `count` simulation steps at once (`loop`), going on from `progress`."""

    def busy_from(self, world: World) -> float:
        """From when on `act` has to be called before every step [s]: `drive` must not be used then."""

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        """Make a vehicle change lane at once, if nobody is beside it."""


def rule_for(task: str, traffic_model: str, road: Road) -> Rule:
    """The rule that drives the traffic of a task (reference: docs/decisions.md, "traffic model")."""
    if task == "highway":
        return Mobil() if traffic_model == "matched" else Native(REGULAR, OWN_LANE_CHANGES)
    if task == "two-way":
        return Strip() if traffic_model == "matched" else Native(REGULAR, NO_LANE_CHANGES)
    if task == "roundabout":
        return Bends(road) if traffic_model == "matched" else Native(REGULAR, OWN_LANE_CHANGES)
    if task == "intersection":
        return GiveWay(road) if traffic_model == "matched" else Native(REGULAR, NO_LANE_CHANGES)
    return Bends(road) if traffic_model == "matched" else Native(REGULAR, OWN_LANE_CHANGES)


__all__ = ["CENTRED", "SWERVE_TIME", "Rule", "rule_for"]
