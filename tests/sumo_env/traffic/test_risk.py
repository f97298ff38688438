"""Risk events as values: how many a dose brings, when; and what a driver looks at before it does something."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

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
from tests.sumo_env import situations

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


def test_who_comes_later_may_have_events_from_then_on() -> None:
    scenario = situations.draw("intersection", policy_frequency=5)
    comes = dict(scenario.lifetimes)
    assert len(comes) == len(scenario.vehicles) + len(scenario.spawns) > len(scenario.vehicles)
    assert {spawn.vehicle.id: spawn.step / 5 for spawn in scenario.spawns}.items() <= comes.items()
    assert all(comes[spec.id] == 0.0 for spec in scenario.vehicles)


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
