"""Calling SUMO's C++ functions from compiled code gives what libsumo gives, and leaves errors to libsumo."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sumo_env import direct
from sumo_env import simulation as simulation_module
from sumo_env.drivers import TOLD
from sumo_env.env import DrivingEnv
from sumo_env.simulation import Fleet, simulation
from sumo_env.tasks import TASKS
from sumo_env.world import World
from tests.sumo_env.rollout import record

SEEDS = 0, 1, 25  # 25: in two traffics a cut-in ends while compiled code could drive on
needs_direct = pytest.mark.skipif(simulation().functions is None, reason="another version or platform")


@needs_direct
@pytest.mark.parametrize("risk", [0.0, 1.0])
@pytest.mark.parametrize("traffic_model", ["matched", "sumo"])
@pytest.mark.parametrize("task", TASKS)
def test_episodes_are_the_same_bit_for_bit(
    task: str, traffic_model: str, risk: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = {**list(TASKS[task].levels.values())[1], "risk": risk, "traffic_model": traffic_model}
    env = DrivingEnv(task, config)

    def drive(seed: int) -> tuple[Any, ...]:
        rows, world = record(env, seed), env._world
        assert world is not None
        return rows, env.scene, (env.ego.target_lane, world.time, world.crash)

    directly = [drive(seed) for seed in SEEDS]
    assert env._world is not None and env._world.fleet.handles() is not None

    def check() -> None:
        for seed, (rows, scene, rest) in zip(SEEDS, directly, strict=True):
            again = drive(seed)
            np.testing.assert_array_equal(again[0], rows)
            for field in ("x", "y", "speed", "heading", "crashed"):
                np.testing.assert_array_equal(getattr(again[1], field), getattr(scene, field))
            assert again[2] == rest

    monkeypatch.setattr(World, "_undisturbed", lambda world, most: 0)  # one sub-step after another
    check()
    monkeypatch.setattr(simulation(), "functions", None)
    check()
    assert env._world.fleet.handles() is None
    env.close()


@needs_direct
@pytest.mark.parametrize("traffic_model", ["matched", "sumo"])
@pytest.mark.parametrize("task", TASKS)
def test_sub_steps_are_driven_in_one_call(
    task: str, traffic_model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    env = DrivingEnv(task, {"traffic_model": traffic_model})
    env.reset(seed=0)
    assert env._world is not None
    monkeypatch.setattr(env._world, "_substep", lambda: pytest.fail("one after another"))
    for action in (0, 2, 1):  # changes of lane where there are some
        env.step(action)
    env.close()


@needs_direct
def test_the_road_is_followed_after_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ego may have been commanded to a lane that ends sooner than the one it was on."""
    env = DrivingEnv("roundabout", {"traffic_model": "sumo"})
    env.reset(seed=0)
    env.step(1)
    calls = []
    follow = env.ego.follow_road
    monkeypatch.setattr(env.ego, "command", lambda *_: None)
    monkeypatch.setattr(env.ego, "follow_road", lambda x, y: calls.append((x, y)) or follow(x, y))
    before = env.scene
    env.step(1)
    assert calls[0] == (before.x[0], before.y[0])
    env.close()


@needs_direct
@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
@pytest.mark.parametrize(
    ("broken", "task", "traffic_model"),
    [
        ("sumo_env.simulation._step", "highway", "matched"),
        ("sumo_env.simulation._step", "highway", "sumo"),
        ("sumo_env.simulation._step", "two-way", "matched"),
        ("sumo_env.simulation.Simulation.change_lane", "highway", "sumo"),
        ("sumo_env.simulation.Simulation.change_lane_relative", "two-way", "matched"),
    ],
)
def test_what_is_raised_inside_the_compiled_call_is_raised(
    broken: str, task: str, traffic_model: str, error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    env = DrivingEnv(task, {"traffic_model": traffic_model})
    env.reset(seed=0)
    world = env._world
    assert world is not None and world._traffic is not None
    there = world.ego.target_lane[2]

    def fail(*_: object) -> None:
        raise error("SUMO is broken")

    with monkeypatch.context() as patch:
        patch.setattr(broken, fail)
        with pytest.raises(error, match="SUMO is broken"):
            env.step(0 if there else 2)
    env.reset(seed=0)
    env.step(1)
    env.close()


@needs_direct
@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_the_ego_is_given_its_next_lane_inside_the_compiled_call_which_may_raise(
    error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    env = DrivingEnv("roundabout")
    env.reset(seed=0)
    monkeypatch.setattr(env._world, "_substep", lambda: pytest.fail("one after another"))
    step, steps = simulation_module._step, []

    def follow(x: float, y: float) -> None:
        if steps:
            raise error("there is no road")

    monkeypatch.setattr(simulation_module, "_step", lambda until: steps.append(until) or step(until))
    monkeypatch.setattr(env.ego, "follow_road", follow)
    with pytest.raises(error, match="there is no road"):
        for _ in range(10):
            steps.clear()
            env.step(1)
    env.reset(seed=0)
    env.step(1)
    env.close()


def rows_for(fleet: Fleet, n: int) -> tuple[Any, ...]:
    return np.empty((4, n)), np.empty((3, n)), np.empty(n, np.int64), np.full(n, np.nan)


def test_a_vehicle_that_has_left_raises_instead_of_being_read() -> None:
    env = DrivingEnv("u-turn")
    env.reset(seed=0)
    sim = simulation()
    names = sim.present()
    fleet = sim.fleet(names)
    rows = rows_for(fleet, len(names))
    fleet.read(*rows)
    for _ in range(2000):
        sim.step()
        if len(sim.present()) < len(names):
            break
    with pytest.raises(Exception, match="not known"):
        fleet.read(*rows)
    env.close()


def test_an_unknown_vehicle_raises() -> None:
    env = DrivingEnv("highway")
    env.reset(seed=0)
    with pytest.raises(Exception, match="not known"):
        simulation().fleet(["ego", "nobody"])
    env.close()


@needs_direct
def test_removing_one_vehicle_does_not_stop_direct_reading_of_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env = DrivingEnv("highway")
    env.reset(seed=0)
    sim = simulation()
    names = [name for name in sim.present() if name != "v0"]
    sim.remove("v0")
    fleet = sim.fleet(names)
    answers = []
    read = direct.read
    monkeypatch.setattr(direct, "read", lambda *arguments: answers.append(read(*arguments)) or answers[-1])
    fleet.read(*rows_for(fleet, len(names)))
    sim.step()
    fleet.read(*rows_for(fleet, len(names)))
    assert answers == [True, True]
    env.close()


@needs_direct
def test_names_of_any_length_are_found() -> None:
    env = DrivingEnv("highway")
    env.reset(seed=0)
    sim = simulation()
    functions = sim.functions
    assert functions is not None
    for name in ("v", "a_vehicle_of_15", "a_vehicle_of_16_", "a vehicle with a very long name ä"):
        sim.add(name, "0-1>1", TOLD.type, "0-1_0", 5000.0, 20.0, 31, 0, 25.0)
        fleet = sim.fleet([name])
        state, before, lane, own = rows_for(fleet, 1)
        fleet.read(state, before, lane, own)
        assert state[0, 0] == 4497.5  # the network begins at x = -500 m
        assert sim.lane_ids[lane[0]] == "0-1_0"
        sim.remove(name)
    env.close()


def test_other_versions_are_not_called() -> None:
    assert direct.find("", "SUMO 1.27.0") is None
    assert direct.find("no such library", direct.VERSION) is None
