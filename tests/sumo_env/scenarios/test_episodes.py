"""Episodes in SUMO's own files: which car is the ego, what a seed repeats, and what can be asked of SUMO."""

import copy
import tempfile
from itertools import cycle, groupby, islice
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from sumo_env.config import ConfigError
from sumo_env.env import DrivingEnv
from sumo_env.scenarios import NetworkTask, SumoDrivingEnv
from sumo_env.scene import ON_ITS_WAY, Scene
from sumo_env.sumo.process import SumoProcess
from tests.sumo_env.plans import QUIET, SUMO_DRIVES, build, floating_car_data, needs_sumo, route_file
from tests.sumo_env.rollout import assert_same_bits, drive
from tests.sumo_env.scenarios.files import written
from tests.sumo_env.scenarios.test_oracle import fronts

pytestmark = [needs_sumo, pytest.mark.filterwarnings("ignore:.*(outputs are off|several environments)")]
_, IDLE, _, FASTER, SLOWER = range(5)
WAY = ["A0A1", "A1B1", "B1C1", "C1C2"]


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Static lights, flows, and drivers of SUMO's default model, who dawdle."""
    return written(tmp_path_factory.mktemp("town"), "static")


def seen(env: Any, seed: int, steps: int = 12) -> list[Scene]:
    env.reset(seed=seed)
    return driven(env, steps)


def driven(env: Any, steps: int = 12) -> list[Scene]:
    actions = islice(cycle([FASTER, IDLE, SLOWER, IDLE]), steps)
    return [env.scene, *(env.scene for _ in drive(env, actions))]


def assert_same(ours: list[Scene], theirs: list[Scene]) -> None:
    assert len(ours) > 3
    assert_same_bits(tuple(ours), tuple(theirs))


# -- one seed, one episode ---------------------------------------------------------------------------------


def test_a_seed_is_one_episode_whatever_was_driven_before_and_wherever(town: Path) -> None:
    """In this process, in a worker, and through `gym.make_vec`'s way of doing it; another seed is another one."""
    env = SumoDrivingEnv(town, ego_vehicle="ego")
    first = seen(env, 3)
    other = seen(env, 4, 20)
    env.sumo.edge.setMaxSpeed("A0A1", 3.0)
    assert_same(seen(env, 3), first)
    env.reset(seed=5, options={"scenario": env.scenario})  # whose own seed counts
    assert_same(driven(env), first)
    assert not np.array_equal(first[-1].y[:2], other[len(first) - 1].y[:2])
    worker = SumoDrivingEnv(town, ego_vehicle="ego")
    assert_same(seen(worker, 3), first)
    task = DrivingEnv(NetworkTask(town, ego_vehicle="ego"), simulator=SumoProcess())
    assert_same(seen(task, 3), first)
    large = seen(env, 3 + 2**31)
    assert not np.array_equal(large[-1].y[:2], first[-1].y[:2])
    assert_same(seen(env, 3 + 2**31), large)


def test_an_export_shows_the_episode(town: Path, tmp_path: Path) -> None:
    """That of the environment, of a copy that imagines twice, and after a hand-over."""
    env = SumoDrivingEnv(town, ego_vehicle="ego", config={"risk": 1.0})
    seen(env, 1, 3)
    seen(env, 3, 5)
    twin = env.imagine(1)
    twin.step(1)
    twin = twin.imagine(2)
    env.hand_over()
    for number, one in enumerate((env, twin)):
        for _ in range(4):
            one.step(1)
        one.export(tmp_path / str(number))
        recorded = floating_car_data(tmp_path / str(number) / "recorded.fcd.xml")
        cars = recorded[max(recorded)]
        assert cars.keys() == set(one.scene.ids)
        for name, front in fronts(one.scene).items():
            assert (float(cars[name]["x"]), float(cars[name]["y"])) == pytest.approx(front, abs=0.02)
    assert fronts(env.scene) != fronts(twin.scene)


# -- the ego -----------------------------------------------------------------------------------------------


def test_the_ego_drives_one_of_several_ways_by_the_seed(town: Path) -> None:
    routes = [WAY, ["C0C1", "C1B1", "B1A1"]]
    env = SumoDrivingEnv(town, ego_route=routes)
    ways = set()
    for seed in range(6):
        env.reset(seed=seed)
        ways.add(env.scene.place.ahead)
    assert ways == {tuple(way) for way in routes}
    env = SumoDrivingEnv(town, ego_trips=[("A0A1", "C1C2"), ("C2C1", "A1A0")])
    ends = set()
    for seed in range(6):
        env.reset(seed=seed)
        ends.add((env.scene.place.ahead[0], env.scene.place.ahead[-1]))
    assert ends == {("A0A1", "C1C2"), ("C2C1", "A1A0")}


