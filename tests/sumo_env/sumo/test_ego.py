"""The ego's speed in SUMO is that of highway-env's (`MDPVehicle`)."""

from __future__ import annotations

import pytest

from sumo_env.simulator import EgoCommand
from tests.sumo_env.scenarios import alone, draw


@pytest.mark.parametrize("frequency", [5, 10, 15, 20])
@pytest.mark.parametrize(("target", "after"), [(30.0, 29.15), (20.0, 20.85), (25.0, 25.0)])
def test_the_ego_drives_as_in_highway_env_at_any_simulation_frequency(simulator, frequency, target, after):
    scenario = alone(draw("highway", simulation_frequency=frequency))
    x = simulator.reset(scenario).x[0]
    step = simulator.step({"ego": EgoCommand(target, scenario.ego.lane)}, trace=True)
    assert len(step.trace) == frequency
    assert step.scene.x[0] - x == pytest.approx(step.ego.distance, abs=0.01)
    # explicit Euler at 15 Hz, summed by hand
    speed, covered = 25.0, 0.0
    for _ in range(15):
        covered += speed / 15
        speed += (target - speed) / 0.6 / 15
    assert speed == pytest.approx(after, abs=0.01)
    assert (step.scene.speed[0], step.ego.distance) == pytest.approx((speed, covered), abs=1e-9)
