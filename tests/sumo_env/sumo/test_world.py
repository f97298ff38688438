"""Episodes on SUMO: the ego's motion, contacts, crashed vehicles, and vehicles that come, go or do not matter."""

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import libsumo
import numpy as np
import pytest

from sumo_env.config import resolve
from sumo_env.contacts.measures import TTC_RADIUS, ego_ttc
from sumo_env.contacts.rectangles import states
from sumo_env.env import DrivingEnv
from sumo_env.replica.env import ReplicaEnv
from sumo_env.simulator import EgoCommand
from sumo_env.sumo.engine import Engine
from sumo_env.sumo.nearby_vehicles import FASTEST, Surroundings
from sumo_env.sumo.session import Session
from sumo_env.sumo.world import SumoSimulator
from sumo_env.tasks import TASKS
from sumo_env.traffic.scenario import EGO_DISTANCE, Scenario, Spawn
from tests.sumo_env.rollout import assert_same_bits, drive
from tests.sumo_env.situations import alone, draw, placed, with_leader
from tests.tasks import every_task

Start = Callable[..., DrivingEnv]
LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)


# -- the protocol ------------------------------------------------------------------------------------------


def test_a_step_says_what_it_has_brought(simulator: SumoSimulator) -> None:
    scenario = with_leader(40.0, 22.0)(draw("highway", 3))
    first = simulator.reset(scenario)
    assert first.ids[0] == "ego" and len(first) == 1 + len(scenario.vehicles) and first.time == 0.0
    step = simulator.step({"ego": EgoCommand(30.0, scenario.ego.lane)}, trace=True)
    assert [scene.time for scene in step.trace] == pytest.approx(np.arange(1, 11) / 10)
    assert step.trace[-1] is step.scene
    xs = [first.x[0], *(scene.x[0] for scene in step.trace)]
    assert step.ego.distance == pytest.approx(xs[-1] - xs[0], abs=0.01) and np.all(np.diff(xs) > 0.0)
    assert step.ego.target_lane == scenario.ego.lane and step.ego.crash is None
    for command in 2 * [EgoCommand(20.0, scenario.ego.lane)]:  # of each step by itself, not of the episode
        least = min(ego_ttc(own, others) for own, *others in map(states, step.trace))
        assert step.ego.min_ttc == pytest.approx(least) and least < 10.0
        step = simulator.step({"ego": command}, trace=True)
    assert step.ego.min_ttc == np.inf and simulator.step({"ego": command}).trace == ()


@every_task
def test_vehicles_begin_where_the_scenario_puts_them(task: str, simulator: SumoSimulator) -> None:
    """In the middle of their lanes, whose bends SUMO draws as polygons; but for traffic that has a warm-up."""
    scenario = draw(task, 2)
    scene = simulator.reset(scenario)
    specs = scenario.specs[:1] if scenario.warm_up else scenario.specs
    for row, spec in enumerate(specs):
        lane = scenario.road.lane(spec.lane)
        assert scene.ids[row] == spec.id
        place = pytest.approx(lane.position(spec.s, 0.0), abs=1e-6 if task in ("highway", "two-way") else 0.2)
        assert (scene.x[row], scene.y[row]) == place
        assert np.cos(scene.heading[row] - lane.heading_at(spec.s)) > np.cos(0.02)
        assert scene.speed[row] == pytest.approx(spec.speed)
    assert np.all((-np.pi < scene.heading) & (scene.heading <= np.pi))


# -- the ego's motion --------------------------------------------------------------------------------------


def test_a_lane_change_crosses_the_line_when_highway_env_s_does(simulator: SumoSimulator) -> None:
    """There the ego crosses the line after 0.46 s, has moved 3.41 m after 1 s and is within 0.1 m after 1.7 s."""
    simulator.reset(alone(draw("highway", initial_lane_id=2)))
    command = EgoCommand(25.0, ("0", "1", 1))
    steps = [simulator.step({"ego": command}, trace=True) for _ in range(2)]
    y = np.array([scene.y[0] for step in steps for scene in step.trace])
    assert np.argmax(y < 6.0) + 1 == 5  # tenths of a second
    assert 4.0 <= y[9] <= 8.0 - 3.41
    assert np.all(np.diff(y) <= 0.0) and np.all(np.abs(y[17:] - 4.0) < 0.1)


