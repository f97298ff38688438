"""The ego's speed in SUMO against the measured response of highway-env's (`MDPVehicle`)."""

from __future__ import annotations

import pytest

from sumo_env.simulator import EgoCommand
from sumo_env.sumo.ego import TAU, approach, coast
from sumo_env.sumo.world import SumoSimulator
from tests.sumo_env.scenarios import alone, draw


@pytest.mark.parametrize("dt", [1 / 15, 0.1, 0.2])
@pytest.mark.parametrize(("target", "after"), [(30.0, 29.15), (20.0, 20.85), (25.0, 25.0)])
def test_speed_after_one_second_at_any_sub_step(dt: float, target: float, after: float) -> None:
    speed, covered = 25.0, 0.0
    for _ in range(round(1 / dt)):
        speed, distance = approach(speed, target, TAU, dt)
        covered += distance
    assert speed == pytest.approx(after, abs=0.01)
    # explicit Euler at 15 Hz, summed by hand
    v, expected = 25.0, 0.0
    for _ in range(15):
        expected += v / 15
        v += (target - v) / 0.6 / 15
    assert (speed, covered) == pytest.approx((v, expected), abs=1e-9)


def test_a_crashed_ego_coasts_to_a_stop() -> None:
    speed, places = 25.0, []
    for second in range(1, 4):
        covered = 0.0
        for _ in range(10):
            speed, distance = coast(speed, 0.1)
            covered += distance
        places.append(covered)
        assert speed == pytest.approx((8.9, 3.2, 1.1)[second - 1], abs=0.1)  # highway-env's
    assert places == sorted(places, reverse=True)


@pytest.mark.parametrize("frequency", [5, 10, 15, 20])
def test_the_ego_drives_as_commanded_at_any_simulation_frequency(simulator, frequency) -> None:
    scenario = alone(draw("highway", simulation_frequency=frequency))
    x = simulator.reset(scenario).x[0]
    step = simulator.step(EgoCommand(30.0, scenario.ego.lane), trace=True)
    assert len(step.trace) == frequency
    assert step.scene.speed[0] == pytest.approx(29.15, abs=0.01)
    assert step.scene.x[0] - x == pytest.approx(step.distance, abs=0.01)
    # 30 m/s but for what the lag of the first second costs
    assert step.distance == pytest.approx(30.0 - 0.6 * (29.15 - 25.0), abs=0.01)


def test_several_policy_steps_a_second(simulator: SumoSimulator) -> None:
    scenario = alone(draw("highway", policy_frequency=5))
    simulator.reset(scenario)
    step = simulator.step(EgoCommand(30.0, scenario.ego.lane))
    assert step.scene.time == pytest.approx(0.2)
