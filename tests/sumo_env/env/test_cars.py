"""Several learning cars: PettingZoo's environments, tuples as in highway-env, and one car alone."""

from dataclasses import asdict
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import sumo_env
from sumo_env.config import ConfigError
from sumo_env.contacts.crash import CrashDetector, record
from sumo_env.env import DrivingEnv
from sumo_env.sumo.learning_car import Car
from sumo_env.tasks import get_task
from sumo_env.traffic.scenario import car_id
from tests.sumo_env.rollout import mismatch

pytest.importorskip("pettingzoo")
from pettingzoo.test import parallel_api_test, parallel_seed_test

MOST = {"highway": 3, "two-way": 2, "roundabout": 5, "intersection": 4, "u-turn": 3}


def several(kind: str, task: str, count: int, **keywords: Any) -> Any:
    return sumo_env.parallel_env(f"{kind}/{task}-v0", {"controlled_vehicles": count}, **keywords)


def driven(env: Any, seed: int, most: int = 100) -> list[Any]:
    """An episode of actions that the seed draws."""
    rng, found = np.random.default_rng(seed), [env.reset(seed=seed)]
    while env.agents and len(found) < most:
        actions = {agent: int(rng.integers(env.action_space(agent).n)) for agent in env.agents}
        found.append(env.step(actions))
    return found


@pytest.mark.parametrize("kind", ["sumo", "replica"])
@pytest.mark.parametrize("task", MOST)
def test_petting_zoo_accepts_all_tasks_and_seeds_decide_on_episodes(kind: str, task: str) -> None:
    parallel_api_test(several(kind, task, MOST[task]), num_cycles=15)
    if kind == "sumo":
        parallel_seed_test(lambda: several(kind, task, 2), num_cycles=10)


@pytest.mark.parametrize("kind", ["sumo", "replica"])
@pytest.mark.parametrize("task", MOST)
def test_one_car_alone_is_the_single_environment_to_the_bit(kind: str, task: str) -> None:
    env: Any = several(kind, task, 1)
    single: Any = gym.make(f"{kind}/{task}-v0")
    found, rng = driven(env, 3), np.random.default_rng(3)
    env.close()
    observation, info = single.reset(seed=3)
    assert found[0][0]["car_0"].tobytes() == observation.tobytes()
    assert repr(found[0][1]["car_0"]) == repr(info)
    for step in found[1:]:
        observation, *rest = single.step(int(rng.integers(single.action_space.n)))
        assert step[0]["car_0"].tobytes() == observation.tobytes()
        assert repr([part["car_0"] for part in step[1:]]) == repr(rest)
    assert rest[1] or rest[2]


@pytest.mark.parametrize("task", MOST)
def test_a_scenario_with_two_cars_has_the_same_traffic(task: str) -> None:
    config = DrivingEnv(task, {"risk": 1.0}).config
    one, two = (get_task(task).scenario({**config, "controlled_vehicles": count}, 5) for count in (1, 2))
    others = [spec for spec in two.vehicles if spec.id not in two.further]
    assert [spec.id for spec in two.cars] == [car_id(0), car_id(1)] and two.ego == one.ego
    assert (two.spawns, two.events) == (one.spawns, one.events)
    if task == "highway":  # highway-env places a car between two halves of the traffic
        half, shift = len(others) // 2, others[-1].s - one.vehicles[-1].s
        assert two.vehicles[half].id == car_id(1) and shift > 0.0
        assert others[:half] == list(one.vehicles[:half])
        assert [spec.s for spec in others[half:]] == pytest.approx([v.s + shift for v in one.vehicles[half:]])
        assert [spec.lane for spec in others] == [spec.lane for spec in one.vehicles]
    else:
        assert others == list(one.vehicles)


def test_a_vehicle_that_matters_to_one_of_the_cars_is_simulated() -> None:
    config = {**DrivingEnv("highway", {"vehicles_count": 100, "duration": 5}).config}
    one, two = (get_task("highway").scenario({**config, "controlled_vehicles": count}, 0) for count in (1, 2))
    furthest = [max(spec.s for spec in drawn.vehicles if spec.concerns_ego) for drawn in (one, two)]
    assert furthest[1] > furthest[0] + 500.0 and not all(spec.concerns_ego for spec in one.vehicles)
    three = get_task("highway").scenario({**config, "controlled_vehicles": 3}, 0)
    assert np.diff([spec.s for spec in three.specs]).min() > 5.0  # each is ahead of the one before it


def test_two_cars_that_touch_have_both_crashed() -> None:
    """On the u-turn two cars start side by side; one changes to the lane of the other."""
    env = sumo_env.parallel_env("sumo/u-turn-v0", {"controlled_vehicles": 2, "vehicles_count": 0})
    env.reset(seed=0)
    for _ in range(10):
        *_, infos = env.step({"car_0": 2, "car_1": 0})
        if not env.agents:
            break
    assert [infos[agent]["crash"]["other"] for agent in infos] == [car_id(1), car_id(0)]
    assert [infos[agent]["crashed"] for agent in infos] == [True, True]
    assert env.agents == []
    assert mismatch(*(info["crash"] for info in infos.values())) == []