@pytest.mark.parametrize(
    ("task", "tolerance", "actions"),
    [("u-turn", 1.0, (IDLE, FASTER)), ("roundabout", 2.0, (IDLE, FASTER)), ("intersection", 1.0, (1, 2))],
)
@pytest.mark.parametrize("faster", [0, 1])
def test_alone_in_a_bend_the_ego_drives_as_in_highway_env(
    task: str, tolerance: float, actions: tuple[int, int], faster: int
) -> None:
    """tolerance [m]: SUMO lays a vehicle on a chord, and a change of the ring's lanes takes its own time."""
    config = {"vehicles_count": 0}
    ours: Any = gym.make(f"sumo/{task}-v0", config=config)
    reference: Any = ReplicaEnv(task, config, scenarios="seeded")
    for env in (ours, reference):
        env.reset(seed=0)
    ended, way = False, 0.0
    while not ended:
        *_, ended, cut, info = ours.step(actions[faster])
        *_, ends, cuts, _ = reference.step(actions[faster])
        ended = ended or cut or ends or cuts
        way += info["distance"]
        if not ended:
            one, other = ours.unwrapped.scene, reference.unwrapped.scene
            apart = math.hypot(one.x[0] - other.x[0], one.y[0] - other.y[0])
            assert apart < tolerance, f"after {way:.0f} m"
    assert way > 36.0


# -- contacts and crashed vehicles -------------------------------------------------------------------------


def test_rear_end_crash_is_recorded_and_ends_the_episode(start: Start) -> None:
    env = start("highway", with_leader(20.0, 15.0))
    *_, (_, _, terminated, _, info) = drive(env, IDLE)
    crash = info["crash"]
    assert terminated and info["crashed"]
    assert (crash["type"], crash["other"]) == ("rear-end", env.scene.ids[1])
    assert crash["closing_speed"] == pytest.approx(10.0, abs=1.5)
    # the pose at the contact, not at the end of its sub-step, when the ego is up to 1 m further
    assert crash["relative_x"] == pytest.approx(5.0, abs=0.001) and abs(crash["relative_y"]) < 0.001
    assert crash["detected_by"] == "both"
    assert env.scene.crashed.all()
    assert info["min_ttc"] < 1.0 and not info["near_miss"]


@pytest.mark.parametrize("departs", [0.0, 0.35])
def test_vehicles_that_a_user_adds_through_libsumo_are_seen(start: Start, departs: float) -> None:
    """At once, or when they depart within a policy step."""
    env = start("highway", alone)
    assert np.isinf(env.step(IDLE)[-1]["min_ttc"])
    road, lane = libsumo.vehicle.getRouteID("ego"), str(libsumo.vehicle.getLaneIndex("ego"))
    place = str(libsumo.vehicle.getLanePosition("ego") + 300.0)
    depart = str(libsumo.simulation.getTime() + departs)
    libsumo.vehicle.add("mine", road, "DEFAULT_VEHTYPE", depart, lane, place, "0")
    libsumo.vehicle.setMaxSpeed("mine", 0.5)
    libsumo.vehicle.setLaneChangeMode("mine", 0)  # else it moves over to the right
    times = []
    while not env.ego_state.crashed and env.steps < 15:
        times.append(env.step(IDLE)[-1]["min_ttc"])
    assert env._car.met.crash.other == "mine"
    assert min(times) < 1.0
    assert "mine" in env.scene.ids and env.scene.size("mine") == (5.0, 1.8)  # of SUMO's passenger car
    assert env.scene.crashed.all()


def test_crashed_vehicles_coast_and_stay(start: Start) -> None:
    env = start("highway", with_leader(12.0, 10.0))
    env.step(IDLE)
    assert env.scene.crashed.all()
    speed = env.scene.speed.copy()
    env.step(IDLE)
    assert env.scene.speed == pytest.approx(speed * (14 / 15) ** 15, rel=1e-6)  # explicit Euler at 15 Hz
    for _ in range(6):
        env.step(IDLE)
    place = env.scene.x.copy()
    env.step(FASTER)
    assert env.scene.x == pytest.approx(place, abs=0.1)


def test_a_crashed_vehicle_coasts_as_far_in_a_bend(simulator: SumoSimulator) -> None:
    """SUMO's metres there are others than those of the road."""
    scenario = draw("u-turn")
    bend, spec = scenario.road.lane(("b", "c", 0)), placed(scenario, 0, ("b", "c", 0), 2.0, 8.0)
    scenes = [simulator.reset(replace(scenario, vehicles=(spec,)))]
    simulator._crash(spec.id)
    scenes.append(simulator.step({"ego": EgoCommand(9.0, scenario.ego.lane)}).scene)
    before, after = (bend.local_coordinates(scene.x.item(1), scene.y.item(1))[0] for scene in scenes)
    assert after - before == pytest.approx(8.0 * (1.0 - (14 / 15) ** 15), abs=0.1)