def test_a_vehicle_of_the_files_keeps_its_id_and_an_added_one_finds_another(town: Path) -> None:
    env = SumoDrivingEnv(town, ego_vehicle="west.0")
    env.reset(seed=0)
    assert env.ego_id == env.scene.ids[0] == env.road.vehicles[0].id == "west.0"
    added = SumoDrivingEnv(town, ego_route=WAY, config={"warm_up": 30})
    added.reset(seed=0)
    assert added.ego_id != "ego" and "ego" in added.scene.ids and len(added.scene) > 3


def test_a_trip_without_a_way_is_refused_when_the_environment_is_made(tmp_path: Path) -> None:
    """One way streets: nothing leads back from c."""
    net = build(tmp_path, ("a 0 0,b 200 0,c 400 0", "ab a b 1 14,bc b c 1 14"))
    assert SumoDrivingEnv(net, ego_trips=[("ab", "bc")], config=QUIET).reset(seed=0)[0].any()
    with pytest.raises(ConfigError, match="no way leads from edge 'bc' to edge 'ab'"):
        SumoDrivingEnv(net, ego_trips=[("ab", "bc"), ("bc", "ab")])


# -- time --------------------------------------------------------------------------------------------------


def test_begin_is_the_first_departure_where_nothing_departs_for_a_minute(town: Path, tmp_path: Path) -> None:
    late = route_file(tmp_path, '<flow id="f" begin="25200" end="25300" period="2" from="A0A1" to="C1C2"/>')
    net = town.with_name("grid.net.xml")
    env = SumoDrivingEnv(net, late, ego_route=WAY, config={"warm_up": 10})
    with pytest.warns(UserWarning, match="departs at 25200 s"):
        env.reset(seed=0)
    assert env.sumo.simulation.getTime() == pytest.approx(25210.1, abs=5.0) and len(env.scene) > 3
    env.reset(seed=0, options={"config": {"begin": 100}})
    assert env.sumo.simulation.getTime() < 120.0 and len(env.scene) == 1


def test_what_sumo_leaves_out_of_unsorted_files_is_named(town: Path, tmp_path: Path) -> None:
    """It says so itself in a warning, and warnings are off."""
    way, rows = 'from="A0A1" to="C1C2"', (("late", 20), ("early", 10), ("later", 30))
    trips = "".join(f'<trip id="{name}" depart="{time}" {way}/>' for name, time in rows)
    file = route_file(tmp_path, f'{trips}<flow id="flow" begin="0" end="90" period="5" {way}/>')
    net, all_of_it = town.with_name("grid.net.xml"), {"warm_up": 40}
    with pytest.warns(UserWarning, match=r"leaves out 2 of the files \(early, flow\).*sort_routes"):
        env = SumoDrivingEnv(net, file, ego_route=WAY, config=all_of_it)
    env.reset(seed=0)
    assert set(env.scene.ids[1:]) == {"late", "later"}
    for name in ("early", "flow.3"):
        with pytest.raises(ConfigError, match=f"leaves out the vehicle '{name}'.*sort_routes"):
            SumoDrivingEnv(net, file, ego_vehicle=name)
    env = SumoDrivingEnv(net, additional=file, ego_route=WAY, config=all_of_it)
    env.reset(seed=0)
    assert {"early", "flow.3"} <= set(env.scene.ids)


def test_vehicles_that_cannot_come_yet_are_counted(tmp_path: Path) -> None:
    env = SumoDrivingEnv(written(tmp_path, "queues"), ego_vehicle="q1")
    assert env.reset(seed=0)[1]["vehicles_waiting"] > 5


def test_the_step_is_the_file_s_or_the_user_s(town: Path) -> None:
    half = town.with_name("half.sumocfg")
    half.write_text(town.read_text().replace("<time>", '<time><step-length value="0.5"/>'))
    for file, config, step in ((half, {}, 0.5), (half, {"simulation_frequency": 5}, 0.2), (town, {}, 0.1)):
        env = SumoDrivingEnv(file, ego_vehicle="ego", config=config)
        env.reset(seed=0)
        assert env.sumo.simulation.getDeltaT() == pytest.approx(step)


# -- options and outputs -----------------------------------------------------------------------------------


def test_traffic_may_vary_by_episode(town: Path) -> None:
    """Of files by SUMO's own factor; drawn traffic by its numbers. The same seed draws the same."""
    lists: dict[str, Any] = {"network": town.with_name("grid.net.xml"), "routes": [WAY], "ego_route": WAY}
    for arguments in ({"network": town, "ego_route": WAY}, lists):
        scenes = []
        for scale in ([0, 0], [1, 1], [0.5, 2]):
            config = {"warm_up": 60, "traffic_scale": scale}
            env = SumoDrivingEnv(**arguments, config=config)
            for seed in (0, 1, 0):
                env.reset(seed=seed)
                scenes.append(env.scene)
            env.close()
        counts = [len(scene) for scene in scenes]
        assert counts[:3] == [1, 1, 1] and min(counts[3:]) > 3
        assert_same_bits(scenes[6], scenes[8])
        assert (counts[3], counts[4]) != (counts[6], counts[7])