def test_one_contact_has_one_name_though_the_cars_see_it_at_an_angle() -> None:
    rng, otherwise = np.random.default_rng(0), 0
    for x, y, turn in rng.uniform((-4, -2, -0.7), (4, 2, 0.7), (50, 3)).tolist():
        one, other, car = (0.0, 0.0, 9.0, 0.0), (x, y, 5.0, turn), object.__new__(Car)
        vehicle = SimpleNamespace(crashed=False, crash=lambda speed: None)
        car.ego, car._detector = SimpleNamespace(vehicle=vehicle, speed=5.0), CrashDetector()
        crash = record(one, other, car_id(1), 1.0, "geometry")
        hit: Any = SimpleNamespace(name=car_id(0), _detector=SimpleNamespace(contact=(one, other)))
        car.be_hit(hit, crash)
        assert mismatch(asdict(crash), asdict(car._detector.crash)) == []
        otherwise += record(other, one, car_id(0), 1.0, "geometry").type != crash.type
    assert otherwise > 3


@pytest.mark.parametrize("removes", [False, True])
def test_a_crashed_car_leaves_the_agents_and_with_remove_crashed_the_road(removes: bool) -> None:
    env = several("sumo", "two-way", 2, remove_crashed=removes)
    for seed in range(20):
        env.reset(seed=seed)
        while len(env.agents) == 2:  # the first car drives into the cars ahead
            env.step({"car_0": 3, "car_1": 4})
        if env.agents == ["car_1"]:
            break
    assert env.cars["car_0"].ego_state.crashed
    env.step({"car_1": 4})
    scene = env.cars["car_1"].scene
    assert (car_id(0) in scene.ids, scene.cars) == ((False, 1) if removes else (True, 2))
    assert scene.ids[0] == car_id(1) and env.cars["car_0"].scene.time == scene.time


def test_on_the_replica_cars_are_paid_as_the_first_one_and_leave_with_it_or_by_a_crash() -> None:
    env, crashed = several("replica", "highway", 2), set[str]()
    for seed in range(20):
        env.reset(seed=seed)
        while len(env.agents) == 2 and "car_1" not in crashed:
            _, rewards, ends, _, infos = env.step({"car_0": 1, "car_1": 3})
            crashed = {agent for agent in ends if env.cars[agent].ego_state.crashed}
            assert ends == {agent: "car_0" in crashed or agent in crashed for agent in ends}
            assert len({*rewards.values()}) == 1
    assert crashed == {"car_1"} and 0.0 < infos["car_1"]["min_ttc_before_contact"] < 1.0


def test_the_first_rows_of_a_scene_are_the_cars() -> None:
    env = several("sumo", "highway", 3)
    env.reset(seed=0)
    scene = env.cars["car_0"].scene
    assert scene.ids[: scene.cars] == tuple(map(car_id, range(3)))
    seen = scene.seen_by(car_id(2))
    assert seen.ids[:3] == (car_id(2), car_id(0), car_id(1)) and seen.ids[3:] == scene.ids[3:]
    assert seen.x[0] == scene.x[2] and sorted(seen.x) == sorted(scene.x)
    with pytest.raises(KeyError):
        scene.seen_by("v0")
    for agent, name in env.ids.items():  # every car's environment can ask their SUMO
        assert env.cars[agent].sumo.vehicle.getPosition(name)[1] == -env.cars[agent].scene.y[0]


# -- tuples --------------------------------------------------------------------------------------------------------


def tuples(action: dict[str, Any], observation: dict[str, Any], **keys: Any) -> dict[str, Any]:
    return {
        "action": {"type": "MultiAgentAction", "action_config": action},
        "observation": {"type": "MultiAgentObservation", "observation_config": observation},
        **keys,
    }


META, CONTINUOUS, SEEN = {"type": "DiscreteMetaAction"}, {"type": "ContinuousAction"}, {"type": "Kinematics"}
# who is steered follows no route, so that its neighbours see no destination
FEATURES = ["presence", "x", "y", "cos_d", "sin_d"]
DESTINATIONS = {"type": "OccupancyGrid", "features": FEATURES, "grid_size": [[-50, 50], [-50, 50]]}
ENDS = {"offroad_terminal": True}
LADDER = {**META, "lateral": False, "target_speeds": [0, 4.5, 9]}
# [m/s] highway-env's steering divides by the speed: the rounding of a car that hardly moves grows
STANDING = 0.2
CASES = {
    "highway": ("highway-v0", tuples(META, SEEN, controlled_vehicles=3, vehicles_count=20)),
    "highway-fast": ("highway-fast-v0", tuples(META, SEEN, controlled_vehicles=2)),
    "pedals": ("highway-v0", tuples(CONTINUOUS, SEEN, controlled_vehicles=2, vehicles_count=8)),
    "grid": ("highway-v0", tuples({"type": "DiscreteAction"}, SEEN, controlled_vehicles=2, vehicles_count=8)),
    "four arms": ("intersection-v0", tuples(LADDER, SEEN, controlled_vehicles=4, destination=None)),
    "destinations": ("intersection-v0", tuples(CONTINUOUS, DESTINATIONS, controlled_vehicles=3, **ENDS)),
    "intersection": ("intersection-multi-agent-v0", None),
    "each its own": ("intersection-multi-agent-v1", None),
    "connected": ("intersection-multi-agent-v2", None),
}


