"""Our observations against highway-env's own, on states of highway-env; and features that it lacks, everywhere."""

import copy
from itertools import chain
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from highway_env.envs.common.observation import ObservationType, observation_factory
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.controller import MDPVehicle

from experiments.backends.highway_env import ENVIRONMENTS, ScenarioEnv
from sumo_env.config import ConfigError, resolve, warn_once
from sumo_env.env import DrivingEnv
from sumo_env.networks.roads import highway
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scene import Place
from sumo_env.spaces.actions import (
    Situation,
    lane_beside,
    target_lane,
    target_speed_index,
)
from sumo_env.spaces.approach import APPROACH, RANGES
from sumo_env.spaces.factory import interface
from sumo_env.spaces.observation import Kinematics
from sumo_env.tasks import TASKS
from tests.sumo_env.plans import needs_sumo
from tests.sumo_env.scenarios.files import written
from tests.tasks import highway_env_task

from ..parity import ego_state, make, scatter, stock
from ..rollout import drive, observations

ALL_FEATURES = [
    "presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h", "cos_d", "sin_d", "long_off", "lat_off", "ang_off",
]  # fmt: skip
WIDE = {"x": [-160, 160], "y": [-50, 50], "vx": [-24, 24], "vy": [-24, 24]}
KINEMATICS: list[dict[str, Any]] = [
    {"type": "Kinematics"},
    {"type": "Kinematics", "vehicles_count": 7, "features_range": WIDE},
    {"type": "Kinematics", "vehicles_count": 15, "absolute": True, "features": ALL_FEATURES},
    {"type": "Kinematics", "vehicles_count": 6, "observe_intentions": True, "features": ALL_FEATURES},
    {"type": "Kinematics", "order": "shuffled", "vehicles_count": 8, "see_behind": True},
    {"type": "Kinematics", "normalize": False, "see_behind": True, "features": ["x", "vx", "presence"]},
    {"type": "Kinematics", "clip": False, "features_range": {"x": [-50, 50], "heading": [-4, 4]}},
]
GRIDS: list[dict[str, Any]] = [
    {"type": "TimeToCollision", **more} for more in ({"horizon": 5}, {"horizon": 16}, {})
]


def ours(env: ScenarioEnv, observation: dict[str, Any], rng: np.random.Generator) -> np.ndarray:
    config = resolve(env.task.name, env.default_config(), {"observation": observation})
    kind = interface(env.task, config).observation_type
    road, ego, scene = env.task.road(env.config), ego_state(env, None), env._scene()
    specs = (*env.scenario.specs, *(spawn.vehicle for spawn in env.scenario.spawns))
    known = scene, road, ego, {spec.id: spec for spec in specs}, rng
    return kind.observe(Situation(*known, env.target_speeds, env.scenario.ego.route(road)))


def assert_equal(env: ScenarioEnv, theirs: ObservationType, observation: dict[str, Any]) -> None:
    generator = copy.deepcopy(env.np_random)
    expected = theirs.observe()
    result = ours(env, observation, generator)
    assert result.dtype == expected.dtype
    missing = np.isnan(expected)  # headings and offsets of obstacles, which highway-env does not give
    assert np.isfinite(result).all() and (env.road.objects or not missing.any())
    np.testing.assert_allclose(result[~missing], expected[~missing], rtol=0.0, atol=1e-5)


@highway_env_task
def test_equal_throughout_episodes(task: str) -> None:
    env = make(task, risk=1.0)
    env.reset(seed=0)  # the default range of y is that of an episode's first state
    chosen = [env.config["observation"], *KINEMATICS, *GRIDS]
    theirs = [observation_factory(env, observation) for observation in chosen]
    actions = np.random.default_rng(0).integers(env.action_space.n, size=1000).tolist()
    for action, _ in zip([None, *actions], chain([()], drive(env, actions)), strict=False):
        assert ego_state(env, action).lane == env.vehicle.lane_index
        for kind, observation in zip(theirs, chosen, strict=True):
            assert_equal(env, kind, observation)


@highway_env_task
def test_equal_in_random_states(task: str) -> None:
    env = make(task)
    for seed in range(3):
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        route = env.vehicle.route
        for _ in range(10):
            scatter(env, rng)
            if route:  # as `follow_road` leaves it: it begins with the road that is steered for, or has ended
                roads = [road[:2] for road in route]
                here = env.vehicle.target_lane_index[:2]
                env.vehicle.route = route[roads.index(here) :] if here in roads else []
            for observation in (KINEMATICS[1], KINEMATICS[5], *GRIDS):
                assert_equal(env, observation_factory(env, observation), observation)


