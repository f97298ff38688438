"""Risk events on SUMO's vehicles: they happen, they end, and cut-ins and surges look before."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import libsumo
import numpy as np
import pytest

from experiments.backends.highway_env import HighwayScenario
from sumo_env.config import ConfigError, resolve
from sumo_env.contacts.rectangles import State
from sumo_env.replica.simulator import Replica
from sumo_env.simulator import EgoCommand
from sumo_env.sumo.events import Moment
from sumo_env.sumo.session import COMMANDED_LANE_CHANGES, OWN_LANE_CHANGES, REGULAR, Session
from sumo_env.sumo.world import SumoSimulator
from sumo_env.tasks.highway import Highway
from sumo_env.traffic.risk import FREE_WAY, EventKind, RiskEvent, free_way
from sumo_env.traffic.scenario import Scenario
from tests.sumo_env.situations import draw, placed, with_leader


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
    speed = 20.0 if happens else 25.0
    other = placed(scenario, 0, ("0", "1", 1), scenario.ego.x + ahead, speed, changes_lanes=False)
    event = RiskEvent(0.5, other.id, "cut-in", direction=-1)
    simulator.reset(replace(scenario, vehicles=(other,), events=(event,)))
    steps = [simulator.step({"ego": EgoCommand(25.0, scenario.ego.lane)}) for _ in range(2)]
    assert steps[0].ego.crash is None and (steps[1].ego.crash is not None) == happens
    assert bool(abs(steps[1].scene.y[1]) < 2.0) == happens


def test_a_cut_in_takes_the_other_lane_where_the_first_has_no_room(simulator: SumoSimulator) -> None:
    scenario = draw("highway", initial_lane_id=0)
    x = scenario.ego.x + 60.0
    pair = tuple(placed(scenario, k, ("0", "1", k + 1), x, 20.0, changes_lanes=False) for k in range(2))
    for direction, others in ((1, pair), (1, pair[:1]), (-1, pair)):
        event = RiskEvent(0.0, pair[0].id, "cut-in", direction=direction)
        simulator.reset(replace(scenario, vehicles=others, events=(event,)))
        scene = simulator.step({"ego": EgoCommand(25.0, scenario.ego.lane)}).scene
        wanted = 8.0 if direction == 1 and len(others) == 1 else 0.0
        assert scene.y[1] == pytest.approx(wanted, abs=0.3)


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
    ahead = placed(scenario, 0, driver.lane, driver.s + 15, 8.0)._replace(id="ahead")
    gained = []
    for vehicles, way in (((driver,), FREE_WAY), ((driver, ahead), FREE_WAY), ((driver, ahead), 10.0)):
        event = RiskEvent(0.0, driver.id, "surge", accel=4.0, duration=2.0, way=way)
        before = simulator.reset(replace(scenario, vehicles=vehicles, events=(event,))).speed[1]
        gained.append(simulator.step({"ego": EgoCommand(9.0, scenario.ego.lane)}).scene.speed[1] - before)
    assert gained[0] == pytest.approx(4.0, abs=0.5)
    assert gained[1] < 2.0 < gained[2]  # 15 m are enough for the last


@dataclass(frozen=True)
class Tailgating(EventKind):
    """Follow closely, but not while the leader is further ahead than `way`."""

    tau: float = 0.1
    given_back: ClassVar[list[str]] = []

    def pauses(self, at: Moment) -> bool:
        assert at.near(0.0).keys() < at.look().keys()  # the ego is far behind
        _, gap = at.sumo.getLeader(at.vehicle.name)
        return bool(gap > at.event.way)

    def command(self, at: Moment) -> None:
        at.vehicle.set_parameters(tau=self.tau, min_gap=0.5)

    def give_back(self, at: Moment) -> None:
        self.given_back.append(at.vehicle.name)
        at.vehicle.free_parameters()


def following() -> Scenario:
    """Two cars, one behind the other, and the ego far behind them."""
    scenario = draw("highway", initial_lane_id=0, duration=12)
    x, lane = scenario.ego.x + 300.0, ("0", "1", 2)
    first = placed(scenario, 0, lane, x, 20.0, target_speed=20.0, changes_lanes=False)
    second = placed(scenario, 1, lane, x - 45.0, 20.0, target_speed=21.0, changes_lanes=False)
    return replace(scenario, vehicles=(first, second))


@pytest.mark.parametrize(("way", "acts"), [(60.0, True), (10.0, False)])
def test_a_kind_of_a_user_s_own_commands_pauses_and_gives_back(simulator, way: float, acts: bool) -> None:
    scenario, gaps = following(), []
    Tailgating.given_back.clear()
    for events in ((), (RiskEvent(0.5, "v1", Tailgating(), duration=6.0, way=way),)):
        simulator.reset(replace(scenario, events=events))
        taus = [libsumo.vehicle.getTau("v1")]
        for _ in range(8):
            scene = simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)}).scene
            taus.append(libsumo.vehicle.getTau("v1"))
            if scene.time == 5.0:
                gaps.append(scene.x[1] - scene.x[2])
                assert scene.in_event == ({"v1"} if events and acts else set())
        assert taus[0] == taus[-1], "not given back: vehicle.py, set_parameters, free_parameters"
        assert (0.1 in taus) == (bool(events) and acts)
    assert (gaps[1] < gaps[0] - 5.0) == acts
    assert Tailgating.given_back == ["v1"] * acts


def test_a_kind_that_another_one_replaces_gives_back_at_once(simulator: SumoSimulator) -> None:
    scenario = following()
    tailgating = RiskEvent(0.0, "v1", Tailgating(), duration=9.0, way=200.0)
    brake = RiskEvent(1.5, "v1", "brake", accel=-2.0, duration=1.0)
    again = replace(tailgating, time=4.0, duration=1.0)
    Tailgating.given_back.clear()
    simulator.reset(replace(scenario, events=(tailgating, brake, again)))
    regular = libsumo.vehicle.getTau("v1")
    for wanted in (0.1, regular, regular):
        simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)})
        assert libsumo.vehicle.getTau("v1") == wanted
    assert Tailgating.given_back == ["v1"]
    assert libsumo.vehicle.getSpeedMode("v1") == REGULAR
    libsumo.vehicle.setTau("v1", 2.5)  # by a user, whose it is from then on
    for wanted in (2.5, 0.1, 2.5):
        simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)})
        assert libsumo.vehicle.getTau("v1") == wanted


@pytest.mark.parametrize("wrong", ["tailgate", "", Tailgating, None])
def test_an_unknown_kind_is_an_error(wrong: Any) -> None:
    with pytest.raises(ConfigError, match="unknown kind"):
        RiskEvent(1.0, "v0", wrong)


def test_the_other_simulators_say_that_they_have_no_kinds_of_a_user_s_own() -> None:
    class Own(Highway):
        def events(self, *_: Any) -> tuple[RiskEvent, ...]:
            return (RiskEvent(0.0, "v0", Tailgating(), duration=1.0),)

    scenario = Own().scenario(resolve("highway", Own.defaults, {"vehicles_count": 3}), 0)
    with pytest.raises(ConfigError, match="the replica has no"):
        Replica().reset(scenario)
    env = HighwayScenario({"vehicles_count": 3})
    env.reset(seed=0)
    env._events = list(scenario.events)
    with pytest.raises(ConfigError, match="highway-env has no"):
        env.step(1)


def test_nothing_happens_to_a_crashed_vehicle(simulator: SumoSimulator) -> None:
    """A surge after the crash does not move it."""
    scenario = with_leader(9.0, 5.0)(draw("highway", initial_lane_id=1))
    (ahead,) = scenario.vehicles
    surge = RiskEvent(2.0, ahead.id, "surge", accel=4.0, duration=2.0)
    events = surge, RiskEvent(2.5, ahead.id, "cut-in", direction=1)
    scenes = []
    for chosen in (events, ()):
        simulator.reset(replace(scenario, events=chosen))
        for _ in range(5):
            step = simulator.step({"ego": EgoCommand(25.0, scenario.ego.lane)})
        assert step.scene.crashed.all()
        scenes.append(step.scene)
    np.testing.assert_array_equal(scenes[0].x, scenes[1].x)
    np.testing.assert_array_equal(scenes[0].y, scenes[1].y)


def test_surging_vehicles_look_at_those_near_them_who_are_read_once(simulator, monkeypatch) -> None:
    """With four times the vehicles as many looks at each and as many reads, else the time of a step is quadratic.

    And the way is free where it is for all.
    """
    looked: list[int] = []
    reads: list[int] = []
    read = Session.read

    def counted(session: Session, names: Iterable[str]) -> dict[str, State]:
        reads.append(1)
        return read(session, names)

    def looks(vehicle: State, others: Iterable[State], way: float) -> bool:
        looked.append(len(states := list(others)))
        is_free = free_way(vehicle, states, way)
        assert is_free == free_way(vehicle, simulator._events._look().values(), way)
        return is_free

    monkeypatch.setattr(Session, "read", counted)
    monkeypatch.setattr("sumo_env.sumo.events.free_way", looks)
    found = []
    for count in (40, 160):
        scenario = draw("highway", vehicles_count=count)
        events = (RiskEvent(0.0, spec.id, "surge", accel=1.0, duration=9.0) for spec in scenario.vehicles)
        simulator.reset(replace(scenario, events=tuple(events)))
        looked.clear()
        reads.clear()
        simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)})
        found.append((np.mean(looked), len(reads)))
    assert found[1][0] < 1.5 * found[0][0] < 60.0 and found[1][1] == found[0][1]


@dataclass(frozen=True)
class Swerve(EventKind):
    """To a side for two seconds."""

    side: int = -1

    def command(self, at: Moment) -> None:
        if at.elapsed < 1.0 and at.has_room(self.side):
            at.change_lane(self.side, seconds=2.0)

    def give_back(self, at: Moment) -> None:
        pass


@dataclass(frozen=True)
class Holding(EventKind):
    """Steers by itself, from its first sub-step on."""

    def command(self, at: Moment) -> None:
        if at.elapsed == 0.0:
            at.vehicle.hold_lanes()

    def give_back(self, at: Moment) -> None:
        at.vehicle.free_lanes()


def test_a_cut_in_waits_until_an_event_that_steers_is_over(simulator: SumoSimulator) -> None:
    scenario = draw("highway", initial_lane_id=0, duration=12)
    car = placed(scenario, 0, ("0", "1", 1), scenario.ego.x + 200.0, 20.0)
    events = RiskEvent(0.0, "v0", Holding(), duration=1.5), RiskEvent(0.5, "v0", "cut-in", direction=1)
    simulator.reset(replace(scenario, vehicles=(car,), events=events))
    scenes = [simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)}).scene for _ in range(6)]
    across = [scene.y.item(scene.ids.index("v0")) for scene in scenes]
    assert across[0] == pytest.approx(4.0, abs=0.01) and across[-1] == pytest.approx(8.0, abs=0.1)


@pytest.mark.parametrize(("duration", "end"), [(0.5, 1.3), (2.0, 2.5)])
def test_lanes_are_sumo_s_again_once_neither_a_cut_in_nor_an_event_steers(
    simulator: SumoSimulator, duration: float, end: float
) -> None:
    """The event steers from 0.5 s on; the cut-in, from 0 s on, for 1.3 s."""
    scenario = draw("highway", initial_lane_id=0, duration=12, policy_frequency=10, simulation_frequency=10)
    car = placed(scenario, 0, ("0", "1", 1), scenario.ego.x + 200.0, 20.0)
    events = (
        RiskEvent(0.0, "v0", "cut-in", direction=1),
        RiskEvent(0.5, "v0", Holding(), duration=duration),
    )
    simulator.reset(replace(scenario, vehicles=(car,), events=events))
    held = []
    for _ in range(40):
        simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)})
        held.append(libsumo.vehicle.getLaneChangeMode("v0") == COMMANDED_LANE_CHANGES)
    assert held == [step < round(10 * end) for step in range(40)]


@pytest.mark.parametrize("side", [-1, 1])
def test_who_swerves_comes_back_where_sumo_s_own_lane_changes_would_refuse(simulator, side: int) -> None:
    """Six of six, with a follower 8 m behind in the lane that they leave; the lanes are SUMO's again at the end."""
    scenario = draw("highway", initial_lane_id=0, duration=12)
    x = scenario.ego.x + 200.0
    places = [x + 100.0 * (k // 2) - 13.0 * (k % 2) for k in range(12)]
    cars = [placed(scenario, k, ("0", "1", 1), place, 20.0) for k, place in enumerate(places)]
    events = tuple(RiskEvent(0.0, f"v{k}", Swerve(side=side), duration=1.0) for k in range(0, 12, 2))
    simulator.reset(replace(scenario, vehicles=tuple(cars), events=events))
    found = []
    for _ in range(4):
        scene = simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)}).scene
        rows = [scene.ids.index(event.vehicle) for event in events]
        found.append((scene.y[rows], scene.in_event))
    assert found[1][0] == pytest.approx(4.0 + 4.0 * side, abs=0.1)  # all six are out
    assert found[-1][0] == pytest.approx(4.0, abs=0.1) and not found[-1][1]
    assert {libsumo.vehicle.getLaneChangeMode(event.vehicle) for event in events} == {OWN_LANE_CHANGES}


def test_nobody_swerves_to_where_there_is_no_lane_or_no_room(simulator: SumoSimulator) -> None:
    scenario = draw("highway", initial_lane_id=0, duration=12, lanes_count=2)
    x = scenario.ego.x + 200.0
    pair = [placed(scenario, k, ("0", "1", k), x, 20.0, changes_lanes=False) for k in range(2)]
    for side in (-1, 1):
        events = tuple(RiskEvent(0.0, spec.id, Swerve(side=side), duration=2.0) for spec in pair)
        simulator.reset(replace(scenario, vehicles=tuple(pair), events=events))
        for _ in range(3):
            scene = simulator.step({"ego": EgoCommand(20.0, scenario.ego.lane)}).scene
            assert scene.y[1:] == pytest.approx([0.0, 4.0], abs=0.01)
