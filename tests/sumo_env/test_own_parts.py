"""Tasks, drivers and options of a user's own, with nothing but what docs/own-parts.md names."""

import copy
import itertools
import random
from collections.abc import Callable
from contextlib import ExitStack, closing, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import gymnasium as gym
import numpy as np
import pytest

import sumo_env
from sumo_env.config import ConfigError, warn_once
from sumo_env.env import DrivingEnv
from sumo_env.networks.mapping import network
from sumo_env.networks.roads import Road
from sumo_env.replica.env import ReplicaEnv
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import make_on_lane
from sumo_env.tasks.highway import Highway
from sumo_env.tasks.merge import Merge
from sumo_env.tasks.u_turn import UTurn
from sumo_env.traffic.risk import EventKind
from tests.sumo_env.rollout import drive, observations
from tests.sumo_env.situations import draw, with_leader

# -- roads -------------------------------------------------------------------------------------------------


class OwnRoad(UTurn):
    """The u-turn, as if its lanes and its network were a user's."""

    name = "own-road"

    def road(self, config: Any) -> Road:
        shipped = super().road(config)
        return replace(shipped, name=self.name, net_file=str(network(shipped).net_file))


def test_a_task_brings_its_own_lanes_and_network() -> None:
    """In this process, and in a worker; on SUMO and on the replica."""
    for made in (DrivingEnv, partial(ReplicaEnv, scenarios="seeded")):
        envs = [made(task, {"risk": 1.0, "duration": 4}) for task in (UTurn(), OwnRoad(), OwnRoad())]
        theirs, *own = (observations(env) for env in envs)
        for seen in own:
            np.testing.assert_array_equal(seen, theirs)
        for env in envs:
            env.close()
    sumo_env.check_task(OwnRoad(), {"duration": 2})
    with closing(DrivingEnv(OwnRoad())) as env:
        drawn = env.task.scenario(env.config, 3)
        env.reset(options={"scenario": drawn})
        assert env.scenario is drawn


class Blocked(UTurn):
    """The u-turn with an obstacle 60 m ahead of the ego, which may not change to the other lane."""

    name = "blocked"

    def road(self, config: Any) -> Road:
        shipped = super().road(config)
        right = ("a", "b", 1)
        lanes = {**shipped.lanes, right: replace(shipped.lane(right), forbidden=True)}
        ahead = shipped.lane(("a", "b", 0)).position(60.0, 0.0)
        net_file = str(network(shipped).net_file)
        return replace(shipped, name=self.name, lanes=lanes, obstacles=(ahead,), net_file=net_file)


@pytest.mark.parametrize("made", [DrivingEnv, partial(ReplicaEnv, scenarios="seeded")])
def test_an_obstacle_is_seen_and_hit_and_a_forbidden_lane_is_not_changed_to(made: Any) -> None:
    env = made(Blocked(), {"risk": 1.0, "vehicles_count": 0})
    observation, _ = env.reset(seed=0)
    assert env.scene.ids == ("ego", "obstacle:0") and env.scene.size("obstacle:0") == (2.0, 2.0)
    assert observation[1].tolist() == pytest.approx([1.0, 60.0 / 160.0, 0.0, -16.0 / 24.0, 0.0], abs=1e-6)
    assert [box.id for box in env.road.objects] == ["obstacle:0"] and len(env.road.vehicles) == 1
    assert 2 not in env.get_available_actions()
    (*_, info) = list(drive(env, 2))[-1]
    assert info["crash"]["other"] == "obstacle:0" and env.scene.x[1] == 60.0
    assert info["crash"]["x"] == pytest.approx(56.5, abs=2.0)


class Endless(Merge):
    """No rule of its own ends an episode."""

    def terminated(self, ego: Any, config: Any) -> bool:
        return False


@pytest.mark.parametrize("made", [DrivingEnv, partial(ReplicaEnv, scenarios="seeded")])
@pytest.mark.parametrize("frequency", [1, 5])
def test_an_episode_ends_where_the_ego_s_lane_does(made: Any, frequency: int) -> None:
    """On either simulator, whatever the task's rules; an ego on the lane beside drives on."""
    scenario = draw("merge", policy_frequency=frequency)
    assert scenario.road.dead_ends == {("b", "c", 2)}
    config = {"duration": 5, "policy_frequency": frequency, "simulation_frequency": 10}
    with closing(made(Endless(), config)) as env:
        for lane, expected in ((2, "lane ended"), (1, "time")):
            ego = make_on_lane(scenario.road, "ego", ("b", "c", lane), 20.0, 20.0, scenario.ego.driver)
            # without the obstacle at the end of the third lane
            env.reset(options={"scenario": replace(scenario, ego=ego, vehicles=(), events=())})
            *before, (*_, last) = [result[2:] for result in drive(env)]
            assert last["ending"] == expected and not any(result[0] for result in before)
            assert env.scene.time == pytest.approx(3.0 if lane == 2 else 5.0, abs=1.0 / frequency + 0.2)


