"""Keys, names and methods of highway-env: what is here is as in highway-env, and of the rest it is said why not."""

import copy
import json
import math
import pickle
import warnings
from contextlib import closing, nullcontext
from functools import partial
from importlib import import_module
from operator import delitem, setitem
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import sumo_env
from sumo_env.config import COMMON, IGNORED, resolve, warn_once
from sumo_env.env import DrivingEnv
from sumo_env.envs import HighwayEnvFast
from sumo_env.envs.common.abstract import AbstractEnv
from sumo_env.replica.batch import reward_weights
from sumo_env.spaces.factory import interface
from sumo_env.tasks import TASKS
from tests.processes import python
from tests.sumo_env.parity import stock
from tests.tasks import OF_HIGHWAY_ENV, highway_env_task

CLASSES = tuple(getattr(sumo_env.envs, TASKS[task].reference) for task in OF_HIGHWAY_ENV)

TABLE = {"type": "Kinematics"}


# -- keys ----------------------------------------------------------------------------------------------------


@highway_env_task
def test_highway_env_ignores_what_is_ignored_here(task: str) -> None:
    """Its episode is the same with any values of these keys."""
    keys = IGNORED - TASKS[task].defaults.keys()
    few = {"vehicles_count": 5} if task == "highway" else {}
    ignored = dict.fromkeys(keys - few.keys(), 0.7)
    plain, given = (gym.make(f"{task}-v0", config={**few, **config}) for config in ({}, ignored))
    assert np.array_equal(plain.reset(seed=3)[0], given.reset(seed=3)[0])
    for action in (1, 0):
        ours, theirs = given.step(action), plain.step(action)
        assert np.array_equal(ours[0], theirs[0]) and ours[1:4] == theirs[1:4]


@highway_env_task
def test_keys_of_other_tasks_are_ignored_whatever_their_values(task: str) -> None:
    """Also by rewards and ends, here of a car that has left the road."""
    others = IGNORED.union(*(TASKS[other].defaults for other in OF_HIGHWAY_ENV))
    with closing(DrivingEnv(task)) as env:
        env.reset(seed=0)
        own, plain, car = env.task, env.config, env.ego_state._replace(on_road=False)
    terms = own.rewards(car, plain)
    for value in (None, "x", -1, math.nan, [1], False, True):
        given = dict.fromkeys(others - own.defaults.keys() - COMMON.keys(), value)
        config = resolve(task, own.defaults, given)
        assert config.items() >= given.items()
        assert (own.rewards(car, config), own.reward(terms, config)) == (terms, own.reward(terms, plain))
        assert own.terminated(car, config) == own.terminated(car, plain)
        assert interface(own, config) and reward_weights(own, config) == reward_weights(own, plain)


@pytest.mark.parametrize("id", ["sumo/highway-v0", "replica/highway-v0"])
def test_a_key_that_highway_env_ignores_is_ignored_and_said_once(id: str) -> None:
    warn_once.cache_clear()
    config = {"initial_spacing": 2, "speed_limit": 25, "road_length": 500.0, "vehicles_count": 5}
    with pytest.warns(UserWarning, match="has no effect on the task 'highway', as in highway-env") as caught:
        env: Any = gym.make(id, config=config).unwrapped
    assert len([one for one in caught if "no effect" in str(one.message)]) == 3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env.configure({"initial_spacing": 3})
    plain: Any = gym.make(id, config={"vehicles_count": 5}).unwrapped
    assert np.array_equal(env.reset(seed=1)[0], plain.reset(seed=1)[0])


def test_an_id_without_a_prefix_says_how_it_is_called_here() -> None:
    """Where highway-env is not installed; else the ids are its own."""
    lines = (
        "import sys",
        "sys.modules['highway_env'] = None",
        "import gymnasium, sumo_env",
        "try: gymnasium.make('highway-v0')",
        "except gymnasium.error.UnregisteredEnv as error: print(error)",
    )
    assert "use sumo/highway-v0" in python("-c", "\n".join(lines))
    assert not set(sumo_env.unsupported.NOT_HERE) & {f"{task}-v0" for task in OF_HIGHWAY_ENV}


