"""Drivers: what a dose of risk changes and leaves alone, and the SUMO vehicle type that is a driver.

Risk events as values: how many a dose brings, when; and what a driver looks at before it does something.
"""

import copy
import math
import pickle
import warnings
from collections.abc import Callable
from dataclasses import FrozenInstanceError, asdict, replace
from functools import partial

import numpy as np
import pytest

from experiments.study.design.traffic import ALL
from sumo_env.config import resolve, warn_once
from sumo_env.scenarios.risky import deviation
from sumo_env.tasks import TASKS
from sumo_env.traffic.drivers import (
    MIN_GAIN,
    POOL,
    SAFE_BRAKING,
    SPREAD_PARAMETERS,
    Calibration,
    CarFollowing,
    DriverPool,
    RiskRanges,
    vehicle_type,
)
from sumo_env.traffic.risk import (
    CUT_IN_GAP,
    EventKind,
    RiskEvent,
    RiskRates,
    draw_events,
    draw_own_events,
    free_way,
    has_room,
)
from sumo_env.traffic.scenario import fits
from tests.sumo_env.situations import draw, drivers
from tests.tasks import every_task

BASE = CarFollowing()


def test_dose_zero_is_the_regular_driver() -> None:
    for driver in DriverPool(BASE, 0.0).drivers:
        assert asdict(BASE).items() <= asdict(driver).items() and driver.gives_way


def test_the_exponent_is_uniform_between_3_5_and_4_5_or_fixed() -> None:
    deltas = sorted(driver.delta for driver in DriverPool(BASE, 0.0).drivers)
    assert np.allclose(deltas, 3.5 + (np.arange(POOL) + 0.5) / POOL)
    assert {driver.delta for driver in DriverPool(BASE, 1.0, True).drivers} == {4.0}


@pytest.mark.parametrize("name", SPREAD_PARAMETERS)
def test_at_dose_one_parameters_fill_half_to_one_and_a_half_times_the_regular_value(name: str) -> None:
    regular = getattr(DriverPool(BASE, 0.0).drivers[0], name)
    values = [getattr(driver, name) / regular for driver in DriverPool(BASE, 1.0).drivers]
    assert (min(values), max(values)) == pytest.approx((0.5, 1.5), abs=0.01)
    assert np.mean(values) == pytest.approx(1.0)


@pytest.mark.parametrize(("dose", "low", "high"), [(0.0, 1.0, 1.0), (0.5, 0.7, 1.1), (1.0, 0.4, 1.2)])
def test_a_task_may_have_ranges_of_its_own(dose: float, low: float, high: float) -> None:
    ranges = RiskRanges(tau=(0.4, 1.2), not_giving_way=0.25)
    pool = DriverPool(BASE, dose, False, ranges).drivers
    of_files = [deviation(ranges, dose, 0, f"v{k}", "IDM") for k in range(2000)]
    for values in ([driver.tau / BASE.tau for driver in pool], [factors["tau"] for factors in of_files]):
        assert (min(values), max(values)) == pytest.approx((low, high), abs=0.01)
    assert sum(not driver.gives_way for driver in pool) == POOL * 0.25 * dose
    assert np.mean([factors["gives_way"] for factors in of_files]) == pytest.approx(1 - 0.25 * dose, abs=0.04)
    assert [d.accel for d in pool] == [d.accel for d in DriverPool(BASE, dose).drivers]