# -- tasks and drivers -------------------------------------------------------------------------------------


class Own(Highway):
    """It weighs its terms itself, and they may have any name."""

    def rewards(self, ego: Any, config: Any) -> dict[str, float]:
        return {"progress": ego.s / 100.0}

    def reward(self, rewards: dict[str, float], config: Any) -> float:
        return rewards["progress"]


class Slalom(Own):
    """Vehicles of a driver of its own, in turn on the left and on the right."""

    name = "slalom"
    defaults = {**Highway.defaults, "lanes_count": 2, "vehicles_count": 6, "duration": 8, "gap": 60.0}  # noqa: RUF012

    def vehicles(self, config: Any, road: Any, ego: Any, rng: Any, drivers: Any) -> list[Any]:
        specs = []
        for k, spec in enumerate(super().vehicles(config, road, ego, rng, drivers)):
            s = ego.s + config["gap"] * (k + 1)
            driver = spec.driver.like("slow", {"maxSpeed": 9.0, "accel": 1.5}, lane_change_mode=0)
            place = {"lane": ("0", "1", k % 2), "s": s, "x": s, "y": 4.0 * (k % 2)}
            specs.append(spec._replace(**place, speed=9.0, driver=driver))
        return specs


@pytest.mark.slow
def test_a_task_is_registered_and_driven() -> None:
    """In this process, in a worker (which knows nothing of the class), and in a vector environment."""
    sumo_env.register("test/slalom-v0", Slalom())
    first, second = gym.make("test/slalom-v0"), gym.make("test/slalom-v0")
    seen = observations(first)
    np.testing.assert_array_equal(observations(second), seen)
    env: Any = first.unwrapped
    env.reset(seed=0)
    *_, info = env.step(1)
    assert info["rewards"] == {"progress": env.ego_state.s / 100.0}
    assert max(env.scene.speed[1:]) < 9.01  # SUMO obeys the vehicle type, which would drive 20 m/s else
    assert {vehicle.lane_index[2] for vehicle in env.road.vehicles[1:]} == {0, 1}
    envs = gym.make_vec("test/slalom-v0", num_envs=2, config={"gap": 80.0})
    assert envs.reset(seed=0)[0].shape == (2, 5, 5)
    del gym.registry["test/slalom-v0"]
    with pytest.raises(ConfigError, match="as 'v0' has"):
        ReplicaEnv(Slalom(), scenarios="seeded").reset(seed=0)


def test_lorries_of_their_own_size(tmp_path: Path) -> None:
    """The ego runs into a lorry at its rear, 6 m from its centre, and the picture and the export show its size."""

    scenario = with_leader(60.0, 5.0)(draw("highway"))
    (spec,) = scenario.vehicles
    lorry = spec.driver.like("lorry", {"length": 12.0, "width": 2.5, "maxSpeed": 5}, lane_change_mode=0)
    env = DrivingEnv("highway", render_mode="rgb_array")
    env.reset(options={"scenario": replace(scenario, vehicles=(spec._replace(driver=lorry),))})
    assert env.scene.size("v0") == (12.0, 2.5)
    assert env.scene.x[1] - env.scene.x[0] == pytest.approx(60.0, abs=0.01)
    assert env.road.vehicles[1].LENGTH == 12.0
    *_, (*_, info) = drive(env)
    assert info["crash"]["relative_x"] == pytest.approx(8.5, abs=0.1)  # half of the ego and half of the lorry
    assert info["crash"]["type"] == "rear-end" and env.scene.crashed.all()
    wide = env.render()
    env.scene = replace(env.scene, sizes={})
    assert (wide != env.render()).any()
    env.export(tmp_path)
    kinds = ElementTree.parse(tmp_path / "types.add.xml").iter("vType")
    types = {kind.get("id"): kind.get("length") for kind in kinds}
    assert types["car-12x2.5"] == "12" and types["car"] is None


