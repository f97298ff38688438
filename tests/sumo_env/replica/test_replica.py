"""The replica as a simulator; as an environment it is tested in tests/sumo_env/env/test_driving.py.

Risk events: what drivers look at, against `sumo_env.traffic.risk`, and what they do.
"""

import copy
import json
import os
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sumo_env.replica.compiled import compile_notice, compiled
from sumo_env.replica.geometry import heading_at, locate, no_places, position
from sumo_env.replica.numpy_loops import arcsin, arctan, arctan2, binary, power, tan, unary
from sumo_env.replica.risk import has_free_way, has_room
from sumo_env.replica.simulator import Replica
from sumo_env.replica.tables import CAR, lanes_of
from sumo_env.scene import Scene
from sumo_env.simulator import EgoCommand
from sumo_env.traffic import risk
from sumo_env.traffic.risk import RiskEvent
from sumo_env.traffic.scenario import Scenario
from tests.processes import python
from tests.sumo_env.situations import draw


def test_the_trace_is_the_scene_after_every_sub_step() -> None:
    simulator, drawn = Replica(), scenario("u-turn")
    assert simulator.reset(drawn).time == 0.0
    silent, command = copy.deepcopy(simulator), EgoCommand(drawn.ego.target_speed, drawn.ego.lane)
    step = simulator.step({"ego": command}, trace=True)
    assert [scene.time for scene in step.trace] == pytest.approx(np.arange(1, 16) / 15, abs=1e-6)
    last = step.trace[-1]
    assert (last.time, last.ids) == (step.scene.time, step.scene.ids)
    np.testing.assert_array_equal(last.x, step.scene.x)
    without = silent.step({"ego": command})
    assert without.trace == ()
    np.testing.assert_array_equal(without.scene.x, step.scene.x)


def test_functions_round_as_numpy_does_on_this_processor() -> None:
    rng = np.random.default_rng(7)
    for x, y in zip(rng.uniform(-1.0, 1.0, 2000), rng.uniform(3.5, 4.5, 2000), strict=True):
        theirs = np.tan(x), np.arcsin(x), np.arctan(x), np.arctan2(x, y), np.power(abs(x), y)
        assert functions(x, y) == theirs


@compiled
def functions(x: float, y: float) -> tuple[float, float, float, float, float]:
    """All five, which only kernels can call."""
    return unary(tan, x), unary(arcsin, x), unary(arctan, x), binary(arctan2, x, y), binary(power, abs(x), y)


def test_stale_machine_code_that_cannot_be_removed_is_not_used(tmp_path, monkeypatch) -> None:
    """As in the directory of another user: the package can be imported, and compiles in each process."""

    def refuse(path: Path, **_: Any) -> None:
        raise PermissionError(path)

    monkeypatch.setattr("numba.core.caching.FunctionCache.cache_path", str(tmp_path))
    index = tmp_path / "kernels.square-1.py311.nbi"
    index.touch()
    os.utime(index, (0.0, 0.0))  # older than every source
    monkeypatch.setattr(Path, "unlink", refuse)

    @compiled
    def square(x: float) -> float:
        return x * x

    assert square(3.0) == 9.0
    machine_code: Any = square
    assert machine_code.stats.cache_path is None and index.exists()


def test_who_begins_while_another_one_compiles_waits_and_loads(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("numba.core.caching.FunctionCache.cache_path", str(tmp_path))

    @compiled
    def square(x: float) -> float:
        return x * x

    done = []

    def second() -> None:
        with compile_notice(square):
            done.append(True)

    with compile_notice(square):
        thread = threading.Thread(target=second)  # locks are those of open files: as another process
        thread.start()
        thread.join(0.2)
        assert not done
        (tmp_path / "kernels.square-1.py311.nbi").touch()
    thread.join(10.0)
    assert done and capsys.readouterr().err.count("once for this installation") == 1


EPISODES = """
import json, sys
import gymnasium as gym
import numba
import numpy as np
import sumo_env
from sumo_env.replica.motion import move

task, law = sys.argv[1:]
options = {"config": {"risk": 1.0}, "scenarios": "seeded", "risk_law": law}
env = gym.make(f"replica/{task}-v0", **options)
numbers = [env.reset(seed=3)[0].tolist()]
for action in (1, 2, 0, 1):
    observation, reward, *_ = env.step(action)
    numbers.append([observation.tolist(), reward])
envs = gym.make_vec(f"replica/{task}-v0", num_envs=2, **options)
batch = envs.reset(seed=3)[0].tolist(), *(part.tolist() for part in envs.step(np.array([1, 2]))[:4])
print(json.dumps({"compiled": hasattr(move, "py_func"), "numbers": [numbers, batch]}))
"""


def flat(value: Any) -> list[float]:
    return [number for part in value for number in flat(part)] if isinstance(value, list) else [float(value)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "law"), [("u-turn", "linear"), pytest.param("intersection", "standard", marks=pytest.mark.long)]
)
def test_kernels_as_python_drive_as_compiled_ones_do(task: str, law: str) -> None:
    compiled = json.loads(python("-c", EPISODES, task, law))
    plain = json.loads(python("-c", EPISODES, task, law, NUMBA_DISABLE_JIT="1"))
    assert compiled["compiled"] and not plain["compiled"]
    np.testing.assert_allclose(flat(plain["numbers"]), flat(compiled["numbers"]), rtol=1e-9, atol=1e-12)


