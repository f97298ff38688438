"""What is refused: a row is what a user does, the type of the error, and the word in it that says what to do."""

import inspect
import math
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import sumo_env
from experiments.backends import make_env
from experiments.support.errors import UserError
from sumo_env import benchmark_scenarios, unsupported
from sumo_env.config import ConfigError
from sumo_env.env import DrivingEnv
from sumo_env.envs import HighwayEnv
from sumo_env.replica.env import ReplicaEnv
from sumo_env.replica.simulator import Replica
from sumo_env.scenarios import NetworkTask
from sumo_env.simulator import EgoCommand, SimulatorError
from sumo_env.sumo.user_options import check_copyable
from sumo_env.tasks.base import ego_driver, make_on_lane
from sumo_env.tasks.highway import Highway
from sumo_env.traffic.scenario import VehicleSpec
from tests.sumo_env.situations import drivers

META, PEDALS, GRID = {"type": "DiscreteMetaAction"}, {"type": "ContinuousAction"}, {"type": "OccupancyGrid"}
TABLE, STEPS = {"type": "Kinematics"}, {"type": "DiscreteAction"}
LIDAR = {"type": "LidarObservation"}


WEIGHTS = [0.3, 0.6, 0.1]
PICTURES = {"type": "GrayscaleObservation", "observation_shape": [9, 9], "stack_size": 1, "weights": WEIGHTS}
WRONG_PICTURES: dict[str, Any] = {"stack_size": 0, "observation_shape": [128.5, 64], "weights": [1.0]}
WRONG_PICTURES |= {"scaling": -1, "centering_position": [0.5]}


def acts(kind: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"action": {**kind, **more}}


def sees(kind: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"observation": {**kind, **more}}


