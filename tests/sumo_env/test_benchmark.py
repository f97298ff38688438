"""The frozen test: its scenarios are those that were frozen, and its traffics those of the study."""

from contextlib import closing
from dataclasses import replace
from itertools import groupby
from typing import Any

import gymnasium as gym
import pytest

import sumo_env
from experiments.study.design.arms import TEST
from experiments.study.design.traffic import traffic_named
from sumo_env.benchmark import QUICK, SETTINGS, SIZE, TRAFFICS, BenchmarkScenario, digest, stored
from sumo_env.config import ConfigError
from sumo_env.traffic.scenario import Scenario
from tests.sumo_env.sumo.fake import FakeSimulator


def environment(of: BenchmarkScenario, simulator: Any = None) -> closing[gym.Env[Any, Any]]:
    return closing(gym.make(of.id, config=of.config, simulator=simulator))


def drawn(env: Any, one: BenchmarkScenario) -> Scenario:
    env.reset(seed=one.seed, options=one.options)
    return env.unwrapped.scenario


@pytest.mark.slow
def test_the_scenarios_are_those_that_were_frozen() -> None:
    """All settings and traffics; that the further ones are, too, every evaluation of all of them says.

    What is drawn does not depend on the simulator, which is SUMO for the last setting alone.
    """
    groups = 0
    for _, setting in groupby(sumo_env.benchmark_scenarios(quick=True), lambda one: (one.task, one.level)):
        scenarios = list(setting)
        last = scenarios[0].group.startswith("u-turn-12-")
        with environment(scenarios[0], None if last else FakeSimulator()) as env:
            for group, own in groupby(scenarios, lambda one: one.group):
                assert digest([drawn(env, one) for one in own]) == stored(group, quick=True), group
                groups += 1
    assert groups == sum(map(len, SETTINGS.values())) * len(TRAFFICS) == 40


def test_who_takes_the_test_has_met_no_scenario_of_it() -> None:
    """Training has seeds below `arms.TEST`, the study's tests seeds from there up to twice that."""
    scenarios = sumo_env.benchmark_scenarios()
    places = {(one.task, one.level, one.number): one.seed for one in scenarios}
    assert len(set(places.values())) == len(places) == len(scenarios) / len(TRAFFICS) == 10 * SIZE
    assert all(places[one.task, one.level, one.number] == one.seed for one in scenarios)  # in each traffic
    assert min(places.values()) >= 2 * TEST
    quick = sumo_env.benchmark_scenarios(["u-turn"], quick=True)
    assert quick == [one for one in scenarios if one.task == "u-turn" and one.number < QUICK]
    with pytest.raises(ConfigError, match="did you mean 'u-turn'"):
        sumo_env.benchmark_scenarios(["uturn"])


@pytest.mark.parametrize(
    ("traffic", "of_study"), [("no-events", "only-parameters"), ("measured", "measured")]
)
def test_its_traffics_are_those_of_the_study(traffic: str, of_study: str) -> None:
    of = {one.traffic: one for one in sumo_env.benchmark_scenarios(["u-turn"]) if one.number == 7}
    with environment(of[traffic]) as env:
        found, regular, risky = (drawn(env, of[name]) for name in (traffic, "regular", "risky"))
    assert found == traffic_named(of_study).scenario(regular, risky) != regular
    assert risky.events and not regular.events


def test_a_digest_tells_scenarios_apart_and_overlooks_rounding() -> None:
    [one] = [one for one in sumo_env.benchmark_scenarios(["two-way"]) if one.group.endswith("2-risky")][:1]
    with environment(one) as env:
        scenario = drawn(env, one)
    ego = scenario.ego
    moved, rounded = (replace(scenario, ego=ego._replace(s=ego.s + way)) for way in (1e-3, 1e-12))
    assert digest([rounded]) == digest([scenario]) != digest([moved])
    assert digest([replace(scenario, events=scenario.events[1:])]) != digest([scenario])