@pytest.mark.parametrize(
    ("id", "config", "frames", "frequency"),
    [
        ("sumo/highway-v0", {"policy_frequency": 2, "simulation_frequency": 15}, 7, 15),
        ("sumo/highway-v0", {"policy_frequency": 15}, 1, 15),
        ("sumo/highway-v0", {"policy_frequency": 3}, 3, 10),
        # with steps of half a second, cars would pass through each other
        ("sumo/highway-v0", {"policy_frequency": 2, "simulation_frequency": 2}, 3, 6),
        ("sumo/highway-fast-v0", {"policy_frequency": 2}, 2, 5),
        ("replica/highway-v0", {"policy_frequency": 2}, 7, 15),
    ],
)
def test_a_policy_step_has_highway_envs_number_of_simulation_steps(
    id: str, config: dict[str, Any], frames: int, frequency: int
) -> None:
    """``int(simulation_frequency // policy_frequency)``; the time limit counts policy steps."""
    warn_once.cache_clear()
    is_even = frames * config["policy_frequency"] == frequency
    told = pytest.warns(UserWarning, match=f"lasts {frames / frequency:.3g} s, not")
    with nullcontext() if is_even else told:
        env: Any = gym.make(id, config={**config, "vehicles_count": 3, "duration": 2}).unwrapped
    env.reset(seed=0)
    before, info, steps, truncated = env.vehicle.speed, {}, 0, False
    while not truncated:
        _, _, _, truncated, info = env.step(3)
        steps += 1
        assert env.scene.time == pytest.approx(steps * frames / frequency, abs=1e-5)
        assert info["acceleration"] == pytest.approx((info["speed"] - before) * frequency / frames)
        before = info["speed"]
    assert steps == 2 * config["policy_frequency"] and env.time == pytest.approx(2.0)
    assert env.scenario.simulation_frequency == frequency


def test_the_fast_highway_is_the_highway_with_other_defaults() -> None:
    env: Any = gym.make(sumo_env.SUMO_FAST_ID).unwrapped
    theirs = gym.make("highway-fast-v0").unwrapped.config  # type: ignore[attr-defined]
    assert env.task.name == "highway" and "highway-fast" not in TASKS
    assert {key for key in theirs.keys() & env.config.keys() if env.config[key] != theirs[key]} <= {
        "action", "offscreen_rendering",
    }  # fmt: skip
    assert env.config == HighwayEnvFast().config
    envs = gym.make_vec(sumo_env.SUMO_FAST_ID, num_envs=1)
    assert np.array_equal(envs.reset(seed=3)[0][0], env.reset(seed=3)[0])
    envs.close()


@highway_env_task
def test_the_whole_configuration_of_highway_env_is_accepted(task: str, recwarn) -> None:
    """In silence, and what it says is what the environment then has."""
    theirs = stock(task).default_config()
    env = DrivingEnv(task, theirs)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    shared = theirs.keys() & env.config.keys()
    assert {key for key in shared if env.config[key] != theirs[key]} == set()
    env.step(1)
    assert [str(warning.message) for warning in recwarn] == []


def test_numbers_may_be_numpys() -> None:
    given = {"vehicles_count": np.int64(5), "risk": np.float32(0.5), "normalize_reward": np.bool_(False)}
    seen = {**TABLE, "vehicles_count": np.int32(3)}
    env = DrivingEnv("highway", {**given, "reward_speed_range": np.array([10.0, 20.0]), "observation": seen})
    assert env.reset(seed=0)[0].shape == (3, 5)
    json.dumps(env.config)


# -- subclasses ----------------------------------------------------------------------------------------------


def test_default_config_is_a_class_method_or_a_method() -> None:
    """Keys that it leaves out are the task's."""
    for made, task in zip(CLASSES, OF_HIGHWAY_ENV, strict=True):
        assert made.default_config() == made().default_config() == DrivingEnv(task).default_config()
        assert made().task is TASKS[task] and issubclass(made, AbstractEnv)
        mine = type("Mine", (made,), {"default_config": lambda _: {"duration": 7}})()
        assert mine.config == {**DrivingEnv(task).config, "duration": 7}


@pytest.mark.filterwarnings("error")
def test_an_id_that_is_not_here_may_be_registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(gym.registry, "sumo/parking-v0", gym.registry["sumo/parking-v0"])
    sumo_env.register("sumo/parking-v0", "u-turn")
    gym.make("sumo/parking-v0")


