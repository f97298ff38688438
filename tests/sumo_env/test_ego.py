"""The ego against the measured response of highway-env's (`MDPVehicle`)."""

from __future__ import annotations

import pytest

from sumo_env.config import ConfigError
from sumo_env.ego import Ego, action_names
from sumo_env.networks.roads import highway, u_turn

LADDER = (20.0, 25.0, 30.0)


def ego(speed: float = 25.0, lane: int = 1) -> Ego:
    return Ego(highway(4), ("0", "1", lane), speed, LADDER, ())


@pytest.mark.parametrize("dt", [1 / 15, 0.1, 0.2])
@pytest.mark.parametrize(("start", "action", "after"), [(25.0, "FASTER", 29.15), (25.0, "SLOWER", 20.85)])
def test_speed_after_one_second_at_any_step(dt: float, start: float, action: str, after: float) -> None:
    driver = ego(start)
    driver.command(action, 0.0, 4.0)
    distance = sum(driver.advance(dt) for _ in range(round(1 / dt)))
    assert driver.speed == pytest.approx(after, abs=0.01)
    # explicit Euler at 15 Hz, summed by hand
    v, expected = start, 0.0
    for _ in range(15):
        expected += v / 15
        v += (driver.target_speed - v) / 0.6 / 15
    assert distance == pytest.approx(expected, abs=1e-9)


def test_a_rung_is_relative_to_the_measured_speed() -> None:
    driver = Ego(highway(4), ("0", "1", 0), 10.0, (0.0, 4.5, 9.0), ())
    driver.command("SLOWER", 0.0, 0.0)
    assert driver.target_speed == 4.5


def test_lanes_are_relative_to_the_target_lane_and_clipped() -> None:
    driver = ego(lane=1)
    for expected in (0, 0):
        driver.command("LANE_LEFT", 100.0, 4.0)
        assert driver.target_lane[2] == expected
    driver.command("LANE_RIGHT", 100.0, 4.0)
    driver.command("LANE_RIGHT", 100.0, 4.0)
    assert driver.target_lane[2] == 2
    # two lanes away is as far as a driver may aim
    driver.command("LANE_RIGHT", 100.0, 4.0)
    assert driver.target_lane[2] == 3
    driver = ego(lane=0)
    driver.target_lane = ("0", "1", 2)
    driver.command("LANE_RIGHT", 100.0, 0.0)
    assert driver.target_lane[2] == 2


def test_the_target_lane_follows_the_road() -> None:
    driver = Ego(u_turn(), ("a", "b", 1), 16.0, (8.0, 16.0, 24.0), ("a", "b", "c", "d"))
    driver.follow_road(127.0, 48.0)
    assert driver.target_lane == ("b", "c", 1)


def test_a_wreck_coasts_to_a_stop() -> None:
    driver = ego()
    driver.crashed = True
    for _ in range(30):
        driver.advance(0.1)
    assert driver.speed == pytest.approx(1.1, abs=0.1)  # highway-env: 25 -> 8.9, 3.2, 1.1 m/s after 1, 2, 3 s


def test_action_sets() -> None:
    assert action_names({"longitudinal": True, "lateral": False}) == {0: "SLOWER", 1: "IDLE", 2: "FASTER"}
    assert action_names({})[0] == "LANE_LEFT"
    with pytest.raises(ConfigError):
        action_names({"longitudinal": False, "lateral": False})