@pytest.mark.parametrize("case", CASES)
def test_the_replica_is_highway_env_with_several_cars(case: str) -> None:
    """Same seed, same episode: positions, observations, rewards and ends."""
    highway_env = pytest.importorskip("highway_env")
    gym.register_envs(highway_env)
    id, config = CASES[case]
    keywords: Any = {"disable_env_checker": True} | ({} if config is None else {"config": config})
    both: list[Any] = [gym.make(f"{room}{id}", **keywords) for room in ("", "replica/")]
    ours = both[1]
    compared = 0
    for seed in range(15):
        if compared >= 10:
            break
        found: list[Any] = [env.reset(seed=seed) for env in both]
        ours.action_space.seed(seed)
        is_over = False
        while not is_over:
            cars: list[Any] = [env.unwrapped.controlled_vehicles for env in both]
            if min(car.speed for car in cars[0]) < STANDING:
                break
            there, here = ([car.position for car in one] for one in cars)
            np.testing.assert_allclose(there, here, atol=1e-6)
            for one, other in zip(found[0][0], found[1][0], strict=True):
                np.testing.assert_allclose(one, other, atol=1e-5)
            for key in ("agents_rewards", "agents_terminated"):
                if key in found[0][-1]:
                    assert found[0][-1][key] == pytest.approx(found[1][-1][key], abs=1e-6)
            action = ours.action_space.sample()
            found = [env.step(action) for env in both]
            assert found[0][1] == pytest.approx(found[1][1], abs=1e-6)
            assert found[0][2:4] == found[1][2:4]
            is_over, compared = bool(np.all(found[0][2])) or found[0][3], compared + 1
    assert compared >= 10


@pytest.mark.parametrize("id", ["highway-v0", "intersection-v0"])
def test_available_actions_of_tuples_are_tuples(id: str) -> None:
    """``MultiAgentAction.get_available_actions``: the product of what each car could do now, in its order."""
    config = tuples({**META, "target_speeds": [0, 5, 10]}, SEEN, controlled_vehicles=2)
    specs = [gym.spec(f"{room}{id}") for room in ("replica/", "")]
    envs: list[Any] = [gym.make(spec, disable_env_checker=True, config=config) for spec in specs]
    for seed in range(3):
        for env in envs:
            env.reset(seed=seed)
        ours, theirs = (list(env.unwrapped.get_available_actions()) for env in envs)
        assert ours == theirs and len(ours) > 1


@pytest.mark.parametrize("task", ["highway", "intersection"])
def test_on_sumo_actions_and_observations_are_tuples_as_well(task: str) -> None:
    action = {**META, "lateral": task == "highway"}
    env = gym.make(f"sumo/{task}-v0", config=tuples(action, SEEN, controlled_vehicles=2))
    observation, info = env.reset(seed=0)
    assert env.observation_space.contains(observation) and len(info["agents_rewards"]) == 2
    observation, reward, *_, info = env.step((1, 1))
    rewards = info["agents_rewards"]
    assert reward == pytest.approx(rewards[0] if task == "highway" else np.mean(rewards))
    with pytest.raises(ValueError, match="2 learning cars need a tuple of 2 actions"):
        env.unwrapped.step((1,))
    with pytest.raises(ConfigError, match="'controlled_vehicles' cannot"):
        env.reset(options={"config": {"controlled_vehicles": 3}})


@pytest.mark.parametrize("version", [0, 1])
def test_on_sumo_highway_env_s_intersection_with_two_cars_has_its_spaces_and_its_ends(version: int) -> None:
    """The first version has a reward for both cars, the second one for each."""
    gym.register_envs(pytest.importorskip("highway_env"))
    found = []
    for room in ("sumo/", ""):
        env: Any = gym.make(f"{room}intersection-multi-agent-v{version}", disable_env_checker=True)
        env.reset(seed=0)
        _, reward, terminated, *_ = env.step((1, 1))
        found.append((env.action_space, env.observation_space, np.shape(reward), np.shape(terminated)))
        env.close()
    assert found[0] == found[1]


def test_all_cars_have_one_configuration() -> None:
    """After a change by `configure`, and by writing to `config` of the environment."""
    config = tuples({"type": "DiscreteMetaAction"}, {"type": "Kinematics"}, controlled_vehicles=2)
    env: Any = gym.make("sumo/u-turn-v0", config={**config, "duration": 2}).unwrapped
    env.configure({"policy_frequency": 5})
    env.config["screen_width"] = 700
    env.reset(seed=0)
    first, other = env.cars.envs
    assert first.config == other.config and first.config["policy_frequency"] == 5
    with pytest.raises(ConfigError, match="another environment"):
        env.configure({"controlled_vehicles": 3})
    for _ in range(10):
        *_, truncated, _ = env.step((1, 1))
    with pytest.warns(UserWarning, match="over"):
        assert truncated and env.step((1, 1))[1] == 0.0