@highway_env_task
def test_features_that_highway_env_lacks_are_equal_in_its_tables(task: str) -> None:
    """The same rows in the same order, in all forms of the table."""
    for form in (
        {},
        {"absolute": True, "features": ["dx", "presence", "dcpa", "cos_h", "tcpa"]},
        {"order": "shuffled", "see_behind": True, "clip": False, "features_range": WIDE},
        {"normalize": False, "features": ["tcpa", "distance"], "vehicles_count": 3},
        {"type": "ExitObservation", "vehicles_count": 15} if task == "exit" else {"vehicles_count": 9},
    ):
        observation = {"type": "Kinematics", "features": ["presence", "x", "vy", *APPROACH], **form}
        env = make(task, observation=observation)
        env.reset(seed=0)
        rng = np.random.default_rng(0)
        for _ in range(8):
            scatter(env, rng)
            generator = copy.deepcopy(env.np_random)
            found, expected = ours(env, observation, generator), env.observation_type.observe()
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)
            assert found.shape == env.observation_space.shape


@highway_env_task
def test_spaces_are_those_of_highway_env(task: str) -> None:
    theirs = stock(task)({"vehicles_count": 5})
    for frequency in (1, 3):
        for observation in (*KINEMATICS, *GRIDS):
            chosen = {"observation": observation, "policy_frequency": frequency, "simulation_frequency": 15}
            theirs.configure(copy.deepcopy(chosen))
            theirs.define_spaces()
            own = interface(TASKS[task], resolve(task, TASKS[task].defaults, chosen))
            assert own.observation_type.space == theirs.observation_space
            assert gym.spaces.Discrete(len(own.action_type.names)) == theirs.action_space


ACTIONS = {"longitudinal": False}, {"lateral": False}, {"target_speeds": [5, 10, 15, 20]}


