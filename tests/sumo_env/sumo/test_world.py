"""Episodes on SUMO: the ego's motion, contacts, wrecks, risk events, vehicles that come, go or do not matter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import libsumo
import numpy as np
import pytest

from sumo_env.drivers import FREE_WAY, RiskEvent
from sumo_env.env import DrivingEnv
from sumo_env.scenario import Scenario, VehicleSpec
from sumo_env.scene import Scene
from sumo_env.simulation import NO_LANE_CHANGES, OWN_LANE_CHANGES, REGULAR
from sumo_env.tasks import TASKS
from sumo_env.world import World


@pytest.fixture
def make() -> Iterator[Any]:
    """Environments that start from a scenario changed by the test."""
    made: list[DrivingEnv] = []

    def build(task: str, change: Any = lambda scenario: scenario, seed: int = 0, **config: Any) -> DrivingEnv:
        env = DrivingEnv(task, config)
        draw = env.task.scenario
        the_task = type(env.task)()
        the_task.scenario = lambda config, seed: change(draw(config, seed))  # type: ignore[method-assign]
        env.task = the_task
        env.reset(seed=seed)
        made.append(env)
        return env

    yield build
    for env in made:
        env.close()


def alone(scenario: Scenario) -> Scenario:
    return replace(scenario, vehicles=(), spawns=(), events=())


def with_leader(distance: float, speed: float) -> Any:
    """One vehicle ahead of the ego in its lane."""

    def change(scenario: Scenario) -> Scenario:
        ego, other = scenario.ego, scenario.vehicles[0]
        leader = other._replace(
            lane=ego.lane,
            s=ego.s + distance,
            x=ego.x + distance,
            y=ego.y,
            speed=speed,
            target_speed=speed,
        )
        return replace(scenario, vehicles=(leader,), events=())

    return change


def substeps(env: DrivingEnv, action: int) -> list[Scene]:
    """Scenes after every simulation step of one policy step."""
    assert env._world is not None
    scenes: list[Scene] = []
    env.ego.command(env.actions[action], float(env.scene.x[0]), float(env.scene.y[0]))
    env.scene = env._world.step(scenes.append)
    return [*scenes, env.scene]


def test_idle_ego_keeps_speed_and_lane(make: Any) -> None:
    env = make("highway", alone)
    x = env.scene.x[0]
    for _ in range(5):
        env.step(1)
    assert env.scene.x[0] - x == pytest.approx(125.0, abs=0.01)
    assert env.scene.speed[0] == 25.0


def test_a_lane_change_is_exponential_as_in_highway_env(make: Any) -> None:
    """There the ego crosses the line after 0.46 s, has moved 3.41 m after 1 s and is within 0.1 m after 1.7 s."""
    env = make("highway", alone, initial_lane_id=2)
    y = np.array([scene.y[0] for scene in substeps(env, 0)])
    flip = np.argmax(y < 6.0) + 1
    assert flip == 5  # tenths of a second
    assert y[-1] == pytest.approx(8.0 - 3.41, abs=0.05)
    y = np.array([scene.y[0] for scene in substeps(env, 1)])
    assert np.argmax(y < 4.1) + 11 in (17, 18)


def test_two_lane_changes_in_a_row_are_both_made(make: Any) -> None:
    env = make("highway", alone, initial_lane_id=3)
    env.step(0)
    env.step(0)
    for _ in range(2):
        env.step(1)
    assert env.scene.y[0] == pytest.approx(4.0, abs=0.01)


def test_the_ego_is_not_slowed_by_bends_or_junctions(make: Any) -> None:
    for task, faster, seconds, speed in (
        ("u-turn", 3, 10, 24.0),
        ("roundabout", 3, 9, 16.0),
        ("intersection", 2, 9, 9.0),
    ):
        env = make(task, alone)
        driven = 0.0
        for _ in range(seconds):
            before = env.scene
            _, _, terminated, truncated, info = env.step(faster)
            driven = info["distance"]
            chord = np.hypot(env.scene.x[0] - before.x[0], env.scene.y[0] - before.y[0])
            assert chord <= driven + 0.3
            if terminated or truncated:
                break
        assert driven == pytest.approx(speed, rel=0.02)
        assert info["on_road"]


def test_empty_intersection_takes_nine_steps(make: Any) -> None:
    env = make("intersection", alone)
    rewards = []
    for _ in range(13):
        _, reward, terminated, _, info = env.step(1)
        rewards.append(reward)
        if terminated:
            break
    assert info["arrived"] and not info["crashed"]
    assert len(rewards) in (8, 9, 10) and sum(rewards) == pytest.approx(len(rewards))


def test_empty_two_way_road_pays_15_for_driving_left(make: Any) -> None:
    env = make("two-way", alone)
    total = env.step(0)[1]
    truncated = False
    while not truncated:
        _, reward, terminated, truncated, _ = env.step(1)
        assert not terminated
        total += reward
    assert total == pytest.approx(15.0)
    assert env.scene.y[0] == pytest.approx(0.0, abs=0.01)
    assert env.scene.x[0] == pytest.approx(480.0, abs=1.0)


def test_the_two_way_ego_returns_to_its_lane(make: Any) -> None:
    env = make("two-way", alone)
    env.step(0)
    env.step(2)
    env.step(1)
    assert env.scene.y[0] == pytest.approx(4.0, abs=0.01)
    assert env.ego_state.lane == ("a", "b", 1)


def test_rear_end_crash_is_recorded_and_ends_the_episode(make: Any) -> None:
    env = make("highway", with_leader(20.0, 15.0))
    terminated = False
    while not terminated:
        _, _, terminated, _, info = env.step(1)
    crash = info["crash"]
    assert info["crashed"] and crash["type"] == "rear-end" and crash["other"] == env.scene.ids[1]
    assert crash["closing_speed"] == pytest.approx(10.0, abs=1.5)
    # the pose at the contact, not at the end of its sub-step, when the ego is up to 1 m further
    assert crash["relative_x"] == pytest.approx(5.0, abs=0.001) and abs(crash["relative_y"]) < 0.001
    assert crash["detected_by"] in ("both", "sumo", "geometry")
    assert env.scene.crashed.all()
    assert info["min_ttc"] < 1.0 and not info["near_miss"]


@pytest.mark.parametrize(("distance", "crashes"), [(5.05, True), (5.2, False)])
def test_a_report_of_sumo_counts_within_a_tolerance(
    make: Any, monkeypatch: pytest.MonkeyPatch, distance: float, crashes: bool
) -> None:
    env = make("highway", with_leader(distance, 25.0))
    monkeypatch.setattr(env._world.sim, "collisions", lambda: [("ego", env.scene.ids[1])])
    _, _, terminated, _, info = env.step(1)
    assert terminated == crashes
    if crashes:
        assert info["crash"]["detected_by"] == "sumo"


def test_a_contact_that_is_over_within_a_sub_step_is_a_crash(
    make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    env = make("highway", with_leader(30.0, 25.0))
    other = env.scene.ids[1]
    read = World._read

    def passes_through(world: World) -> None:
        """The other has crossed the ego's way within the first sub-step."""
        read(world)
        before = world.cars.before
        if world.time < 1.5 * world.dt:
            before[:, 1] = before[0, 0] + 1.0, before[1, 0] - 6.0, np.pi / 2
            world.x[1], world.y[1], world.heading[1] = world.x[0], world.y[0] + 6.0, np.pi / 2

    monkeypatch.setattr(World, "_read", passes_through)
    # SUMO's car is put where the other is shown, a sub-step late, and may be reported there
    monkeypatch.setattr(env._world.sim, "collisions", lambda: [])
    monkeypatch.setattr(World, "_undisturbed", lambda world, most: 0)
    _, _, terminated, _, info = env.step(1)
    assert terminated and info["crash"]["other"] == other
    assert info["crash"]["type"] == "junction" and info["crash"]["detected_by"] == "geometry"
    assert 0.0 < info["crash"]["time"] < 0.1


