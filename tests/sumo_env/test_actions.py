"""Meta-actions as target speeds and target lanes, against highway-env's `MDPVehicle`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.controller import MDPVehicle

from sumo_env.actions import (
    NAMES,
    DiscreteMetaAction,
    ego_route,
    follow_road,
    target_lane,
    target_speed_index,
)
from sumo_env.networks.roads import highway, intersection, u_turn
from tests.sumo_env.scenarios import draw

SPEEDS = (20.0, 25.0, 30.0)


def test_target_speeds_and_lanes_equal_highway_env_s() -> None:
    """Any sequence of actions, wherever on the road the vehicle is and however fast."""
    road = highway(4)
    theirs: Any = MDPVehicle(Road(RoadNetwork.straight_road_network(4)), [200.0, 4.0], speed=25.0)
    rng = np.random.default_rng(0)
    index, lane = theirs.speed_index, ("0", "1", 1)
    changed = 0
    for _ in range(500):
        name = str(rng.choice(["LANE_LEFT", "LANE_RIGHT", "FASTER", "SLOWER", "IDLE"]))
        theirs.speed = float(rng.uniform(15.0, 35.0))
        theirs.position = np.array([rng.uniform(100.0, 900.0), rng.uniform(-1.0, 13.0)])
        x, y = theirs.position.tolist()
        theirs.act(name)
        index = target_speed_index(name, index, theirs.speed, SPEEDS)
        before, lane = lane, target_lane(name, road, lane, ("0", "1"), x, y)
        changed += lane != before
        assert (index, lane) == (theirs.speed_index, theirs.target_lane_index), name
    assert changed > 50


@pytest.mark.parametrize("names", NAMES.values())
def test_actions_are_known_by_caution(names: dict[int, str]) -> None:
    ordered = [names[action] for action in DiscreteMetaAction(names, SPEEDS).by_caution]
    assert ordered == [
        name for name in ("SLOWER", "IDLE", "LANE_RIGHT", "FASTER", "LANE_LEFT") if name in names.values()
    ]


def test_the_target_lane_follows_the_road() -> None:
    road, route = u_turn(), ("a", "b", "c", "d")
    assert follow_road(road, ("a", "b", 1), route, 100.0, 48.0) == ("a", "b", 1)
    assert follow_road(road, ("a", "b", 1), route, 127.0, 48.0) == ("b", "c", 1)
    # an action first goes on to the next road, then aside
    assert target_lane("LANE_LEFT", road, ("a", "b", 1), route, 129.0, 48.0) == ("b", "c", 0)


def test_at_a_crossing_the_target_lane_follows_the_route() -> None:
    road = intersection()
    ego = draw("intersection", destination="o3").ego
    end = road.lane(ego.lane)
    x, y = end.position(end.length, 0.0)
    assert follow_road(road, ego.lane, ego_route(road, ego), x, y) == ("ir0", "il3", 0)
