"""Events near learning cars that come more often: their number, their likelihood ratio, and what stays as it was."""

import copy
import itertools
import math
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from sumo_env.env import DrivingEnv
from sumo_env.env.cars import make
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scene import Scene
from sumo_env.sumo.events import DELAY
from sumo_env.sumo.tilted import Tilted
from sumo_env.traffic.risk import RiskEvent, RiskRates, draw_events
from sumo_env.traffic.tilt import Tilt
from tests.sumo_env.plans import build, needs_sumo, route_file
from tests.sumo_env.rollout import assert_same_bits, drive
from tests.tasks import every_task

TILT = {"event_factor": 20.0, "event_reach": 40.0}
KEYS = ("events", "expected_events", "other_events", "log_weight")


def scenes(env: Any, actions: Any = 1) -> Iterator[tuple[Any, Any]]:
    """The scene before and after each step of an episode that has begun."""
    before = env.scene
    for _ in drive(env, actions):
        yield before, env.scene
        before = env.scene


def near(scene: Any, reach: float) -> set[str]:
    """Vehicles within reach of a learning car, by plain arithmetic; no obstacles, and not the bicycles "b.0", ..."""
    places = dict(zip(scene.ids, zip(scene.x.tolist(), scene.y.tolist(), strict=True), strict=True))
    cars, others = scene.ids[: scene.cars], scene.ids[scene.cars :]
    others = [name for name in others if not name.startswith(("obstacle", "b."))]
    return {name for name in others for car in cars if math.dist(places[name], places[car]) <= reach}


def recomputed(env: Any, driven: list[tuple[Any, Any]], events: list[RiskEvent], rate: float) -> list[float]:
    """`KEYS` of an episode from its scenes and its events; `rate`: of a vehicle's events at factor 1 [1/s]."""
    tilt, expected, came, others = env.scenario.tilt, 0.0, 0, 0
    for before, after in driven:
        names = near(before, tilt.reach)
        expected += rate * len(names) * (min(after.time, tilt.duration) - min(before.time, tilt.duration))
        due = [event for event in events if before.time < event.time <= after.time]
        came += sum(event.vehicle in names for event in due)
        others += sum(event.vehicle not in names and not event.is_further for event in due)
    return [came, expected, others, math.log(math.exp((tilt.factor - 1) * expected) / tilt.factor**came)]


@every_task
def test_the_weight_is_that_of_the_stored_events(task: str) -> None:
    """In every task with any factor and reach, however an episode ends; further events begin near the ego alone."""
    rng = np.random.default_rng(len(task))
    with closing(DrivingEnv(task, {"risk": 0.1, "duration": 9.5})) as env:  # the last step is beyond
        rates = env.task.risk_rates
        for seed in range(4):
            factor, reach = math.exp(rng.uniform(0.0, 4.0)), rng.uniform(10.0, 80.0)
            info = env.reset(seed=seed, options={"event_factor": factor, "event_reach": reach})[1]
            assert [info[key] for key in KEYS] == [0, 0.0, 0, 0.0]
            driven = list(scenes(env, seed % 3))
            found = [env.scene.near_events._asdict()[key] for key in KEYS]
            rate = 0.1 * (rates.cut_in + rates.brake + rates.surge)
            assert found == pytest.approx(recomputed(env, driven, list(env.scenario.events), rate), abs=1e-9)
            further = [event for event in env.scenario.events if event.is_further]
            base = {event.vehicle for event in env.scenario.events if not event.is_further}
            last, who_was_near = 1.0 / env.scenario.simulation_frequency + 1e-6, dict[float, set[str]]()
            for before, after in driven:
                begun = after.in_event - before.in_event - base
                here = who_was_near[before.time] = near(before, reach + 1e-6)
                # what is due in a step's last sub-step begins after it, and cut-ins wait until they can
                late = {
                    event.vehicle
                    for event in further
                    if 0.0 <= before.time - event.time < last + DELAY * (event.kind == "cut-in")
                    and event.vehicle in who_was_near[max(at for at in who_was_near if at < event.time)]
                }
                assert begun <= here | late


def test_an_event_between_two_scenes_comes_by_who_was_near_in_the_first_one() -> None:
    """Also where the simulator begins it after the second one, in which another vehicle is near."""
    tilted = Tilted(Tilt(2.0, 10.0, RiskRates(brake=0.1), 1.0, 20.0))
    pairs = itertools.product("ab", (0.95, 1.5))
    events = {(name, time): RiskEvent(time, name, "brake", is_further=True) for name, time in pairs}
    tilted.plan("ab", events.values())
    for time, places in enumerate(([0.0, 5.0, 50.0], [0.0, 50.0, 5.0])):
        zeros = np.zeros(3)
        tilted.count(Scene(("ego", "a", "b"), np.array(places), zeros, zeros, zeros, zeros > 0, float(time)))
    came = {which for which, event in events.items() if tilted.comes(event)}
    assert came == {("a", 0.95), ("b", 1.5)}