# -- options -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("in_a_worker", [False, True])
def test_sumo_writes_its_files(tmp_path: Path, in_a_worker: bool) -> None:
    """With `output_dir` each episode has its own, else the last one has it, whatever the dose."""
    option = ["--tripinfo-output", "trips.xml", "--tripinfo-output.write-unfinished"]
    own, out = ["--tripinfo-output", str(tmp_path / "trips.xml"), option[2]], tmp_path / "out"
    with ExitStack() as stack:
        if in_a_worker:
            stack.enter_context(closing(DrivingEnv("highway"))).reset(seed=0)
        for way in ({"sumo_options": own}, {"sumo_options": option, "output_dir": out}):
            env = stack.enter_context(closing(DrivingEnv("highway", **way)))
            warn_once.cache_clear()
            with nullcontext() if "output_dir" in way else pytest.warns(UserWarning, match="last episode"):
                for count, risk in ((1, 0.0), (2, 0.0), (3, 0.5)):
                    env.reset(seed=0, options={"config": {"risk": risk, "vehicles_count": count}})
                    env.step(1)
            with pytest.raises(TypeError, match="copied"):
                copy.deepcopy(env)
            env.close()
    files = [tmp_path / "trips.xml", *sorted(out.glob("environment-*/episode-*/trips.xml"))]
    trips = [{trip.get("id") for trip in ElementTree.parse(file).findall("tripinfo")} for file in files]
    assert trips == [{"ego", *(f"v{k}" for k in range(count))} for count in (3, 1, 2, 3)]


def placing(change: Callable[[Any, Any], Any]) -> Highway:
    """The highway with other vehicles: what a function makes of each, which is given the configuration as well."""

    class Placing(Highway):
        def vehicles(self, config: Any, *arguments: Any) -> list[Any]:
            return [change(spec, config) for spec in super().vehicles(config, *arguments)]

    return Placing()


def paying(terms: Callable[[Any], dict[str, float]]) -> Highway:
    """The highway with other terms of its reward, which a function gives of the ego."""

    class Paying(Highway):
        def rewards(self, ego: Any, config: Any) -> dict[str, float]:
            return {**super().rewards(ego, config), **terms(ego)}

    return Paying()


@pytest.mark.parametrize("task", [*TASKS.values(), Own()], ids=lambda task: task.name)
def test_tasks_without_a_fault_have_none(task: Any) -> None:
    sumo_env.check_task(task, {"risk": 1.0})


def test_events_act_in_the_episodes_of_a_task_without_risk() -> None:
    class Mistyped(EventKind):
        def command(self, at: Any) -> None:
            at.vehicle.steer(1)

    class Mistaken(Highway):
        own_kinds = (Mistyped(rate=9.0, duration=1.0),)

    with pytest.raises(AttributeError, match="steer"):
        sumo_env.check_task(Mistaken())


def test_all_levels_of_a_task_are_driven() -> None:
    crowded = placing(lambda spec, config: spec._replace(s=1e6) if config["vehicles_count"] == 150 else spec)
    with pytest.raises(ValueError) as error:
        sumo_env.check_task(crowded)
    assert error.value.__notes__ == ["in an episode of the task 'highway' at the level '150'"]


class Renamed(Highway):
    def ego(self, *arguments: Any) -> Any:
        return super().ego(*arguments)._replace(id="me")


chance, count = placing(lambda spec, _: spec._replace(speed=20 + random.random())), itertools.count(1)
dosed = placing(lambda spec, config: spec._replace(speed=spec.speed - config["risk"]))
beside = placing(lambda spec, _: spec._replace(lane=("0", "1", 9)))
weightless = paying(lambda _: {"gap_reward": 1.0, "collision_reward": float("nan")})
comes_and_goes = paying(lambda ego: {"headway_reward": 1.0} if ego.action == 1 else {})
remembering = paying(lambda _: {"high_speed_reward": 1.0 / next(count)})


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (chance, ["a seed gives two scenarios: draw from rng"]),
        (dosed, ["1 fault(s)", "the dose of risk moves vehicles"]),
        (weightless, ["'gap_reward' of the reward has no weight", "'collision_reward' is nan"]),
        (comes_and_goes, ["differ between steps"]),
        (remembering, ["1 fault(s)", "a seed gives two episodes"]),
        (Highway, ["not <class"]),
        (type("Uneven", (Highway,), {"target_speeds": (20.0, 21.0, 30.0)})(), ["not evenly spaced"]),
        (Renamed(), ["the ego is called 'me'"]),
        (beside, ["no lane ('0', '1', 9) for 'v0'"]),  # before SUMO sees it
    ],
)
def test_faults_are_named(task: Any, words: list[str]) -> None:
    with pytest.raises(ConfigError) as error:
        sumo_env.check_task(task, {"vehicles_count": 5})
    assert [word for word in words if word not in str(error.value)] == [], error