def test_a_driver_keeps_its_place_in_the_ranges_at_every_dose() -> None:
    """Common random numbers: driver k of any two doses differs only by the dose."""
    half, full = DriverPool(BASE, 0.5).drivers, DriverPool(BASE, 1.0).drivers
    for name in SPREAD_PARAMETERS:
        regular = getattr(DriverPool(BASE, 0.0).drivers[0], name)
        deviations = [[getattr(driver, name) - regular for driver in pool] for pool in (half, full)]
        assert np.allclose(2.0 * np.array(deviations[0]), deviations[1])
    assert [driver.attention for driver in half] == [driver.attention for driver in full]
    careless = [{k for k, driver in enumerate(pool) if not driver.gives_way} for pool in (half, full)]
    assert [len(group) for group in careless] == [POOL // 4, POOL // 2] and careless[0] <= careless[1]


# -- the vehicle type --------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_share_that_ignores_others_at_junctions_is_drawn_beforehand(share: float) -> None:
    """Probabilities are 0 or 1: SUMO would redraw fractional ones."""
    for dose, careless in ((0.0, 0), (1.0, POOL // 2)):
        pool = DriverPool(BASE, dose).drivers
        for setting, key in (
            (Calibration(ignores_approaching=share), "jmIgnoreFoeProb"),
            (Calibration(ignores_inside=share), "jmIgnoreJunctionFoeProb"),
        ):
            values = [vehicle_type(driver, setting)[key] for driver in pool]
            assert set(values) <= {"0", "1"}
            expected = careless + share * (POOL - careless)
            assert values.count("1") == pytest.approx(expected, abs=4)


@pytest.mark.parametrize("dose", [0.0, 0.3, 1.0])
@every_task
def test_a_task_names_every_driver_that_its_scenarios_may_hold(task: str, dose: float) -> None:
    known = drivers(task, dose)
    assert len({driver.type for driver in known}) == len(known)
    for seed in range(5):
        scenario = draw(task, seed, risk=dose)
        for spec in (*scenario.specs, *(spawn.vehicle for spawn in scenario.spawns)):
            assert spec.is_obstacle or spec.driver in known


SEEDS = range(40)


@every_task
def test_a_scenario_is_a_value_that_its_seed_decides(task: str) -> None:
    """It can be sent to another process, and nothing can change it, so that copies of episodes share it."""
    scenario = draw(task, 3, risk=1.0, policy_frequency=2, simulation_frequency=20)
    sent = pickle.loads(pickle.dumps(scenario))
    again = draw(task, 3, risk=1.0, policy_frequency=2, simulation_frequency=20)
    assert scenario == sent == again and hash(scenario) == hash(sent)
    assert scenario != draw(task, 4, risk=1.0, policy_frequency=2, simulation_frequency=20)
    assert copy.deepcopy(scenario) is scenario
    with pytest.raises(FrozenInstanceError):
        scenario.risk = 1.0  # type: ignore[misc]
    assert (scenario.task, scenario.policy_frequency, scenario.simulation_frequency) == (task, 2, 20)
    assert scenario.road == TASKS[task].road(resolve(task, TASKS[task].defaults))
    names = [spec.id for spec in scenario.specs] + [spawn.vehicle.id for spawn in scenario.spawns]
    assert names[0] == "ego" and len(set(names)) == len(names)


@pytest.mark.parametrize("frequency", [1, 5])
def test_events_of_vehicles_that_come_later_wait_for_them(frequency: int) -> None:
    scenario = draw("intersection", 1, risk=1.0, spawn_probability=1.0, policy_frequency=frequency)
    start = {spawn.vehicle.id: spawn.step / frequency for spawn in scenario.spawns}
    assert dict(scenario.lifetimes) == {spec.id: 0.0 for spec in scenario.vehicles} | start
    later = [event for event in scenario.events if event.vehicle in start]
    assert later and all(start[event.vehicle] <= event.time < 13.0 for event in later)


@pytest.mark.parametrize(("task", "level"), [(t, level) for t in TASKS for level in TASKS[t].levels])
def test_no_vehicles_overlap_and_all_are_on_their_lane(task: str, level: str) -> None:
    for seed in range(10):
        scenario = draw(task, seed, **TASKS[task].levels[level])
        road = TASKS[task].road(resolve(task, TASKS[task].defaults, TASKS[task].levels[level]))
        # the ego comes after the warm-up
        together = scenario.vehicles if scenario.warm_up else scenario.specs
        places = [(v.x, v.y) for v in together]
        if task != "two-way":  # there two lanes share a strip
            for i, (x, y) in enumerate(places):
                assert all(math.hypot(x - a, y - b) > 2.0 for a, b in places[:i])
        for v in scenario.specs:
            assert road.lane(v.lane).on_lane(v.x, v.y)


def test_highway_spacing_follows_the_density() -> None:
    for density, spacing in ((1.0, 21.0), (2.0, 10.5)):  # metres between consecutive vehicles
        gaps = [np.diff([v.s for v in draw("highway", s, vehicles_density=density).vehicles]) for s in SEEDS]
        assert np.mean(gaps) == pytest.approx(spacing, rel=0.02) and np.min(gaps) > 0.0


def test_intersection_traffic_starts_on_its_approach_and_has_three_seconds_to_drive() -> None:
    """IntersectionEnv._make_vehicles: tries at 0 to 80 m, refused within 15 m, then the challenger."""
    counts, speeds = [], []
    for seed in SEEDS:
        scenario = draw("intersection", seed)
        assert scenario.warm_up == 3.0
        assert scenario.ego.speed == 10.0 and scenario.ego.target_speed == 9.0
        counts.append(len(scenario.vehicles))
        speeds += [v.speed for v in scenario.vehicles]
        for k, v in enumerate(scenario.vehicles):
            assert v.lane[0].startswith("o") and v.lane[1].startswith("ir") and v.destination != v.lane[0]
            assert fits(v, [(w.x, w.y) for w in scenario.vehicles[:k]])
        (challenger,) = (spawn.vehicle for spawn in scenario.spawns if spawn.step == 0)
        assert challenger.id == "challenger" and challenger.speed == 8.0
        assert challenger.destination == f"o{(int(challenger.lane[0][1:]) + 2) % 4}"  # straight on
        assert challenger.s == pytest.approx(65.0, abs=0.5)
    assert 4.0 < np.mean(counts) < 6.5
    assert np.mean(speeds) == pytest.approx(8.0, abs=0.3)


def test_intersection_tries_to_spawn_after_every_step() -> None:
    steps = [s.step for k in SEEDS for s in draw("intersection", k, spawn_probability=1.0).spawns if s.step]
    assert sorted(set(steps)) == list(range(1, 14)) and len(steps) == 13 * len(SEEDS)
    share = np.mean([(len(draw("intersection", k).spawns) - 1) / 13 for k in SEEDS])
    assert share == pytest.approx(0.6, abs=0.1)


def test_the_counterparts_in_highway_env_are_mobil_s_two_thresholds() -> None:
    regular = DriverPool(BASE, 0.0).drivers[0]
    assert (regular.safe_braking, regular.min_gain) == (SAFE_BRAKING, MIN_GAIN)
    eager = replace(regular, assertive=2.0, speed_gain=2.0)
    assert (eager.safe_braking, eager.min_gain) == (2 * SAFE_BRAKING, MIN_GAIN / 2)


@pytest.mark.parametrize(
    ("given", "foreign"),
    [
        ({"carFollowModel": "EIDM", "cc1": 1.2, "tpreview": 4}, "'EIDM' of 'odd' has no cc1:"),
        (
            {"carFollowModel": "Krauss", "sigma": 0.1, "delta": 4, "cc2": 1},
            "'Krauss' of 'odd' has no cc2, delta:",
        ),
        ({"sigma": 0.5}, "'IDM' of 'odd' has no sigma:"),
        ({"carFollowModel": "W99", "cc1": 1.2, "accel": 2.0, "lcStrategic": 0.5}, ""),
        ({"carFollowModel": "Rail", "cc1": 1.2, "vClass": "rail"}, ""),
        *((dict(traffic.drivers), "") for traffic in ALL.values() if isinstance(traffic.drivers, dict)),
    ],
)
def test_attributes_of_another_model_are_told(given: dict[str, object], foreign: str) -> None:
    warn_once.cache_clear()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        drivers("highway", 0.0)[0].like("odd", given)
    assert [foreign in str(one.message) for one in caught] == ([True] if foreign else [])


# -- risk events -----------------------------------------------------------------------------------------------------

RATES = RiskRates(cut_in=0.1, brake=0.1, surge=0.1)
VEHICLES = tuple((f"v{k}", 0.0) for k in range(200))
OWN = EventKind(rate=0.1, duration=2.0), EventKind(rate=0.2, duration=1.0)
Draw = Callable[..., tuple[RiskEvent, ...]]
both_laws = pytest.mark.parametrize(
    "draw", [partial(draw_events, RATES), partial(draw_own_events, OWN)], ids=["given", "own"]
)


@both_laws
def test_events_come_at_the_rate_of_the_dose_and_a_smaller_dose_has_a_subset(draw: Draw) -> None:
    full = draw(1.0, VEHICLES, 0, 20.0)
    half = draw(0.5, VEHICLES, 0, 20.0)
    expected = 200 * 20.0 * 0.3  # Poisson, so its standard deviation is the root
    assert abs(len(full) - expected) < 5 * np.sqrt(expected)
    assert abs(len(half) - expected / 2) < 5 * np.sqrt(expected / 2)
    assert set(half) < set(full)
    assert not draw(0.0, VEHICLES, 0, 20.0)


@both_laws
def test_events_are_sorted_and_lie_within_the_episode_and_the_vehicle_s_life(draw: Draw) -> None:
    events = draw(1.0, (("early", 0.0), ("late", 15.0)), 3, 200.0)
    assert [event.time for event in events] == sorted(event.time for event in events)
    assert all(0.0 <= event.time < 200.0 for event in events)
    assert all(event.time >= 15.0 for event in events if event.vehicle == "late")


def test_events_carry_what_the_rates_say() -> None:
    brakes, surges = {"brake_decel": 4.0, "brake_duration": 1.5}, {"surge_accel": 3.0, "surge_duration": 2.5}
    rates = replace(RATES, **brakes, **surges, surge_way=20.0)
    events = draw_events(rates, 1.0, VEHICLES, 0, 20.0)
    assert {(e.accel, e.duration) for e in events if e.kind == "brake"} == {(-4.0, 1.5)}
    assert {(e.accel, e.duration, e.way) for e in events if e.kind == "surge"} == {(3.0, 2.5, 20.0)}
    directions = [e.direction for e in events if e.kind == "cut-in"]
    assert set(directions) == {-1, 1} and abs(sum(directions)) < 5 * math.sqrt(len(directions))


def test_there_is_room_where_nobody_is_within_the_gap() -> None:
    there = (100.0, 4.0, 20.0, 0.0)
    assert has_room(there, [])
    for x, room in ((100.0 + 5.0 + CUT_IN_GAP + 0.01, True), (100.0 + 5.0 + CUT_IN_GAP - 0.01, False)):
        assert has_room(there, [(x, 4.0, 20.0, 0.0)]) == room
    assert has_room(there, [(100.0, 8.0, 20.0, 0.0)])  # beside, two metres between the outlines
    assert not has_room(there, [(150.0, 4.0, 20.0, 0.0), (102.0, 4.0, 20.0, 0.0)])
    tram = 20.0, 1.25  # half its length and width [m]
    for x, room in ((77.0, False), (76.0, True), (123.0, False), (124.0, True)):
        assert has_room(there, [(x, 4.0, 20.0, 0.0)], [(2.5, 0.9), tram]) == room
    for gap, room in ((0.9, False), (1.1, True)):  # to its side, where it stands across
        assert has_room(there, [(103.75 + gap, 4.0, 0.0, math.pi / 2)], [(2.5, 0.9), tram]) == room


@pytest.mark.parametrize("heading", [0.0, 1.0, math.pi, -2.0])
def test_the_way_is_free_unless_a_centre_is_straight_ahead(heading: float) -> None:
    vehicle = (10.0, -20.0, 8.0, heading)

    def other(ahead: float, aside: float) -> tuple[float, float, float, float]:
        c, s = math.cos(heading), math.sin(heading)
        return (10.0 + ahead * c - aside * s, -20.0 + ahead * s + aside * c, 0.0, 0.0)

    assert free_way(vehicle, [], 40.0)
    assert not free_way(vehicle, [other(39.9, 0.0)], 40.0)
    assert free_way(vehicle, [other(40.1, 0.0)], 40.0)
    assert free_way(vehicle, [other(-5.0, 0.0)], 40.0)
    assert not any(free_way(vehicle, [other(20.0, aside)], 40.0) for aside in (1.9, -1.9))
    assert free_way(vehicle, [other(20.0, 2.1), other(20.0, -2.1)], 40.0)