# -- risk events -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", ["highway", "u-turn", "roundabout"])
def test_drivers_look_at_what_sumo_s_drivers_look_at(task: str) -> None:
    lanes = lanes_of(draw(task).road, connected=True).table
    rng = np.random.default_rng(8)
    answers = np.zeros(2, int)
    for _ in range(30):
        cars = np.zeros(14, CAR)
        cars["heading"], cars["speed"] = rng.uniform(-4.0, 4.0, 14), rng.uniform(0.0, 30.0, 14)
        cars["cos"], cars["sin"] = np.cos(cars["heading"]), np.sin(cars["heading"])
        cars["push_way"] = rng.uniform(5.0, 60.0, 14)
        on = rng.integers(len(lanes), size=14)
        for car, lane in zip(cars, on, strict=True):
            car["x"], car["y"] = position(lanes[lane], rng.uniform(0.0, min(lanes[lane]["length"], 120.0)))
            car["y"] += rng.normal()
        places = no_places(lanes, cars)
        locate(lanes, cars, places)
        states = [(car["x"], car["y"], car["speed"], car["heading"]) for car in cars]
        for i, (car, lane) in enumerate(zip(cars, on.tolist(), strict=True)):
            others = states[:i] + states[i + 1 :]
            free = has_free_way(cars, i)
            assert free == risk.free_way(states[i], others, car["push_way"])
            s = places.s[lane, i]
            there = (*position(lanes[lane], s), car["speed"], heading_at(lanes[lane], s))
            room = has_room(lanes, cars, places, i, lane)
            assert room == risk.has_room(there, others)
            answers += free, room
    assert (answers > 20).all() and (answers < 400).all()


def scenario(task: str, *events: RiskEvent, **config: object) -> Scenario:
    """A regular scenario with these events."""
    return replace(draw(task, 1, simulation_frequency=15, **config), events=events)


def driven(drawn: Scenario, steps: int, name: str) -> list[tuple[Scene, int]]:
    """The scenes of all sub-steps and the row of a vehicle in them; the ego keeps its lane and speed."""
    simulator = Replica()
    simulator.reset(drawn)
    seen: list[tuple[Scene, int]] = []
    lane = drawn.ego.lane
    for _ in range(steps):
        step = simulator.step({"ego": EgoCommand(drawn.ego.target_speed, lane)}, trace=True)
        lane = step.ego.target_lane
        seen += [(scene, scene.ids.index(name)) for scene in step.trace]
    return seen


def marked(seen: list[tuple[Scene, int]], name: str) -> list[int]:
    """The sub-steps in which an event acts on this vehicle, and on no other."""
    assert all(scene.in_event <= {name} for scene, _ in seen)
    return [k for k, (scene, _) in enumerate(seen) if scene.in_event]


def test_sudden_braking_lasts_as_long_as_the_event_says() -> None:
    drawn = scenario("highway", RiskEvent(1.01, "v5", "brake", accel=-9.0, duration=1.0), vehicles_count=12)
    seen = driven(drawn, 3, "v5")
    speed = [scene.speed[row] for scene, row in seen]
    hard = np.flatnonzero(np.diff(speed) * 15 <= -9.0 + 1e-9) + 1
    assert hard.tolist() == list(range(16, 31))  # the first sub-step that begins after 1.01 s is number 16
    assert marked(seen, "v5") == list(range(16, 31))
    longer = scenario("highway", RiskEvent(0.0, "v5", "brake", accel=-9.0, duration=4.0), vehicles_count=12)
    assert min(scene.speed[row] for scene, row in driven(longer, 4, "v5")) == pytest.approx(0.0, abs=1e-9)


def test_a_surge_that_pauses_is_not_marked() -> None:
    surge = RiskEvent(0.0, "v0", "surge", accel=4.0, duration=1.0, way=1000.0)
    assert marked(driven(scenario("highway", surge, lanes_count=1), 1, "v0"), "v0") == []


@pytest.mark.parametrize("direction", [-1, 1])
def test_a_cut_in_goes_to_the_only_lane_there_is(direction: int) -> None:
    event = RiskEvent(0.0, "v0", "cut-in", direction=direction)
    seen = driven(scenario("highway", event, lanes_count=2, vehicles_count=1), 4, "v0")
    y = [scene.y[row] for scene, row in seen]
    assert abs(y[-1] - y[0]) == pytest.approx(4.0, abs=0.5), "no lane on the event's side: the other one"


def test_a_swerve_on_the_two_way_road_comes_back() -> None:
    swerve = RiskEvent(0.2, "v0", "cut-in", direction=1)
    drawn = scenario("two-way", swerve, vehicles_count=1, oncoming_vehicles_count=0)
    slow = replace(drawn, ego=drawn.ego._replace(speed=0.0, target_speed=0.0))
    seen = driven(slow, 7, "v0")
    assert marked(seen, "v0") == list(range(3, 48))  # for 3 s
    y = np.array([scene.y[row] for scene, row in seen])
    assert y.min() < 0.1
    assert y[-1] == pytest.approx(4.0, abs=0.1)