@pytest.mark.parametrize("action", ACTIONS)
@highway_env_task
def test_actions_are_those_of_highway_env(task: str, action: dict[str, Any]) -> None:
    chosen = {"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 8, 16], **action}}
    theirs = stock(task)({"vehicles_count": 5, **chosen})
    own = interface(TASKS[task], resolve(task, TASKS[task].defaults, chosen))
    assert gym.spaces.Discrete(len(own.action_type.names)) == theirs.action_space
    assert own.action_type.names == theirs.action_type.actions
    assert list(own.action_type.target_speeds) == list(theirs.action_type.target_speeds)


@highway_env_task
def test_a_ladder_that_is_not_given_is_the_tasks(task: str, recwarn: pytest.WarningsRecorder) -> None:
    """highway-env falls back to the highway's, because it replaces the whole entry: a warning says so."""
    own, action = TASKS[task], {"type": "DiscreteMetaAction"}
    warn_once.cache_clear()
    for given in ({}, {"action": {**action, "target_speeds": [0, 1]}}):
        interface(own, resolve(task, own.defaults, given))
    assert not recwarn
    config = resolve(task, own.defaults, {"action": action})
    assert interface(own, config).action_type.target_speeds == own.target_speeds
    told = [str(one.message) for one in recwarn if "in highway-env (20.0, 25.0, 30.0)" in str(one.message)]
    assert len(told) == (own.target_speeds != SPEEDS)
    assert ENVIRONMENTS[task](config).vehicle.target_speeds.tolist() == list(own.target_speeds)


SPEEDS = (20.0, 25.0, 30.0)


def test_target_speeds_and_lanes_equal_highway_env_s() -> None:
    """Any sequence of actions, wherever on the road the vehicle is and however fast."""
    road = highway(4)
    theirs: Any = MDPVehicle(Road(RoadNetwork.straight_road_network(4)), [200.0, 4.0], speed=25.0)
    rng = np.random.default_rng(0)
    index, lane = theirs.speed_index, ("0", "1", 1)
    changed = 0
    for _ in range(500):
        name = str(rng.choice(["LANE_LEFT", "LANE_RIGHT", "FASTER", "SLOWER", "IDLE"]))
        theirs.speed = float(rng.uniform(15.0, 35.0))
        theirs.position = np.array([rng.uniform(100.0, 900.0), rng.uniform(-1.0, 13.0)])
        x, y = theirs.position.tolist()
        theirs.act(name)
        index = target_speed_index(name, index, theirs.speed, SPEEDS)
        before, lane = lane, target_lane(name, road, lane, ("0", "1"), x, y)
        changed += lane != before
        assert (index, lane) == (theirs.speed_index, theirs.target_lane_index), name
    assert changed > 50


def test_where_sumo_says_what_may_be_done_a_target_lane_of_another_road_is_the_present_one() -> None:
    place = Place(("b", "c", 1), True, False, (), 0.0)
    for name, before, after in (
        ("IDLE", ("a", "b", 0), ("b", "c", 1)),
        ("IDLE", ("b", "c", 0), ("b", "c", 0)),  # a lane change that has begun
        ("LANE_LEFT", ("a", "b", 0), ("b", "c", 0)),
        ("LANE_RIGHT", ("a", "b", 0), ("b", "c", 1)),  # which is not allowed
    ):
        assert lane_beside(name, place, before) == after


# -- how near vehicles are and will come, as features of the table ---------------------------------------------------

PLAIN = ("x", "y", "vx", "vy")
TABLE = {"type": "Kinematics", "vehicles_count": 8}
RAW = {**TABLE, "normalize": False, "features": ["presence", *PLAIN, *APPROACH]}


def expected(relative: np.ndarray) -> np.ndarray:
    """The features of rows (n, 4) of place and velocity, by projection on the direction of the velocity."""
    place, velocity = relative[:, 0] + 1j * relative[:, 1], relative[:, 2] + 1j * relative[:, 3]
    speed = np.abs(velocity)
    course = place * np.exp(-1j * np.angle(velocity))  # real: ahead along the velocity; imaginary: beside it
    time = np.clip(-course.real * speed / (speed**2 + 0.25), 0.0, 6.0)
    nearest = np.hypot(course.real + speed * time, course.imag)
    return np.column_stack([relative, np.abs(place), time, nearest])


def assert_told(table: np.ndarray, absolute: bool) -> None:
    """A table of RAW: the features are those of the places and velocities in its rows, and empty rows are empty."""
    there = table[:, 0] == 1.0
    assert not table[~there].any() and there[0]
    seen = table[there].astype(float)
    relative = seen[:, 1:5] - (seen[0, 1:5] if absolute else 0.0)
    relative[0] = 0.0
    np.testing.assert_allclose(seen[:, 5:], expected(relative), rtol=1e-4, atol=1e-3)  # places are float32


@pytest.mark.parametrize("absolute", [False, True])
@highway_env_task
def test_they_are_those_of_the_tables_rows_on_every_task(task: str, absolute: bool) -> None:
    """On SUMO; in highway-env's tables: above, and of the replica's kernels below."""
    env = DrivingEnv(task, {"observation": {**RAW, "absolute": absolute}, "risk": 1.0})
    for table in observations(env):
        assert_told(table, absolute)


@pytest.mark.parametrize(
    "keys", [{}, {"order": "shuffled", "absolute": True}, {"clip": False, "see_behind": True}]
)
@highway_env_task
def test_kernels_give_the_table_of_the_scene(task: str, keys: dict[str, Any]) -> None:
    """Its rows: of vehicles that are equally far along the lane, rounding decides which comes first."""
    config = {"observation": {**TABLE, "features": ["x", "sin_h", *APPROACH], **keys}}
    env: Any = gym.make(f"replica/{task}-v0", scenarios="seeded", config=config).unwrapped
    env.reset(seed=1)
    for action in np.random.default_rng(0).integers(env.action_space.n, size=8).tolist():
        by_kernel = env._observe()
        form, env.form = env.form, None
        apart = np.abs(by_kernel[:, None] - env._observe()).max(2)
        assert max(apart.min(0).max(), apart.min(1).max()) < 1e-6
        env.form = form
        env.step(action)


@needs_sumo
@pytest.mark.parametrize("absolute", [False, True])
def test_on_a_network_of_ones_own_they_are_along_the_axes_of_the_table(tmp_path, absolute: bool) -> None:
    config = {"observation": {**RAW, "absolute": absolute}}
    env = SumoDrivingEnv(written(tmp_path, "static"), ego_vehicle="ego", config=config)
    for table in observations(env):
        assert_told(table, absolute)


def test_they_are_scaled_as_other_features_with_ranges_of_their_own() -> None:
    """A configuration may have other ranges, or none; ranges of what is not named stay out of sight."""
    seen = ["presence", "dx", "tcpa"]
    usual = Kinematics({"features": seen}, 1)
    assert usual.ranges.items() >= {"dx": RANGES["dx"], "tcpa": RANGES["tcpa"]}.items()
    given = Kinematics({"features": seen, "features_range": {"dx": [-30, 30]}}, 1)
    assert given.ranges == {"dx": (-30.0, 30.0), "tcpa": RANGES["tcpa"]}
    assert not {*APPROACH} & {*Kinematics({}, 1).ranges}
    with pytest.raises(ConfigError, match="did you mean 'dcpa'"):
        Kinematics({"features": ["dcpq"]}, 1)