def test_wrecks_coast_and_stay(make: Any) -> None:
    env = make("highway", with_leader(12.0, 10.0))
    env.step(1)
    assert env.scene.crashed.all()
    speed = env.scene.speed.copy()
    env.step(1)
    assert env.scene.speed == pytest.approx(speed * (14 / 15) ** 15, rel=1e-6)  # explicit Euler at 15 Hz
    for _ in range(6):
        env.step(1)
    place = env.scene.x.copy()
    env.step(1)
    assert env.scene.x == pytest.approx(place, abs=0.1)


def test_frontal_crash_on_the_two_way_road(make: Any) -> None:
    def change(scenario: Scenario) -> Scenario:
        return replace(scenario, vehicles=tuple(v for v in scenario.vehicles if v.lane == ("b", "a", 0)))

    env = make("two-way", change)
    action, terminated = 0, False
    while not terminated:
        _, _, terminated, truncated, info = env.step(action)
        action = 1
        assert not truncated
    assert info["crash"]["type"] == "frontal"
    assert info["crash"]["closing_speed"] > 30.0


def test_a_follower_brakes_for_the_ego(make: Any) -> None:
    def change(scenario: Scenario) -> Scenario:
        ego, other = scenario.ego, scenario.vehicles[0]
        follower = other._replace(
            lane=ego.lane,
            s=ego.s - 40,
            x=ego.x - 40,
            y=ego.y,
            speed=24.0,
            target_speed=28.0,
            changes_lanes=False,
        )
        return replace(scenario, vehicles=(follower,))

    env = make("highway", change)
    for _ in range(12):
        _, _, terminated, _, _ = env.step(4)
        assert not terminated
    assert env.scene.speed[1] == pytest.approx(env.scene.speed[0], abs=0.5)


