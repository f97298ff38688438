"""highway-env's discrete meta-actions: what they mean for the ego's target speed and target lane.

Pure functions of the road and the scene (``MDPVehicle.act``, ``ControlledVehicle.follow_road``). The simulator decides
how the ego reaches them.
"""

from __future__ import annotations

from typing import Any

from sumo_env.config import ConfigError
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.scene import Place
from sumo_env.tasks.base import nearest_index
from sumo_env.traffic.scenario import VehicleSpec

LONGITUDINAL_AND_LATERAL = {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT", 3: "FASTER", 4: "SLOWER"}
LONGITUDINAL = {0: "SLOWER", 1: "IDLE", 2: "FASTER"}
LATERAL = {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT"}


def action_names(action: dict[str, Any]) -> dict[int, str]:
    """Meta-actions by index for a config's ``action`` entry (``DiscreteMetaAction``).

    Raises:
        ConfigError: the actions are neither longitudinal nor lateral.
    """
    longitudinal, lateral = action.get("longitudinal", True), action.get("lateral", True)
    if longitudinal and lateral:
        return LONGITUDINAL_AND_LATERAL
    if longitudinal:
        return LONGITUDINAL
    if lateral:
        return LATERAL
    raise ConfigError("the action must be longitudinal, lateral or both")


def target_speed_index(action: str, index: int, speed: float, target_speeds: tuple[float, ...]) -> int:
    """Index of the target speed after a meta-action; `index` is the previous one, `speed` the measured speed [m/s]."""
    if action not in ("FASTER", "SLOWER"):
        return index
    # relative to the measured speed, not to the previous target
    wanted = nearest_index(speed, target_speeds) + (1 if action == "FASTER" else -1)
    return min(max(wanted, 0), len(target_speeds) - 1)


def target_lane(
    action: str, road: Road, lane: LaneIndex, route: tuple[str, ...], x: float, y: float
) -> LaneIndex:
    """Target lane after a meta-action of the ego at (x, y) [m]; `lane` is the previous one."""
    lane = follow_road(road, lane, route, x, y)
    if action in ("LANE_LEFT", "LANE_RIGHT"):
        start, end, place = lane
        last = road.count(start, end) - 1
        beside = (start, end, min(max(place + (1 if action == "LANE_RIGHT" else -1), 0), last))
        if road.lane(beside).is_reachable_from(x, y):
            return beside
    return lane


def lane_beside(action: str, place: Place, lane: LaneIndex) -> LaneIndex:
    """Target lane after a meta-action where SUMO says what may be done; `lane` is the previous one.

    A lane change that is not allowed leaves the target lane, and a target lane of another road has become the present
    lane.
    """
    start, end, number = place.lane
    if (action == "LANE_LEFT" and place.left) or (action == "LANE_RIGHT" and place.right):
        return start, end, number + (1 if action == "LANE_RIGHT" else -1)
    return lane if lane[:2] == (start, end) else place.lane


def follow_road(road: Road, lane: LaneIndex, route: tuple[str, ...], x: float, y: float) -> LaneIndex:
    """The lane to steer for at (x, y) [m]: `lane`, or at its end the next one of the route."""
    return road.next_lane(lane, route, x, y) if road.lane(lane).after_end(x, y) else lane


def ego_route(road: Road, ego: VehicleSpec) -> tuple[str, ...]:
    """Nodes of the ego's route, from the start of its first lane to its destination."""
    start, end, _ = ego.lane
    if ego.destination is None or ego.destination == end:
        return (start, end)
    return (start, *road.route(end, ego.destination))