def test_outputs_go_nowhere_or_each_episode_has_its_own(tmp_path: Path) -> None:
    """Those of detectors too; what the user names is where the user says."""
    config = written(tmp_path / "town", "additional")
    more, trips, out = config.with_name("more.add.xml"), tmp_path / "mine.xml", tmp_path / "out"
    more.write_text('<additional><edgeData id="e" file="edges.xml"/></additional>')
    before = sorted(config.parent.iterdir())
    usual: dict[str, Any] = {"network": config, "additional": more, "ego_vehicle": "ego"}
    env = SumoDrivingEnv(**usual, sumo_options=["--tripinfo-output", str(trips)])
    seen(env, 0)
    scratch = list(Path(tempfile.gettempdir()).glob("sumo_env-*/outputs/edges.xml"))
    assert scratch
    env.close()
    assert trips.read_text().startswith("<?xml") and not any(file.exists() for file in scratch)
    envs = [SumoDrivingEnv(**usual, output_dir=out) for _ in range(2)]
    for env in envs:
        seen(env, 0)
        seen(env, 1)
        env.close()
    for name in ("edges.xml", "trips.xml", "log.txt"):
        found = sorted(out.glob(f"environment-*/episode-*/{name}"))
        assert len(found) == 4 and len({file.parent.parent for file in found}) == 2
    assert sorted(config.parent.iterdir()) == before
    envs[0].reset(seed=0)
    with pytest.raises(TypeError, match="cannot be copied"):
        copy.deepcopy(envs[0])


# -- reward and observation --------------------------------------------------------------------------------


def test_a_route_may_use_an_edge_twice(town: Path) -> None:
    round_trip = ["A0A1", "A1B1", "B1B0", "B0A0", "A0A1", "A1A2"]
    env = SumoDrivingEnv(town, ego_route=round_trip, config={"action": SUMO_DRIVES, "duration": 300})
    env.reset(seed=3)
    shares, driven = [], [env.scene.place.ahead[0]]
    for *_, info in drive(env, 0):
        shares.append(info["rewards"]["progress_reward"])
        driven.append(env.scene.place.ahead[0])
    assert info["arrived"] and sum(shares) == pytest.approx(1.0)
    assert [edge for edge, _ in groupby(driven)] == round_trip


def test_the_ego_sees_the_end_of_its_lane_and_the_next_light(town: Path) -> None:
    """Leaders and followers: spaces/test_leaders_followers.py."""
    seen = {"type": "Kinematics", "features": list(ON_ITS_WAY), "normalize": False}
    env = SumoDrivingEnv(town, ego_trips=[("B2B1", "A1A0")], config={"observation": seen})
    observation, info = env.reset(seed=1)
    ego, others = observation[0], observation[1:]
    place = env.scene.place
    expected = [min(reach, 200.0) for reach in (place.free, place.free_left, place.free_right)]
    assert ego[:3].tolist() == pytest.approx(expected)
    light, distance = info["traffic_light"], min(info["traffic_light_distance"], 200.0)
    assert (ego[3], ego[4]) == (light, pytest.approx(distance))
    assert place.left != place.right  # gaps to the lane that is not there are 0
    assert (ego[6:8] == 0.0).all() != place.left and (ego[8:10] == 0.0).all() != place.right
    assert not others.any()


# -- SUMO of an environment --------------------------------------------------------------------------------


def test_every_environment_s_own_sumo_can_be_asked(town: Path) -> None:
    envs: list[Any] = [gym.make("sumo_env:sumo/highway-v0"), SumoDrivingEnv(town, ego_vehicle="ego")]
    for env in envs:
        env.reset(seed=0)
    highway, files = (env.unwrapped for env in envs)
    assert highway.sumo.vehicle.getSpeed("ego") == pytest.approx(25.0)
    assert files.sumo.vehicle.getFuelConsumption("ego") > 0.0
    assert "B1" in files.sumo.trafficlight.getIDList()
    for name in ("load", "start", "close", "simulationStep"):
        with pytest.raises(AttributeError, match=f"'{name}' is the environment's own"):
            getattr(files.sumo, name)
    with pytest.raises(Exception, match="nobody"):
        files.sumo.vehicle.getSpeed("nobody")
    files.sumo.edge.setMaxSpeed("A0A1", 3.0)  # what is changed is changed in a copy too
    assert_same(driven(copy.deepcopy(files)), driven(files))