# -- what is read --------------------------------------------------------------------------------------------

VERSIONS = {"u-turn": 1, "roundabout": 1}  # with connected lanes
MODULES = ("road.lane", "road.road", "road.regulation", "vehicle.objects", "vehicle.kinematics", "vehicle.controller",
           "vehicle.behavior", "vehicle.dynamics", "envs.common.action", "envs.common.observation")  # fmt: skip
THEIR_CLASSES = {
    each
    for module in MODULES
    for each in vars(import_module(f"highway_env.{module}")).values()
    if isinstance(each, type) and each.__module__.startswith("highway_env.")
}


@highway_env_task
def test_what_is_read_of_the_replica_is_what_is_read_of_highway_env(task: str) -> None:
    id = f"{task}-v{VERSIONS.get(task, 0)}"
    # highway-env adds vehicles to its intersection after the observation, the replica before the next one
    configs = {"highway": {"vehicles_count": 12}, "intersection": {"spawn_probability": 0}}
    config = configs.get(task, {})
    theirs: Any = gym.make(id, config=config).unwrapped
    ours: Any = gym.make(f"replica/{id}", config=config).unwrapped
    theirs.reset(seed=4), ours.reset(seed=4)
    for action in (1, 2, 0, 1):
        alike(ours, theirs)
        if ours.step(action)[2] | theirs.step(action)[2]:
            break
    alike(ours, theirs)


STEERING, STEPS = {"type": "ContinuousAction"}, {"type": "DiscreteAction"}


@pytest.mark.parametrize("action", [STEERING, {**STEERING, "dynamical": True}, STEPS])
def test_a_steered_ego_is_of_highway_envs_class(action: dict[str, Any]) -> None:
    config = {"action": action, "vehicles_count": 2}
    ours, theirs = (one(id, config) for id in ("replica/highway-v0", "highway-v0"))
    ours.reset(seed=0), theirs.reset(seed=0)
    same_kind(ours.vehicle, theirs.vehicle)
    same_kind(ours.action_type, theirs.action_type)
    again = pickle.loads(pickle.dumps(copy.deepcopy(ours.vehicle)))
    assert type(again) is type(ours.vehicle) and repr(again) == repr(ours.vehicle)
    for view in (ours.action_type, ours.observation_type):
        assert copy.deepcopy(view).space() == copy.copy(view).space() == view.space()


def one(id: str, config: dict[str, Any]) -> Any:
    """An environment without wrappers."""
    return gym.make(id, config=config).unwrapped


def same_kind(own: Any, other: Any) -> None:
    """That ``isinstance`` with any class of highway-env answers the same of both."""
    for each in THEIR_CLASSES:
        assert isinstance(own, each) == isinstance(other, each), (own, each)