# -- vehicles that come, go or do not matter ---------------------------------------------------------------


def test_the_intersection_begins_with_traffic_that_has_driven_and_room_for_the_ego(simulator) -> None:
    moved, task = [], TASKS["intersection"]
    config = {**resolve(task.name, task.defaults), "initial_vehicle_count": 20}
    for seed in range(20):
        scenario = task.scenario({**config, "controlled_vehicles": 1 + seed % 4}, seed)
        scene = simulator.reset(scenario)
        assert scene.time == 0.0 and scene.speed[0] == scenario.ego.speed
        others = slice(scene.cars, None)
        for car, spec in enumerate(scenario.cars):
            x, y = scene.x[car], scene.y[car]
            assert (x, y) == pytest.approx((spec.x, spec.y), abs=1e-6)
            assert np.all(np.hypot(scene.x[others] - x, scene.y[others] - y) >= EGO_DISTANCE)
        places = {spec.id: (spec.x, spec.y) for spec in scenario.vehicles}
        for name, x, y in zip(scene.ids[others], scene.x[others], scene.y[others], strict=True):
            if name in places:
                moved.append(np.hypot(x - places[name][0], y - places[name][1]))
            else:
                assert name == "challenger"
    assert len(moved) > 100
    assert np.mean(moved) > 3.0 * 5.0  # three seconds at more than 5 m/s


def test_no_risk_event_happens_before_the_episode(simulator: SumoSimulator) -> None:
    for seed in range(5):
        scenario = draw("intersection", seed, risk=1.0, initial_vehicle_count=20)
        assert scenario.events
        assert_same_bits(simulator.reset(scenario), simulator.reset(replace(scenario, events=())))


def test_a_vehicle_is_let_in_unless_another_is_within_15_metres(simulator: SumoSimulator) -> None:
    """Before the step after which it comes, and where it is refused, never."""
    scenario = draw("intersection", 3, spawn_probability=1.0)
    sent = next(spawn.vehicle for spawn in scenario.spawns if spawn.step == 2)
    steps = {"first": 2, "refused": 2, "later": 4}
    spawns = tuple(Spawn(step, sent._replace(id=name)) for name, step in steps.items())
    simulator.reset(replace(scenario, vehicles=(), spawns=spawns))
    seen = [simulator.step({"ego": EgoCommand(0.0, scenario.ego.lane)}).scene.ids[1:] for _ in range(6)]
    assert seen == [(), (), ("first",), ("first",), ("first", "later"), ("first", "later")]


def test_vehicles_leave_the_intersection_20_m_before_the_end_of_an_exit(simulator: SumoSimulator) -> None:
    """Before the next policy step, and nobody else does."""
    scenario = draw("intersection", 1, spawn_probability=1.0)
    road, left = scenario.road, 0
    simulator.reset(scenario)
    before = simulator.step({"ego": EgoCommand(0.0, scenario.ego.lane)}).scene
    for _ in range(40):
        scene = simulator.step({"ego": EgoCommand(0.0, scenario.ego.lane)}).scene
        for row, name in enumerate(before.ids[1:], 1):
            place = before.x.item(row), before.y.item(row)
            index = road.closest_lane(*place, before.heading.item(row))
            s, _ = road.lane(index).local_coordinates(*place)
            leaves = index[1] in road.ends and s >= road.lane(index).length - 20.0
            assert leaves == (name not in scene.ids), (name, index, s)
            left += leaves
        before = scene
    assert left > 3


def test_vehicles_out_of_reach_make_no_difference(start: Start) -> None:
    def all_of_them(scenario: Scenario) -> Scenario:
        return replace(scenario, vehicles=tuple(v._replace(concerns_ego=True) for v in scenario.vehicles))

    config = {**TASKS["highway"].levels["50"], "vehicles_count": 80}
    for seed in range(4):
        runs, counts = [], []
        for change in (lambda scenario: scenario, all_of_them):
            env = start("highway", change, seed=seed, **config)
            actions = np.random.default_rng(seed).integers(5, size=100).tolist()
            runs.append(np.array([result[0] for result in drive(env, actions)]))
            counts.append(len(env.scene))
        assert counts[0] < counts[1] == 81
        assert runs[0].shape == runs[1].shape
        assert np.abs(runs[0] - runs[1]).max() < 1e-4