@pytest.mark.parametrize("traffic_model", ["matched", "sumo"])
def test_a_brake_event_brakes_and_ends(make: Any, traffic_model: str) -> None:
    def change(scenario: Scenario) -> Scenario:
        other: VehicleSpec = scenario.vehicles[0]
        event = RiskEvent(1.0, other.id, "brake", decel=5.0, duration=1.0)
        return replace(scenario, vehicles=(other,), events=(event,), spawns=())

    for task in ("highway", "two-way"):
        env = make(task, change, traffic_model=traffic_model, duration=8)
        env.step(4)
        before = env.scene.speed[1]
        env.step(4)
        after = env.scene.speed[1]
        assert before - after > 3.5
        env.step(4)
        assert env.scene.speed[1] > after


@pytest.mark.parametrize("traffic_model", ["matched", "sumo"])
@pytest.mark.parametrize(("ahead", "happens"), [(14.0, True), (1.0, False)])
def test_a_cut_in_takes_any_gap_but_needs_one(
    make: Any, traffic_model: str, ahead: float, happens: bool
) -> None:
    def change(scenario: Scenario) -> Scenario:
        ego, other = scenario.ego, scenario.vehicles[0]
        x, speed = ego.x + ahead, 20.0 if happens else 25.0
        beside = other._replace(lane=("0", "1", 1), s=x, x=x, y=4.0, speed=speed, target_speed=speed)
        beside = beside._replace(changes_lanes=False)
        return replace(
            scenario, vehicles=(beside,), events=(RiskEvent(0.5, beside.id, "cut-in", direction=-1),)
        )

    # a driver with nobody to the other side would change there: two lanes only
    env = make("highway", change, traffic_model=traffic_model, initial_lane_id=0, lanes_count=2)
    env.step(1)
    _, _, crashed, _, _ = env.step(1)
    assert crashed == happens
    assert bool(abs(env.scene.y[1]) < 2.0) == happens