@every_task
def test_at_factor_one_an_episode_is_that_without_the_option(task: str) -> None:
    with closing(DrivingEnv(task, {"risk": 1.0})) as env:
        env.reset(seed=3)
        plain = [result[:4] for result in drive(env)]
        env.reset(seed=3, options={"event_factor": 1, "event_reach": math.inf})
        tilted = list(drive(env))
    assert all(result[4]["log_weight"] == 0.0 for result in tilted) and tilted[-1][4]["expected_events"] > 0
    for one, other in zip(plain, tilted, strict=True):
        assert_same_bits(one, other[:4])


def test_events_come_so_much_more_often_and_weights_have_the_mean_one() -> None:
    with closing(DrivingEnv("u-turn", {"vehicles_count": 3, "risk": 0.05})) as env:
        infos, factor = [], 5.0
        for seed in range(250):
            env.reset(seed=seed, options={"event_factor": factor, "event_reach": 30.0})
            infos.append(list(drive(env, 2))[-1][4])
    came, mean = (np.array([info[key] for info in infos]) for key in KEYS[:2])
    weights = np.exp([info["log_weight"] for info in infos])
    assert abs(came.sum() - factor * mean.sum()) < 4 * math.sqrt(factor * mean.sum()) and came.sum() > 50
    assert abs(weights.mean() - 1.0) < 4 * weights.std() / math.sqrt(len(weights))


def test_copies_replays_and_workers_go_on_alike_and_imagined_events_are_no_more_often() -> None:
    config = {"vehicles_count": 6, "risk": 0.3}
    with closing(DrivingEnv("u-turn", config)) as env, closing(DrivingEnv("u-turn", config)) as worker:
        for each in (env, worker):
            each.reset(seed=4, options=TILT)
            each.step(1)
        twin, imagined = copy.deepcopy(env), env.imagine(0)
        first = list(drive(env, 0))
        assert first[-1][4]["events"] > 0
        for other in (twin, worker):
            for one, two in zip(first, drive(other, 0), strict=True):
                assert_same_bits(one, two)
        assert imagined.scenario.tilt is None and "log_weight" not in imagined.step(1)[4]
        twin.close()
        imagined.close()
        worker.reset(seed=9, options={"scenario": env.scenario})
        worker.step(1)
        for one, two in zip(first, drive(worker, 0), strict=True):
            assert_same_bits(one[:4], two[:4])
            assert one[4] == two[4]


@needs_sumo
def test_on_own_scenarios_the_weight_is_that_of_events_that_are_drawn_as_vehicles_come(tmp_path) -> None:
    often = 'begin="0" end="900" probability="0.5" departLane="random"'
    flow = f'<flow id="f" {often}><route edges="ab bc"/></flow>'
    cycles = '<vType id="bike" vClass="bicycle"/>' + flow.replace('id="f"', 'id="b" type="bike"')
    road = build(tmp_path, ("a 0 0, b 600 0, c 1200 0", "ab a b 3 25, bc b c 3 25"))
    config = {"risk": 0.2, "warm_up": 20, "duration": 30}
    with closing(SumoDrivingEnv(road, route_file(tmp_path, flow + cycles), ["ab", "bc"], config)) as env:
        rates, total = env.task.risk_rates, 0
        for seed in range(3):
            env.reset(seed=seed, options={"event_factor": 8.0, "event_reach": 60.0})
            twin = copy.deepcopy(env)
            driven = list(scenes(env))
            assert list(scenes(twin))[-1][1].near_events == env.scene.near_events
            twin.close()
            events: list[RiskEvent] = []
            cars = {name for scene, _ in driven for name in scene.ids[1:] if name.startswith("f")}
            for name in cars:
                tilt, seed_of = env.scenario.tilt, env.scenario.seed
                drawn = draw_events(rates, 0.2, ((name, 0.0),), seed_of, 30, f"risk events of {name}")
                further = tilt.further(((name, 0.0),), seed_of, f"further risk events of {name}")
                events += [*drawn, *further]
            rate = 0.2 * (rates.cut_in + rates.brake + rates.surge)
            found, again = list(env.scene.near_events), recomputed(env, driven, events, rate)
            del found[2], again[2]  # events of vehicles before they have come are not even drawn
            assert found == pytest.approx(again, abs=1e-9)
            total += env.scene.near_events.events
    assert total > 3


def test_several_learning_cars_have_one_weight() -> None:
    with closing(make("u-turn", {"risk": 0.5}, cars=2)) as env:
        env.reset(seed=0, options={**TILT, "risk_rates": {"brake": 0.3}})
        assert env.scenario.tilt.rates.brake == 0.3
        info = env.step((1, 1))[4]
        assert info["expected_events"] > 0.0 and math.isfinite(info["log_weight"])
