"""The ego: from highway-env's discrete meta-actions to a commanded speed and a target lane.

The low-level driver is highway-env's: speed follows the commanded rung with a first-order lag of 0.6 s, without a
limit on acceleration; the target lane is kept until reached. The lateral motion itself is SUMO's.
"""

from __future__ import annotations

from sumo_env.compiled import borrowing
from sumo_env.config import ConfigError
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.tasks.base import nearest_index

TAU = 0.6  # [s] ControlledVehicle.TAU_ACC
REFERENCE_STEP = 1.0 / 15.0  # [s] highway-env's step, whose Euler lag is reproduced at any step length

LONGITUDINAL_AND_LATERAL = {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT", 3: "FASTER", 4: "SLOWER"}
LONGITUDINAL = {0: "SLOWER", 1: "IDLE", 2: "FASTER"}
LATERAL = {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT"}


def action_names(action: dict[str, object]) -> dict[int, str]:
    """Meta-actions by index for a config's ``action`` entry (``DiscreteMetaAction``)."""
    longitudinal, lateral = action.get("longitudinal", True), action.get("lateral", True)
    if longitudinal and lateral:
        return LONGITUDINAL_AND_LATERAL
    if longitudinal:
        return LONGITUDINAL
    if lateral:
        return LATERAL
    raise ConfigError("the action must be longitudinal, lateral or both")


class Ego:
    """Targets and speed of the ego during an episode.

    Attributes:
        speed: [m/s], negative never.
        speed_index: commanded rung of `target_speeds`.
        target_lane: lane index that it steers for.
        crashed: since contact it only coasts to a stop.
    """

    def __init__(
        self,
        road: Road,
        lane: LaneIndex,
        speed: float,
        target_speeds: tuple[float, ...],
        route: tuple[str, ...],
    ) -> None:
        self.road = road
        self.route = route
        self.target_speeds = target_speeds
        self.speed = speed
        self.speed_index = nearest_index(speed, target_speeds)
        self.target_lane = lane
        self.crashed = False

    @property
    def target_speed(self) -> float:
        """The commanded rung [m/s]."""
        return self.target_speeds[self.speed_index]

    def command(self, action: str, x: float, y: float) -> None:
        """Apply a meta-action at the ego's centre (x, y) [m] (``MDPVehicle.act``)."""
        if action in ("FASTER", "SLOWER"):
            # relative to the measured speed, not to the rung commanded before
            rung = nearest_index(self.speed, self.target_speeds) + (1 if action == "FASTER" else -1)
            self.speed_index = min(max(rung, 0), len(self.target_speeds) - 1)
        self.follow_road(x, y)
        if action in ("LANE_LEFT", "LANE_RIGHT"):
            start, end, i = self.target_lane
            last = self.road.count(start, end) - 1
            lane = (start, end, min(max(i + (1 if action == "LANE_RIGHT" else -1), 0), last))
            if self.road.lane(lane).is_reachable_from(x, y):
                self.target_lane = lane

    def follow_road(self, x: float, y: float) -> None:
        """At the end of the target lane, aim for the next one of the route (``ControlledVehicle.follow_road``)."""
        if self.road.lane(self.target_lane).after_end(x, y):
            self.target_lane = self.road.next_lane(self.target_lane, self.route, x, y)

    def advance(self, dt: float) -> float:
        """Drive for `dt` [s]; returns the distance covered [m].

        highway-env integrates the lag v' = (target - v) / 0.6 s by explicit Euler at 15 Hz, and a wreck's v' = -v
        likewise; speed and distance are those, at any `dt`.
        """
        if self.crashed:
            self.speed, distance = coast(self.speed, dt)
        else:
            self.speed, distance = approach(self.speed, self.target_speed, TAU, dt)
        return distance


@borrowing
def approach(speed: float, target: float, tau: float, dt: float) -> tuple[float, float]:
    """Speed [m/s] after `dt` [s] of first-order lag `tau` [s], and the distance covered [m]."""
    kept = (1.0 - REFERENCE_STEP / tau) ** (dt / REFERENCE_STEP)
    difference = speed - target
    return target + difference * kept, target * dt + difference * tau * (1.0 - kept)


@borrowing
def coast(speed: float, dt: float) -> tuple[float, float]:
    """Speed [m/s] of a wreck after `dt` [s], and the distance covered [m]: it decelerates with a = -v."""
    return approach(speed, 0.0, 1.0, dt)