@pytest.mark.parametrize(
    ("task", "traffic_model"), [("two-way", "matched"), ("intersection", "matched"), ("u-turn", "sumo")]
)
def test_a_surge_accelerates_where_the_way_is_free(make: Any, task: str, traffic_model: str) -> None:
    gained = {}
    for blocked, way in ((False, FREE_WAY), (True, FREE_WAY), (True, 10.0)):

        def change(scenario: Scenario, blocked: bool = blocked, way: float = way) -> Scenario:
            other = scenario.vehicles[0]
            vehicles = [other._replace(speed=8.0, target_speed=8.0)]
            if blocked:
                dx, dy = 15 * np.cos(other.heading), 15 * np.sin(other.heading)
                ahead = vehicles[0]._replace(id="ahead", s=other.s + 15, x=other.x + dx, y=other.y + dy)
                vehicles.append(ahead)
            event = RiskEvent(0.0, other.id, "surge", accel=4.0, duration=2.0, way=way)
            return replace(scenario, vehicles=tuple(vehicles), events=(event,), spawns=())

        env = make(task, change, traffic_model=traffic_model)
        before = float(env.scene.speed[1])
        env.step(0)
        gained[blocked, way] = float(env.scene.speed[1]) - before
    assert gained[False, FREE_WAY] == pytest.approx(4.0, abs=0.5)
    assert gained[True, FREE_WAY] < 2.0
    assert gained[True, 10.0] > 2.0  # 15 m are enough for it


def test_intersection_traffic_comes_and_goes() -> None:
    env = DrivingEnv("intersection", {"duration": 40, "spawn_probability": 1.0})
    env.reset(seed=1)
    seen: set[str] = set(env.scene.ids)
    gone = False
    for _ in range(25):
        env.step(0)  # the ego waits
        gone = gone or not seen <= set(env.scene.ids)
        seen |= set(env.scene.ids)
    assert gone and any(name.startswith("s") for name in seen)
    env.close()


def test_vehicles_out_of_reach_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    config = {**TASKS["highway"].levels["100"], "vehicles_count": 80}
    runs = []
    for leave_out in (True, False):
        if not leave_out:
            monkeypatch.setattr(type(TASKS["highway"]), "concerns_ego", lambda *arguments: True)
        env = DrivingEnv("highway", config)
        episodes = []
        for seed in range(4):
            rng = np.random.default_rng(seed)
            observation, _ = env.reset(seed=seed)
            trace = [observation]
            done = False
            while not done:
                observation, _, terminated, truncated, _ = env.step(int(rng.integers(5)))
                trace.append(observation)
                done = terminated or truncated
            episodes.append(np.array(trace))
        runs.append((episodes, len(env.scene)))
        env.close()
    assert runs[0][1] < runs[1][1] == 81
    for short, whole in zip(runs[0][0], runs[1][0], strict=True):
        assert short.shape == whole.shape
        assert np.abs(short - whole).max() < 1e-4


@pytest.mark.parametrize(
    ("task", "lane_changes"), [("highway", OWN_LANE_CHANGES), ("intersection", NO_LANE_CHANGES)]
)
def test_sumo_drives_its_own_traffic_in_the_modes_of_the_rule(make: Any, task: str, lane_changes: int) -> None:
    """Vehicles are not told what SUMO's default is; it has to be that."""
    env = make(task, traffic_model="sumo")
    others = env.scene.ids[1:]
    assert {libsumo.vehicle.getSpeedMode(name) for name in others} == {REGULAR}
    assert {libsumo.vehicle.getLaneChangeMode(name) for name in others} == {lane_changes}


def test_swerves_into_oncoming_traffic_do_not_end_the_process() -> None:
    """With a lane-change model that knows no opposite lanes SUMO crashed in one of some 70 such episodes."""
    env = DrivingEnv("two-way", {**next(iter(TASKS["two-way"].levels.values())), "risk": 1.0})
    rng = np.random.default_rng(0)
    for seed in range(150):
        env.reset(seed=seed)
        over = False
        while not over:
            _, _, terminated, truncated, _ = env.step(int(rng.integers(5)))
            over = terminated or truncated
    env.close()