def both(action: dict[str, Any], observation: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Tuples, of several learning cars."""
    cars = acts({"type": "MultiAgentAction"}, action_config=action)
    return {**cars, **sees({"type": "MultiAgentObservation"}, observation_config=observation), **more}


CONFIGS: list[tuple[str, Any, str]] = [
    ("sumo/highway", {"vehicle_count": 3}, "did you mean 'vehicles_count'"),
    ("sumo/highway", {"absolute": True}, "belongs in config['observation']"),
    ("sumo/highway", [("vehicles_count", 3)], "must be a dict"),
    ("sumo/highway", {"vehicles_count": "50"}, "a number"),
    ("sumo/highway", {"duration": 0}, "(0, 100000]"),
    ("sumo/highway", {"initial_lane_id": 4}, "'lanes_count'"),
    ("sumo/highway", {"policy_frequency": 16}, "'simulation_frequency' (15)"),
    ("sumo/highway", {"policy_frequency": 15, "simulation_frequency": 10}, "at least"),
    ("sumo/highway", {"normalize_reward": "yes"}, "True or False"),
    ("sumo/highway", {"centering_position": 0.3}, "2 numbers"),
    ("sumo/highway", {"ego_spacing": 1e9}, "not on route"),
    ("sumo/highway", {"reward_speed_range": [0, 0]}, "two different speeds"),
    ("sumo/highway", {"collision_reward": 0.5}, "cannot be normalised"),
    ("sumo/highway", {"other_vehicles_type": "highway_env.vehicle.behavior.LinearVehicle"}, "SUMO drives"),
    ("sumo/highway", {"drivers": "human"}, "known: highway-env, measured"),
    ("sumo/highway", {"manual_control": True}, "render_mode='human'"),
    ("sumo/highway", {"controlled_vehicles": 3}, "sumo_env.parallel_env"),
    ("sumo/two-way", {"road_length": 5000.0}, "road_length"),
    ("sumo/two-way", {"vehicles_count": 500}, "do not fit"),
    ("sumo/u-turn", {"vehicles_count": 13}, "at most 12"),
    ("sumo/roundabout", {"incoming_vehicle_destination": 5}, "0, 1 or 2"),
    ("sumo/intersection", {"destination": "o9"}, "'o1', 'o2', 'o3' or None"),
    ("replica/two-way", {"risk": 1.0}, 'scenarios="seeded"'),
    ("replica/highway", {"drivers": "measured"}, "for sumo"),
    # observations
    ("sumo/highway", {"observation": "Kinematics"}, "must be a dict"),
    ("sumo/highway", {"observation": {"vehicles_count": 3}}, "'type'"),
    ("sumo/highway", sees({"type": "Kinematic"}), "did you mean 'Kinematics'"),
    ("sumo/highway", sees(TABLE, features=["presense"]), "mean 'presence'"),
    ("sumo/highway", sees(TABLE, features=["lane_end"]), "lane_end"),
    ("sumo/highway", sees(TABLE, features=object), "list of names"),
    ("sumo/highway", sees(TABLE, order="random"), "shuffled, sorted"),
    ("sumo/highway", sees(TABLE, features_range={"vx": [0, 0]}), "rising [low, high]"),
    ("sumo/highway", sees(TABLE, features_range={"x": [100, -100]}), "rising [low, high]"),
    ("sumo/highway", sees({"type": "AttributesObservation"}), "ObservationWrapper"),
    ("sumo/highway", acts(META, target_speeds=[]), "two rising numbers, not []"),
    ("sumo/highway", {"screen_width": 600.5}, "whole number from 1 to 10000, not 600.5"),
    ("sumo/highway", sees(TABLE, features_range={"speed": [0, 1]}), "'speed'"),
    ("sumo/highway", sees({"type": "KinematicsGoal"}), "not here"),
    ("sumo/highway", sees({"type": "ExitObservation"}), "the road 'highway' has none"),
    ("sumo/highway", sees(LIDAR, cells=0), "'cells'"),
    ("sumo/u-turn", sees(GRID, features=["speed"]), "'speed'"),
    ("sumo/u-turn", sees(GRID, absolute=True), "'absolute'"),
    ("sumo/u-turn", sees(GRID, grid_size=[[-5, 5]]), "'grid_size'"),
    ("sumo/u-turn", sees(GRID, grid_step=[1e-9, 5]), "1 to 1000 cells"),
    ("sumo/u-turn", sees(GRID, features_range={"vx": [3]}), "'features_range'"),
    *(("sumo/highway", sees(PICTURES, **{key: value}), key) for key, value in WRONG_PICTURES.items()),
    # actions
    ("sumo/highway", acts(META, target_speeds=[-5, 0, 5]), "replica/*"),
    ("sumo/highway", acts(META, longitudinal=False, lateral=False), "lateral or both"),
    ("sumo/highway", acts(META, lateral="SUMO"), "True or False"),
    ("sumo/highway", acts(PEDALS, steering_range=[-0.1, 0.1]), "replica/*"),
    ("sumo/highway", acts(PEDALS, dynamical=True), "replica/*"),
    ("replica/highway", acts(META, lateral="sumo"), "SUMO drives nothing on the replica"),
    ("replica/highway", acts(PEDALS, steering_range=[0.1]), "two rising numbers"),
    ("replica/highway", acts(STEPS, actions_per_axis=2.5), "a whole"),
    ("replica/highway", {**acts(PEDALS), **sees({"type": "TimeToCollision"})}, "target speeds"),
    # several learning cars
    ("sumo/intersection", {"controlled_vehicles": 2}, "MultiAgentAction"),
    ("sumo/intersection", both(META, TABLE, controlled_vehicles=9), "at most 4"),
    ("replica/roundabout", acts({"type": "MultiAgentAction"}), "'action_config'"),
]  # fmt: skip


@pytest.mark.parametrize(("id", "config", "word"), CONFIGS, ids=str)
def test_a_configuration_is_refused(id: str, config: Any, word: str) -> None:
    """In one line."""
    with pytest.raises(ConfigError) as caught:
        gym.make(f"{id}-v0", config=config).reset(seed=0)
    assert word in str(caught.value) and "\n" not in str(caught.value)


OPTIONS: list[tuple[dict[str, Any], str]] = [
    ({"risk_rate": {"cut_in": 0.1}}, "'risk_rates', 'risk_ranges'"),
    ({"risk_rates": {"cutin": 0.1}}, "some of cut_in, brake"),
    ({"risk_rates": {"cut_in": 0.3}}, "no effect at risk 0"),
    ({"risk_ranges": {"tau": 5}}, "two rising numbers in (0, 1000]"),
    ({"risk_ranges": {"not_giving_way": [0, 1]}}, "a number"),
    ({"calibration": {"tau": math.nan}}, "a number"),
    ({"calibration": {"lane_changes": 2}}, "True or False"),
    ({"calibration": {"ignores_inside": 1.5}}, "[0, 1]"),
    ({"calibration": {"tau": 2.0}, "scenario": None}, "either 'scenario' or"),
    ({"scenario": 3}, "a Scenario"),
    ({"event_factor": 2.0}, "given together, as numbers: not {'event_factor': 2.0}"),
    ({"event_factor": "2", "event_reach": 30.0}, "as numbers"),
    ({"event_factor": 0.5, "event_reach": 30.0}, "from 1 on"),
    ({"event_factor": math.nan, "event_reach": 30.0}, "from 1 on"),
    ({"event_factor": 1e9, "event_reach": 30.0, "config": {"risk": 1.0}}, "at most 1000 events"),
    ({"event_factor": 2.0, "event_reach": 0.0}, "above 0 m"),
    ({"event_factor": 2.0, "event_reach": 30.0, "scenario": None}, "either 'scenario' or"),
]


@pytest.fixture(scope="module")
def highway() -> Any:
    return DrivingEnv("highway", {"vehicles_count": 10})


@pytest.mark.parametrize(("options", "word"), OPTIONS, ids=str)
def test_an_option_of_reset_is_refused(highway: DrivingEnv, options: dict[str, Any], word: str) -> None:
    with pytest.raises(ConfigError) as caught:
        highway.reset(seed=0, options=options)
    assert word in str(caught.value)


ACTIONS: list[tuple[str, dict[str, Any], list[Any]]] = [
    ("sumo/highway-v0", META, [5, -1, 0.5, None, [0, 0]]),
    ("replica/highway-v0", PEDALS, [1, [0.1], [0.1, math.inf], ["a", "b"]]),
    ("replica/highway-v0", STEPS, [9, -1, 0.5]),
]
BATCHES: list[tuple[str, dict[str, Any], list[Any]]] = [
    ("sumo/highway-v0", META, [[0], [0, 5], [0, -1], [[0, 0]], [0.5, 0.5], None]),
    ("sumo/highway-v0", PEDALS, [np.zeros(2)]),
    ("replica/highway-v0", META, [[1], [1, 5], [1.0, 1.0], [[1, 1]]]),
    ("replica/highway-v0", PEDALS, [[[0.0, 0.0]], [0.0, 0.0], [[0.0, math.nan], [0.0, 0.0]]]),
]


@pytest.mark.parametrize(("id", "kind", "actions"), ACTIONS, ids=str)
def test_what_is_no_action_is_refused(id: str, kind: dict[str, Any], actions: list[Any]) -> None:
    env = gym.make(id, config=acts(kind)).unwrapped
    env.reset(seed=0)
    for action in actions:
        with pytest.raises(ValueError, match="action must be"):
            env.step(action)
    env.step(env.action_space.sample())  # unharmed


@pytest.mark.parametrize(("id", "kind", "actions"), BATCHES, ids=str)
def test_what_is_no_action_of_a_batch_is_refused(id: str, kind: dict[str, Any], actions: list[Any]) -> None:
    envs = gym.make_vec(id, num_envs=2, config=acts(kind))
    envs.reset(seed=0)
    for action in actions:
        with pytest.raises(ValueError, match=r"2 of (Discrete|Box)|finite numbers"):
            envs.step(action)
    envs.step(envs.action_space.sample())


class Twice(Highway):
    """All vehicles have one id."""

    def __init__(self, id: str) -> None:
        self.id = id

    def vehicles(self, *arguments: Any) -> list[Any]:
        return [VehicleSpec._replace(spec, id=self.id) for spec in super().vehicles(*arguments)]


def attributes(**given: object) -> Callable[[], Any]:
    """A vehicle type with these attributes of SUMO's."""
    return lambda: drivers("highway", 0.0)[0].like("odd", given)


def nowhere() -> None:
    make_on_lane((task := Highway()).road(task.defaults), "ego", ("0", "1", 9), 1.0, 9.0, ego_driver(task))


def closed() -> None:
    env: Any = make_env("replica", "u-turn", {}).unwrapped
    env.reset(seed=0)
    env._car.episode.simulator.close()
    env._car.episode.simulator.step({"ego": EgoCommand(20.0, None)})


def overriding(name: str) -> Callable[[], Any]:
    """A subclass with a method of highway-env's that nothing would ever call."""
    return lambda: type("Mine", (type("Mixin", (), {name: print}), HighwayEnv), {})()


def answering(name: str, value: Any) -> Callable[[], Any]:
    """A subclass whose method returns this."""

    def drive() -> None:
        env: Any = type("Mine", (HighwayEnv,), {name: lambda self, *_: value})()
        env.reset(seed=0)
        env.step(1)

    return drive


def lacking(key: str) -> DrivingEnv:
    """A task whose defaults lack a key that every task has."""
    defaults = {name: value for name, value in Highway.defaults.items() if name != key}
    return DrivingEnv(type("Mine", (Highway,), {"name": "mine", "defaults": defaults})())


def closed_batch(id: str) -> Callable[[], Any]:
    def drive() -> None:
        (envs := gym.make_vec(id, 1)).close()
        envs.reset(seed=0)

    return drive


def of_sumo(*options: Any, task: Any = "highway") -> Callable[[], Any]:
    return lambda: DrivingEnv(task, sumo_options=list(options)).reset(seed=0)


OWN = ("--step-length=0.5", "--lanechange.duration=2", "--time-to-teleport=60", "--lateral-resolution=0.8")
FOR_FILES = ["--scale=2", "--random-depart-offset=5", "--max-num-vehicles=3", "--random"]
FOR_FILES += ["--default.action-step-length=1"]
NO_COPIES = ("threads", "fcd-output", "save-state.times", "additional-files")
fleet = partial(partial, sumo_env.parallel_env)
replica, batch = partial(gym.make, "replica/roundabout-v0"), partial(gym.make_vec, "replica/highway-v0", 2)
CALLS: list[tuple[Callable[[], Any], type[Exception], str]] = [
    *((partial(make, f"{room}/highway-v0", risk=1.0), TypeError, "set by config")
      for make in (gym.make, gym.make_vec) for room in ("sumo", "replica")),
    (partial(gym.make_vec, "sumo/highway-v0", sumo_options=["-v"]), TypeError, "single environments on SUMO"),
    (partial(gym.make_vec, "sumo/highway-v0", 0), ValueError, "num_envs"),
    (partial(gym.make, "sumo/highway-v0", variant="v0"), TypeError, "replica/*"),
    (lambda: DrivingEnv("highway", render_mode="ansi"), ValueError, "rgb_array"),
    (lambda: DrivingEnv("highway").step(1), gym.error.ResetNeeded, "reset"),
    (lambda: DrivingEnv("highway").imagine(0), gym.error.ResetNeeded, "reset"),
    (lambda: DrivingEnv("highway").export("/nowhere"), gym.error.ResetNeeded, "reset"),
    (lambda: DrivingEnv("highway").hand_over(), gym.error.ResetNeeded, "reset"),
    (lambda: DrivingEnv("highway").reset(options="risk"), ConfigError, "a dict"),  # type: ignore[arg-type]
    (lambda: DrivingEnv("highway", sumo_options={"--scale": "2"}), ConfigError, "list of strings"),  # type: ignore[arg-type]
    (lambda: DrivingEnv({"risk": 1.0}), ConfigError, "'highway'"),  # type: ignore[arg-type]
    (lambda: DrivingEnv("highway").unwrapped.seed(0), AttributeError, "reset(seed"),  # type: ignore[attr-defined]
    (lambda: benchmark_scenarios("highway"), ConfigError, "list of names"),
    *((partial(gym.make_vec, f"{room}/highway-v0", number), ConfigError, "num_envs")  # type: ignore[arg-type]
      for room in ("sumo", "replica") for number in ("2", 2.5)),
    *((closed_batch(f"{room}/highway-v0"), gym.error.ClosedEnvironmentError, "closed") for room in ("sumo", "replica")),
    (lambda: DrivingEnv("highway", live="netedit"), ConfigError, "'sumo-gui'"),
    (lambda: DrivingEnv("highway", simulator=Replica(), sumo_options=["-v"]), ValueError, "`simulator`"),
    (lambda: DrivingEnv("highway", acts({"type": "MultiAgentAction"})), ConfigError, "sumo_env.parallel_env"),
    (lambda: make_env("replica", "uturn", {}), UserError, "unknown task"),
    (lambda: make_env("replca", "u-turn"), UserError, "did you mean 'replica'"),
    (lambda: sumo_env.HighwayEnv, AttributeError, "sumo_env.envs"),
    (lambda: sumo_env.parallel_env("highway", {"controlled_vehicles": 2}).vehicle, AttributeError, "env.cars[agent]"),
    (lambda: gym.make_vec("replica/highway-v0", 1).render(), AttributeError, "sync"),
    (lambda: sumo_env.paralel_env, AttributeError, "'parallel_env'"),
    (lambda: sumo_env.parallel_env("town.net.xml", ["town.rou.xml"]), ConfigError, "routes=[FILE]"),
    # subclasses
    *((answering(name, None), TypeError, name) for name in ("_reward", "_rewards", "_info", "default_config")),
    (answering("__init__", None), AttributeError, "super().__init__()"),
    *((partial(gym.make, id), gym.error.UnregisteredEnv, "docs/from-highway-env.md") for id in unsupported.NOT_HERE),
    *((overriding(name), TypeError, "docs/from-highway-env.md#subclasses") for name in unsupported.NEVER_CALLED),
    # tasks of a user's own
    (lambda: DrivingEnv(Twice("v0")).reset(seed=0), ConfigError, "are called 'v0'"),
    (nowhere, ConfigError, "no lane ('0', '1', 9)"),
    *((partial(lacking, key), ConfigError, key) for key in ("action", "duration", "observation")),
    (lambda: DrivingEnv(type("Mine", (NetworkTask,), {"__init__": lambda self: None})()), AttributeError, "super()"),
    (lambda: DrivingEnv(Highway), ConfigError, "Highway()"),  # type: ignore[arg-type]
    (lambda: sumo_env.register("test/class-v0", Highway), TypeError, "Highway()"),
    (lambda: sumo_env.register("test/class-v0", ReplicaEnv), TypeError, "gym.register"),
    (lambda: sumo_env.register("highway", "test/swapped-v0"), ConfigError, "unknown task"),
    (attributes(acell=2.0), ValueError, "'accel'"),
    (attributes(zzz=2.0), ValueError, "see https"),
    (attributes(carFollowModel="W98"), ValueError, "'W99'"),
    (attributes(speedFactor=2.0), ValueError, "no effect"),
    (attributes(length=200.0), ValueError, "length"),
    (attributes(accel=-1), ValueError, "accel of 'odd' has to be above 0"),
    (attributes(vClass="lorry"), ValueError, "no vClass"),
    # options of SUMO
    (of_sumo("--net-file", "x.net.xml"), ConfigError, "SumoDrivingEnv"),
    *((of_sumo(option), ConfigError, "the environment's own") for option in OWN),
    (of_sumo(3), ConfigError, "list of strings"),
    (of_sumo("--tripinfo-output"), ConfigError, "needs a file"),
    (of_sumo("--scale=2", task=Twice("v0")), ConfigError, "no effect here"),
    *((of_sumo(option), ConfigError, "no effect here") for option in FOR_FILES),
    (of_sumo("--seed", "7"), ConfigError, "seed of reset()"),
    *((partial(check_copyable, [option]), TypeError, "cannot be copied") for option in NO_COPIES),
    (of_sumo("--tripinfo-outptu", "trips.xml"), SimulatorError, "--tripinfo-outptu"),
    # the replica
    (partial(replica, scenarios="stock"), ConfigError, "'stock'"),
    (partial(replica, variant="paths"), ConfigError, "did you mean 'path'"),
    (partial(replica, live="sumo-gui"), TypeError, "on SUMO"),
    (lambda: replica().unwrapped.hand_over(), ConfigError, "SUMO drives nothing"),  # type: ignore[attr-defined]
    (lambda: ReplicaEnv("u-turn", version=3), ConfigError, "no version 3"),
    (lambda: Replica().step({"ego": EgoCommand(20.0, None)}), RuntimeError, "reset"),
    (closed, RuntimeError, "reset"),
    (partial(batch, vehicles_count=3), TypeError, "'vehicles_count'"),
    (partial(batch, threads=0), ValueError, "threads"),
    (lambda: batch().envs, AttributeError, "vectorization_mode"),  # type: ignore[attr-defined]
    *((lambda seed=seed: replica().unwrapped.imagine(seed), ConfigError, "whole") for seed in ("a", -1)),  # type: ignore[attr-defined]
    # several learning cars
    (fleet("CartPole-v1"), ConfigError, "not an environment of sumo_env"),
    (fleet("replica/highway-v0", remove_crashed=True), ConfigError, "crashed cars stay"),
    (fleet("sumo/highway-v0", controlled_vehicles=2), TypeError, "set by config"),
    (fleet("sumo/highway-v0", vehicles=["a"]), TypeError, "SUMO's files"),
    *((lambda actions=actions: fleet("sumo/highway-v0")().step(actions), ValueError, "reset()")  # type: ignore[call-arg]
      for actions in ({"car_0": 1}, [1])),
    (lambda: fleet("sumo/highway-v0")().action_space("car_9"), ConfigError, "'car_0'"),  # type: ignore[call-arg]
    (fleet("sumo/highway-v0", output_dir="out"), ConfigError, "output_dir"),
    (fleet("sumo/highway-v0", {"manual_control": True}), ConfigError, "'manual_control'"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "error", "word"), CALLS, ids=[f"{k}-{row[2]}" for k, row in enumerate(CALLS)]
)
def test_a_call_is_refused(call: Callable[[], Any], error: type[Exception], word: str) -> None:
    with pytest.raises(error) as caught:
        made = call()
        made.reset(seed=0)
    assert word in str(caught.value)


def test_pettingzoo_is_needed_by_the_call_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not by what looks at all names of the package, as ``help`` does."""
    monkeypatch.delitem(sys.modules, "sumo_env.parallel", raising=False)
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    with pytest.raises(ModuleNotFoundError, match="pip install pettingzoo"):
        dict(inspect.getmembers(sumo_env))["parallel_env"]("sumo/highway-v0")
