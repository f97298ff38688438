"""Unseen risk: the same cars in the same places, with one part of the risk alone or with drivers of another model."""

from typing import Any

import pandas as pd

from agents.rules import make_policy
from experiments.backends import make_env
from experiments.study.compute.evaluate import evaluate
from experiments.study.design.levels import env_config
from experiments.study.design.traffic import ALL, EIDM, KRAUSS, UNSEEN, unseen_traffics
from sumo_env.tasks import get_task
from sumo_env.traffic.scenario import Scenario
from tests.tasks import every_task

EVENTS = {"only-cut-in": "cut-in", "only-brake": "brake", "only-surge": "surge"}
MODELS = {"krauss": KRAUSS, "eidm": EIDM}
PARAMETERS = "only-parameters"


def drawn(task: str, seed: int) -> tuple[Scenario, Scenario]:
    config = env_config("sumo", task, 1)
    regular, risky = (get_task(task).scenario({**config, "risk": risk}, seed) for risk in (0.0, 1.0))
    return regular, risky


@every_task
def test_one_part_of_the_risk_alone(task: str) -> None:
    for seed in range(20):
        regular, risky = drawn(task, seed)
        parts: list[Any] = []
        for name, kind in EVENTS.items():
            scenario = ALL[name].scenario(regular, risky)
            assert (scenario.vehicles, scenario.spawns) == (regular.vehicles, regular.spawns)
            assert {event.kind for event in scenario.events} <= {kind}
            parts += scenario.events
        assert sorted(parts, key=repr) == sorted(risky.events, key=repr)
        alone = ALL[PARAMETERS].scenario(regular, risky)
        assert alone.events == () and alone.vehicles == risky.vehicles


def test_drivers_of_another_model_keep_their_places_parameters_and_events() -> None:
    regular, risky = drawn("intersection", 3)
    for name, attributes in MODELS.items():
        scenario = ALL[name].scenario(regular, risky)
        assert scenario.events == risky.events
        for spec, before in zip(scenario.vehicles, risky.vehicles, strict=True):
            assert spec._replace(driver=before.driver) == before
            assert spec.driver.tau == before.driver.tau
            assert dict(spec.driver.attributes)["carFollowModel"] == attributes["carFollowModel"]
        assert all(spawn.vehicle.driver.type.startswith(name) for spawn in scenario.spawns)


def test_episodes_depend_on_their_scenario_alone_and_differ_between_traffics() -> None:
    env = make_env("sumo", "roundabout", env_config("sumo", "roundabout", 1))
    traffics = (*unseen_traffics("roundabout"), "measured")
    assert set(traffics) == set(UNSEEN)
    tables = [
        evaluate(env, make_policy("idle", env), "roundabout", 1, range(3), order).set_index("traffic")
        for order in (traffics, traffics[::-1])
    ]
    for traffic in traffics:
        pd.testing.assert_frame_equal(*(table.loc[traffic] for table in tables))
    assert len({tables[0].loc[traffic].to_csv(index=False) for traffic in traffics}) == len(traffics)
    inner: Any = env.unwrapped
    assert inner.config["drivers"] == "highway-env"  # the measured ones leave nothing behind
    env.close()
