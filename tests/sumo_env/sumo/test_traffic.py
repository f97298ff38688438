"""SUMO drives the traffic: what it is told shows, nothing moves without it, and only few vehicles are commanded."""

from collections.abc import Callable
from dataclasses import replace

import libsumo
import numpy as np
import pytest

from sumo_env.env import DrivingEnv
from sumo_env.sumo.world import SumoSimulator
from sumo_env.tasks import get_task
from tests.sumo_env.situations import draw, drivers
from tests.tasks import every_task

Start = Callable[..., DrivingEnv]
IDLE = 1


# -- who drives --------------------------------------------------------------------------------------------


@every_task
def test_nothing_moves_unless_sumo_steps(start: Start, task: str, monkeypatch: pytest.MonkeyPatch) -> None:
    env = start(task, lambda scenario: replace(scenario, spawns=()), seed=2)
    env.step(IDLE)
    monkeypatch.setattr(libsumo, "simulationStep", lambda *_: None)
    before = env.scene
    env.step(IDLE)
    assert env.scene.ids == before.ids and len(before) > 1
    for field in ("x", "y", "heading"):
        np.testing.assert_array_equal(getattr(env.scene, field), getattr(before, field))
    np.testing.assert_array_equal(env.scene.speed[1:], before.speed[1:])


# -- what the drivers are ----------------------------------------------------------------------------------


JUNCTION = ("jmIgnoreFoeProb", "jmIgnoreJunctionFoeProb")


@pytest.mark.parametrize("fixed_delta", [False, True])
@every_task
def test_every_parameter_of_a_driver_arrives_in_sumo(simulator, task, fixed_delta) -> None:
    the_task = get_task(task)
    for seed in range(2):  # a dose that comes again brings all its drivers
        simulator.reset(draw(task, seed, risk=1.0))
    letter = "f" if fixed_delta else "d"
    chosen = [one for one in drivers(task, 1.0) if one.type[0] == letter and one.type.endswith("@1")]
    assert len(chosen) == 64
    sumo, setting = libsumo.vehicletype, the_task.calibration
    for driver in chosen:
        name = driver.type

        def lane_change(key: str, name: str = name) -> float:
            """The lane-change model answers for a vehicle only, in two digits."""
            return float(libsumo.vehicle.getParameter(name, f"laneChangeModel.{key}"))

        for there, here in (
            (sumo.getTau, setting.tau * driver.tau),
            (sumo.getAccel, driver.accel),
            (sumo.getDecel, driver.decel),
            (sumo.getApparentDecel, driver.decel),
            (sumo.getEmergencyDecel, max(driver.emergency_decel, driver.decel)),
            (sumo.getMinGap, driver.min_gap),
        ):
            assert there(name) == pytest.approx(here, abs=1e-6)
        assert (sumo.getLength(name), sumo.getWidth(name)) == (5.0, 2.0)
        assert (sumo.getSpeedFactor(name), sumo.getSpeedDeviation(name)) == (1.0, 0.0)
        ignored = [sumo.getParameter(name, f"junctionModel.{key}") for key in JUNCTION]
        shares = setting.ignores_approaching, setting.ignores_inside
        assert ignored == [str(int(not driver.gives_way or driver.attention < share)) for share in shares]
        libsumo.vehicle.add(name, libsumo.route.getIDList()[0], name)
        assert lane_change("lcAssertive") == pytest.approx(setting.assertive * driver.assertive, abs=0.006)
        assert lane_change("lcSpeedGain") == pytest.approx(setting.speed_gain * driver.speed_gain, abs=0.006)
        assert lane_change("lcSpeedGainLookahead") == pytest.approx(setting.speed_gain_lookahead, abs=0.006)
        assert (lane_change("lcCooperative"), lane_change("lcKeepRight")) == (0.0, 0.0)
        libsumo.vehicle.remove(name)


@pytest.mark.parametrize("name", ["mine", None])
def test_a_scenario_may_hold_drivers_of_its_own(simulator: SumoSimulator, name: str | None) -> None:
    """Also one of a name that another driver had in the episode before."""
    scenario = draw("highway")
    first, *rest = scenario.vehicles
    own = replace(first.driver, type=name or first.driver.type, tau=7.0)
    others = tuple(spec for spec in rest if spec.driver.type != own.type)
    simulator.reset(scenario)
    simulator.reset(replace(scenario, vehicles=(first._replace(driver=own), *others)))
    assert libsumo.vehicle.getTau(first.id) == 7.0
    simulator.reset(scenario)
    assert libsumo.vehicle.getTau(first.id) == first.driver.tau


@pytest.mark.parametrize("k", [0, 5, 20])
def test_on_a_free_road_a_driver_accelerates_as_idm_does(simulator: SumoSimulator, k: int) -> None:
    """The exponent of the driver counts, which SUMO cannot be asked for."""
    scenario = draw("highway", risk=1.0)
    driver = [d for d in drivers("highway", 1.0) if abs(d.delta - 4.0) > 0.2][k]
    lone = scenario.vehicles[0]._replace(driver=driver, speed=18.0, target_speed=24.0)
    simulator.reset(replace(scenario, vehicles=(lone,), events=()))
    libsumo.simulationStep()
    gained = libsumo.vehicle.getSpeed(lone.id) - 18.0
    expected = driver.accel * (1.0 - (18.0 / 24.0) ** driver.delta) * 0.1
    assert gained == pytest.approx(expected, rel=0.02)