def alike(ours: Any, theirs: Any) -> None:
    """Compare everything that can be read of two environments in the same state."""
    for name in ("road", "observation_type", "action_type"):
        same_kind(getattr(ours, name), getattr(theirs, name))
    same_kind(ours.road.network, theirs.road.network)
    assert ours.time == pytest.approx(theirs.time)
    assert np.allclose(ours.observation_type.observe(), theirs.observation_type.observe(), atol=1e-5)
    assert ours.observation_type.space() == theirs.observation_type.space()
    assert ours.action_type.space() == theirs.action_type.space()
    assert ours.action_type.get_available_actions() == ours.get_available_actions()
    mine, yours = ours.road.network, theirs.road.network
    lanes = [(a, b, k) for a, ends in mine.graph.items() for b, row in ends.items() for k in range(len(row))]
    assert lanes == list(mine.lanes_dict()) == list(yours.lanes_dict())
    place, heading = theirs.vehicle.position, theirs.vehicle.heading
    for a, b in zip(mine.lanes_list(), yours.lanes_list(), strict=True):
        same_kind(a, b)
        for name in ("local_coordinates", "distance", "on_lane", "is_reachable_from", "after_end"):
            expected = getattr(b, name)(place)
            assert getattr(a, name)(place) == pytest.approx(expected, abs=1e-6), name
            assert getattr(a, name)(*place) == pytest.approx(expected, abs=1e-6), name
        found, expected = (
            (one.distance_with_heading(place, heading), one.length, one.width_at(0), one.heading_at(2.0))
            for one in (a, b)
        )
        assert found == pytest.approx(expected)
        assert a.position(3.0, 0.5) == pytest.approx(b.position(3.0, 0.5))
    here, there = ((*road.vehicles, *road.objects) for road in (ours.road, theirs.road))
    places = {tuple(np.round(vehicle.position, 4)): vehicle for vehicle in here}
    pairs = {id(vehicle): places[tuple(np.round(vehicle.position, 4))] for vehicle in there}
    pairs[id(None)] = None
    assert pairs[id(theirs.controlled_vehicles[0])] is ours.controlled_vehicles[0] is ours.vehicle
    for box in theirs.road.objects:
        same_kind(pairs[id(box)], box)
    for vehicle in theirs.road.vehicles:
        own = pairs[id(vehicle)]
        same_kind(own, vehicle)
        assert own.road is ours.road and own.lane == mine.get_lane(own.lane_index)
        assert own.lane_index == vehicle.lane_index
        assert own.target_speed == pytest.approx(vehicle.target_speed)
        assert own.lane_offset == pytest.approx(vehicle.lane_offset, abs=1e-6)
        assert own.to_dict(ours.vehicle) == pytest.approx(vehicle.to_dict(theirs.vehicle), abs=1e-5)
        for a, b in ((None, None), (ours.vehicle.lane, theirs.vehicle.lane)):
            distance = vehicle.lane_distance_to(theirs.vehicle, b)
            assert own.lane_distance_to(ours.vehicle, a) == pytest.approx(distance, abs=1e-6)
        assert mine.side_lanes(own.lane_index) == yours.side_lanes(vehicle.lane_index)
        for index in yours.all_side_lanes(vehicle.lane_index):
            expected = [pairs[id(each)] for each in theirs.road.neighbour_vehicles(vehicle, index)]
            assert list(ours.road.neighbour_vehicles(own, index)) == expected
        close = [pairs[id(each)] for each in theirs.road.close_vehicles_to(vehicle, 60.0, see_behind=False)]
        mine_too = ours.road.close_vehicles_to(own, 60.0, see_behind=False)
        assert set(mine_too) == set(close)  # two at the same distance may come in either order
        far, expected = ([abs(own.lane_distance_to(each)) for each in some] for some in (mine_too, close))
        assert far == pytest.approx(expected, abs=1e-6)
        assert ours.road.close_vehicles_to(own, 60.0, 2, see_behind=False) == mine_too[:2]


# What is read of an environment, and what is said of it; a page is named where a name of highway-env is not here.
READ = {
    "vehicle.positon": "did you mean 'position'",
    "vehicle.act": "deepcopy",
    "road.network.nothing": "docs/from-highway-env.md",
    "controled_vehicles": "did you mean 'controlled_vehicles'",
    "simplify": "docs/from-highway-env.md",  # as rl-agents does, which goes on without what is an AttributeError
}


def test_what_is_not_there_says_where_to_look_and_what_is_read_cannot_be_written() -> None:
    env = one("sumo/highway-v0", {"vehicles_count": 2})
    env.reset(seed=0)
    for name, word in READ.items():
        *way, last = name.split(".")
        part = env
        for each in way:
            part = getattr(part, each)
        with pytest.raises(AttributeError) as caught:
            getattr(part, last)
        assert word in str(caught.value) and caught.value.obj is None  # so that Python adds no guess
    vehicles, objects = env.road.vehicles, env.road.objects
    for write in (
        partial(setattr, env.vehicle, "speed", 30.0),
        partial(setattr, env.road, "vehicles", []),
        *(partial(setattr, env, name, None) for name in ("road", "vehicle", "controlled_vehicles", "time")),
        *(partial(setitem, some, 0, None) for some in (vehicles, objects)),
        *(partial(delitem, some, 0) for some in (vehicles, objects)),
        lambda: objects.append(env.vehicle),
    ):
        with pytest.raises(AttributeError, match="can only be read"):
            write()  # type: ignore[operator]
    with pytest.raises(ValueError, match="read-only"):
        env.vehicle.position[0] = 0.0
    with pytest.raises(AttributeError, match="own-parts"):
        env.road.vehicles.append(env.vehicle)

    env.close()