def test_the_doses_of_earlier_episodes_cost_nothing_and_change_nothing(simulator: SumoSimulator) -> None:
    """As for agents that are trained at a dose of their own in every episode."""
    command = EgoCommand(20.0, draw("u-turn").ego.lane)
    doses = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    for _ in range(2):
        for dose in doses:
            simulator.reset(draw("u-turn", risk=dose))
            assert libsumo.vehicletype.getIDCount() < 30
    scenes = [simulator.step({"ego": command}).scene for _ in range(5)]
    simulator._session.forget()
    simulator.reset(draw("u-turn", risk=doses[-1]))
    for scene in scenes:
        assert_same_bits(scene, simulator.step({"ego": command}).scene)


def test_sizes_are_known_where_one_comes_back_as_another_goes() -> None:
    """As SUMO teleports vehicles: as many are on the road, and nobody has departed or arrived."""
    listed: tuple[str, ...]
    lengths = {"car": 5.0, "bus": 12.0, "lorry": 16.0}
    vehicle = SimpleNamespace(getIDList=lambda: listed, getLength=lengths.get, getWidth=lambda _: 2.0)
    session = Session(Engine(SimpleNamespace(vehicle=vehicle, simulation=None), list, "", {}, ()))
    for listed in (("bus", "car"), ("car", "lorry"), ("bus", "car")):
        assert session.vehicles() == listed
        assert session.sizes == {name: (lengths[name], 2.0) for name in listed if name != "car"}


@pytest.mark.parametrize("frequency", [5, 10, 15, 16, 20])
@pytest.mark.parametrize("target", [30.0, 20.0, 25.0])
def test_the_ego_drives_as_in_highway_env_at_any_simulation_frequency(simulator, frequency, target):
    scenario = alone(draw("highway", simulation_frequency=frequency))
    x = simulator.reset(scenario).x[0]
    step = simulator.step({"ego": EgoCommand(target, scenario.ego.lane)}, trace=True)
    assert len(step.trace) == frequency
    assert step.scene.x[0] - x == pytest.approx(step.ego.distance, abs=0.01)
    # explicit Euler at 15 Hz, summed by hand
    speed, covered = 25.0, 0.0
    for _ in range(15):
        covered += speed / 15
        speed += (target - speed) / 0.6 / 15
    assert (step.scene.speed[0], step.ego.distance) == pytest.approx((speed, covered), abs=1e-9)


# -- what a learning car sees near it --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_whoever_is_near_is_seen_and_who_is_far_is_rarely_looked_at(seed: int) -> None:
    """Any vehicles as fast as may be, some towards the ego; one leaves and one comes in every sub-step, often by a name
    that has left."""
    rng, dt, looks = np.random.default_rng(seed), 0.1, 0
    names = [f"v{number}" for number in range(60)]
    places = {name: rng.uniform(-1500.0, 1500.0, 2) for name in names} | {"ego": np.zeros(2)}
    ways = {name: rng.uniform(-1.0, 1.0, 2) for name in places}
    ways |= {name: -places[name] for name in names[::4]}
    arrived: list[str] = []
    departed: list[str] = []

    def position(name: str) -> tuple[float, float]:
        nonlocal looks
        looks += 1
        return places[name][0].item(), places[name][1].item()

    same = {"Speed": 0.0, "Angle": 0.0, "Length": 5.0, "Width": 2.0}
    getters: Any = {f"get{key}": lambda _, value=value: value for key, value in same.items()}
    vehicle = SimpleNamespace(getIDList=lambda: tuple(sorted(places)), getPosition=position, **getters)
    simulation = SimpleNamespace(
        getArrivedIDList=lambda: arrived,
        getDepartedNumber=lambda: len(departed),
        getDepartedIDList=lambda: departed,
        getCollisions=tuple,
    )
    module = SimpleNamespace(vehicle=vehicle, simulation=simulation, simulationStep=lambda: None)
    session = Session(Engine(module, list, "", {}, ()))
    session._angle = vehicle.getAngle
    around = Surroundings(session, "ego", 0.0, None)
    for step in range(60):
        for name, place in places.items():
            fast = 0.999 * FASTEST if name in names[::4] else 0.0 if name == "ego" else FASTEST / 2.0
            places[name] = place + fast * dt * ways[name] / math.hypot(*ways[name])
        gone = rng.choice(names)
        arrived[:] = [gone] if places.pop(gone, None) is not None else []
        came = gone if rng.random() < 0.5 else rng.choice(names)
        departed[:] = [] if came in places else [came]
        for name in departed:
            places[name] = places["ego"] + rng.uniform(-200.0, 200.0, 2)
        session.step()
        if step % 20 == 0:
            around.list_vehicles()
        around.update(dt * step, 0.0)
        near = [name for name in sorted(places) if math.dist(places[name], places["ego"]) <= TTC_RADIUS]
        assert list(around.near) == [name for name in near if name != "ego"]
    assert looks < 0.6 * 60 * len(places)
