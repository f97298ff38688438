"""Risk events on SUMO's vehicles: they happen, they end, and cut-ins and surges look before."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import libsumo
import numpy as np
import pytest

from sumo_env.contacts.rectangles import State
from sumo_env.simulator import EgoCommand
from sumo_env.sumo.session import COMMANDED_LANE_CHANGES, OWN_LANE_CHANGES, REGULAR, Session
from sumo_env.sumo.world import SumoSimulator
from sumo_env.traffic.risk import FREE_WAY, RiskEvent
from tests.sumo_env.scenarios import draw, with_leader


@pytest.mark.parametrize("task", ["highway", "two-way"])
def test_a_brake_event_brakes_and_ends(simulator: SumoSimulator, task: str) -> None:
    """While it acts, scenes name its vehicle."""
    scenario = draw(task, duration=8)
    other = scenario.vehicles[0]
    event = RiskEvent(1.0, other.id, "brake", accel=-5.0, duration=1.0)
    simulator.reset(replace(scenario, vehicles=(other,), events=(event,), spawns=()))
    speeds, acting = [], []
    for _ in range(3):
        step = simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)}, trace=True)
        speeds.append(step.scene.speed[1])
        acting += [scene.in_event for scene in step.trace]
    assert speeds[0] - speeds[1] == pytest.approx(5.0, abs=0.6)
    assert speeds[2] > speeds[1]
    assert libsumo.vehicle.getSpeedMode(other.id) == REGULAR
    assert [k for k, names in enumerate(acting) if names] == list(range(10, 20))  # from 1.0 to 2.0 s
    assert set(acting) == {frozenset(), frozenset({other.id})}


@pytest.mark.parametrize(("ahead", "happens"), [(14.0, True), (1.0, False)])
def test_a_cut_in_takes_any_gap_but_needs_one(simulator: SumoSimulator, ahead: float, happens: bool) -> None:
    # a driver with nobody to the other side would change there: two lanes only
    scenario = draw("highway", initial_lane_id=0, lanes_count=2)
    x, speed = scenario.ego.x + ahead, 20.0 if happens else 25.0
    place: dict[str, Any] = {
        "lane": ("0", "1", 1),
        "s": x,
        "x": x,
        "y": 4.0,
        "speed": speed,
        "target_speed": speed,
    }
    other = scenario.vehicles[0]._replace(**place, changes_lanes=False)
    event = RiskEvent(0.5, other.id, "cut-in", direction=-1)
    simulator.reset(replace(scenario, vehicles=(other,), events=(event,)))
    steps = [simulator.step({"ego": EgoCommand(25.0, scenario.ego.lane)}) for _ in range(2)]
    assert steps[0].ego.crash is None and (steps[1].ego.crash is not None) == happens
    assert bool(abs(steps[1].scene.y[1]) < 2.0) == happens


def test_a_cut_in_takes_the_other_lane_where_the_first_has_no_room(simulator: SumoSimulator) -> None:
    scenario = draw("highway", initial_lane_id=0)
    first, second = scenario.vehicles[:2]
    x = scenario.ego.x + 60.0
    calm: dict[str, Any] = {"s": x, "x": x, "speed": 20.0, "target_speed": 20.0, "changes_lanes": False}
    pair = (
        first._replace(lane=("0", "1", 1), y=4.0, **calm),
        second._replace(lane=("0", "1", 2), y=8.0, **calm),
    )
    for direction, others in ((1, pair), (1, pair[:1]), (-1, pair)):
        event = RiskEvent(0.0, first.id, "cut-in", direction=direction)
        simulator.reset(replace(scenario, vehicles=others, events=(event,)))
        scene = simulator.step({"ego": EgoCommand(25.0, scenario.ego.lane)}).scene
        wanted = 8.0 if direction == 1 and len(others) == 1 else 0.0
        assert scene.y[1] == pytest.approx(wanted, abs=0.3)


def test_after_a_cut_in_lane_changes_are_sumo_s_again(simulator: SumoSimulator) -> None:
    scenario = draw("highway", 1)
    name = scenario.vehicles[5].id
    event = RiskEvent(0.0, name, "cut-in", direction=-1)
    simulator.reset(replace(scenario, events=(event,)))
    modes = []
    for _ in range(3):
        simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)})
        modes.append(libsumo.vehicle.getLaneChangeMode(name))
    assert modes == [COMMANDED_LANE_CHANGES, OWN_LANE_CHANGES, OWN_LANE_CHANGES]


def test_a_swerve_into_the_oncoming_lane_ends_in_the_own_lane(simulator: SumoSimulator) -> None:
    scenario = draw("two-way", road_length=1400.0)
    other = scenario.vehicles[0]
    event = RiskEvent(0.0, other.id, "cut-in", direction=-1)
    simulator.reset(replace(scenario, vehicles=(other,), events=(event,)))
    y = [simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)}).scene.y[1] for _ in range(6)]
    assert y[1] == pytest.approx(0.0, abs=0.1)
    assert y[-1] == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize("task", ["two-way", "intersection", "u-turn"])
def test_a_surge_accelerates_where_the_way_is_free(simulator: SumoSimulator, task: str) -> None:
    scenario = replace(draw(task), spawns=(), warm_up=0.0)
    driver = scenario.vehicles[0]._replace(speed=8.0, target_speed=8.0)
    dx, dy = 15 * np.cos(driver.heading), 15 * np.sin(driver.heading)
    ahead = driver._replace(id="ahead", s=driver.s + 15, x=driver.x + dx, y=driver.y + dy)
    gained = []
    for vehicles, way in (((driver,), FREE_WAY), ((driver, ahead), FREE_WAY), ((driver, ahead), 10.0)):
        event = RiskEvent(0.0, driver.id, "surge", accel=4.0, duration=2.0, way=way)
        before = simulator.reset(replace(scenario, vehicles=vehicles, events=(event,))).speed[1]
        gained.append(simulator.step({"ego": EgoCommand(9.0, scenario.ego.lane)}).scene.speed[1] - before)
    assert gained[0] == pytest.approx(4.0, abs=0.5)
    assert gained[1] < 2.0 < gained[2]  # 15 m are enough for the last


def test_nothing_happens_to_a_crashed_vehicle(simulator: SumoSimulator) -> None:
    """A surge after the crash does not move it."""
    scenario = with_leader(9.0, 5.0)(draw("highway", initial_lane_id=1))
    (ahead,) = scenario.vehicles
    events = (
        RiskEvent(2.0, ahead.id, "surge", accel=4.0, duration=2.0),
        RiskEvent(2.5, ahead.id, "cut-in", direction=1),
    )
    scenes = []
    for chosen in (events, ()):
        simulator.reset(replace(scenario, events=chosen))
        for _ in range(5):
            step = simulator.step({"ego": EgoCommand(25.0, scenario.ego.lane)})
        assert step.scene.crashed.all()
        scenes.append(step.scene)
    np.testing.assert_array_equal(scenes[0].x, scenes[1].x)
    np.testing.assert_array_equal(scenes[0].y, scenes[1].y)


def test_all_surging_vehicles_look_at_the_others_once_in_a_sub_step(
    simulator: SumoSimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the time of a step is quadratic in the number of vehicles."""
    scenario, reads, read = draw("highway", vehicles_count=40), 0, Session.read

    def counted(session: Session, names: Iterable[str]) -> dict[str, State]:
        nonlocal reads
        reads += 1
        return read(session, names)

    found = []
    for surging in (0, 1, 30):
        events = tuple(
            RiskEvent(0.0, spec.id, "surge", accel=1.0, duration=9.0) for spec in scenario.vehicles[:surging]
        )
        simulator.reset(replace(scenario, events=events))
        with monkeypatch.context() as patched:
            patched.setattr(Session, "read", counted)
            reads = 0
            simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)})
            found.append(reads)
    assert found[1] == found[0] + 10 and found[2] == found[1]
