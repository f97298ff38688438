"""Tasks, drivers, networks and options of a user's own, with nothing but what docs/own-parts.md names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import sumo_env
from sumo_env.config import ConfigError
from sumo_env.env import DrivingEnv, SumoDrivingEnv
from sumo_env.networks import files
from sumo_env.replica.simulator import Replica
from sumo_env.simulator import SimulatorError
from sumo_env.tasks.base import ego_driver, make_on_lane, weighted
from sumo_env.tasks.highway import Highway
from sumo_env.tasks.network import NetworkTask
from sumo_env.testing import check_task
from tests.sumo_env.plans import QUIET, build, endings, grid, needs_sumo, opened
from tests.sumo_env.rollout import drive
from tests.sumo_env.scenarios import drivers

pytestmark = needs_sumo

ROUTES = [["A0A1", "A1B1", "B1C1"], ["C2C1", "C1B1", "B1A1"], ["B0B1", "B1B2"]]
EGO = ["A0A1", "A1A2", "A2B2"]

# A merge by hand: a slip road joins a main road with two lanes, which ends in a bend.
NODES = """<nodes>
    <node id="west" x="0" y="0"/> <node id="merge" x="300" y="0" type="priority"/>
    <node id="south" x="100" y="-100"/> <node id="east" x="600" y="100"/>
</nodes>"""
EDGES = """<edges>
    <edge id="main" from="west" to="merge" numLanes="2" speed="25" priority="3"/>
    <edge id="slip" from="south" to="merge" numLanes="1" speed="15" priority="1"/>
    <edge id="out" from="merge" to="east" numLanes="2" speed="20" priority="3" shape="300,0 500,0 580,30 600,100"/>
</edges>"""
DEPARTING = '<vehicle id="v" depart="0" {}><route edges="main"/></vehicle>'
DEMAND = """<routes>
    <vType id="lorry" carFollowModel="Krauss" accel="1.0" maxSpeed="12"/>
    <route id="through" edges="main out"/>
    <vehicle id="first" type="lorry" route="through" depart="0" departLane="0" departPos="120" departSpeed="10"/>
    <vehicle id="late" depart="2.5"><route edges="slip out"/></vehicle>
    <flow id="stream" route="through" begin="4" end="14" number="5" departSpeed="max"/>
</routes>"""


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network of netgenerate."""
    options = ["--grid.number=3", "--grid.length=150", "-L=2", "--no-turnarounds"]
    return grid(tmp_path_factory.mktemp("grid"), *options)


@pytest.fixture(scope="module")
def merge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network written by hand, and its demand beside it."""
    folder = tmp_path_factory.mktemp("merge")
    (folder / "m.rou.xml").write_text(DEMAND)
    return build(folder, {"nod": NODES, "edg": EDGES})


def episode(env: gym.Env[Any, Any], action: int = 1, seed: int = 0) -> list[np.ndarray]:
    """The observations of an episode."""
    seen = [env.reset(seed=seed)[0]]
    for observation, reward, *_ in drive(env, action):
        assert env.observation_space.contains(observation) and np.isfinite(reward)
        seen.append(observation)
    return seen


# -- tasks and drivers -------------------------------------------------------------------------------------


class Slalom(Highway):
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

    def rewards(self, ego: Any, config: Any) -> dict[str, float]:
        return {"progress": ego.s / 100.0}

    def reward(self, rewards: dict[str, float], config: Any) -> float:
        return rewards["progress"]


@pytest.mark.slow
def test_a_task_is_registered_and_driven() -> None:
    """In this process, in a worker (which knows nothing of the class), and in a vector environment."""
    sumo_env.register("test/slalom-v0", Slalom())
    first, second = gym.make("test/slalom-v0"), gym.make("test/slalom-v0")
    seen = episode(first)
    np.testing.assert_array_equal(episode(second), seen)
    env = first.unwrapped
    env.reset(seed=0)
    *_, info = env.step(1)
    assert info["rewards"] == {"progress": env.ego_state.s / 100.0}
    assert max(env.scene.speed[1:]) < 9.01  # SUMO obeys the vehicle type, which would drive 20 m/s else
    assert {vehicle.lane_index[2] for vehicle in env.road.vehicles[1:]} == {0, 1}
    for made in (first, second):
        made.close()
    envs = gym.make_vec("test/slalom-v0", num_envs=2, config={"gap": 80.0})
    observations, _ = envs.reset(seed=0)
    assert observations.shape == (2, 5, 5)
    envs.close()
    del gym.registry["test/slalom-v0"]


class Polite(Highway):
    """Pays for a gap to the vehicle ahead, which it finds in the scene."""

    name = "polite"
    defaults = {**Highway.defaults, "vehicles_count": 6, "duration": 6, "gap_reward": 1.0}  # noqa: RUF012

    def rewards(self, ego: Any, config: Any) -> dict[str, float]:
        ahead = ego.scene.x[1:] - ego.scene.x[0]
        gap = min(ahead[(ahead > 0) & (abs(ego.scene.y[1:] - ego.scene.y[0]) < 2)], default=100.0)
        return {"gap_reward": min(gap / 100.0, 1.0), "on_road_reward": float(ego.on_road)}

    def reward(self, rewards: dict[str, float], config: Any) -> float:
        return weighted(rewards, config)


def test_a_reward_may_ask_for_the_traffic_and_is_checked() -> None:
    check_task(Polite(), seeds=1)

    class Unweighted(Polite):
        def rewards(self, ego: Any, config: Any) -> dict[str, float]:
            return {**super().rewards(ego, config), "comfort_reward": 1.0}

        def reward(self, rewards: dict[str, float], config: Any) -> float:
            return weighted(rewards, config)

    with pytest.raises(AssertionError, match="'comfort_reward', which has no weight in Unweighted"):
        check_task(Unweighted(), seeds=1)


@pytest.mark.slow
def test_a_task_on_a_road_of_the_five_runs_on_the_replica() -> None:
    env = DrivingEnv(Slalom(), {"simulation_frequency": 15}, simulator=Replica())
    assert len(episode(env)) > 2


def test_what_only_sumo_can_drive_says_so_elsewhere(blocks: Path) -> None:
    env = DrivingEnv(NetworkTask(blocks, ROUTES, EGO), simulator=Replica())
    with pytest.raises(TypeError, match="other networks need SUMO"):
        env.reset(seed=0)
    with pytest.raises(ValueError, match="leave out `simulator`"):
        DrivingEnv("highway", simulator=Replica(), sumo_options=["--tripinfo-output=trips.xml"])


def test_lorries_of_their_own_size(tmp_path: Path) -> None:
    """The ego runs into a lorry at its rear, 6 m from its centre, and the picture and the export show its size."""

    class Lorry(Highway):
        name = "lorry"

        def vehicles(self, config: Any, road: Any, ego: Any, rng: Any, drivers: Any) -> list[Any]:
            (spec,) = super().vehicles({**config, "vehicles_count": 1}, road, ego, rng, drivers)
            driver = spec.driver.like(
                "lorry", {"length": 12.0, "width": 2.5, "maxSpeed": 5}, lane_change_mode=0
            )
            place = {"lane": ego.lane, "s": ego.s + 60.0, "x": ego.x + 60.0, "y": ego.y}
            return [spec._replace(**place, speed=5.0, target_speed=5.0, driver=driver)]

    env = DrivingEnv(Lorry(), render_mode="rgb_array")
    env.reset(seed=0)
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
    types = {
        kind.get("id"): kind.get("length")
        for kind in ElementTree.parse(tmp_path / "types.add.xml").iter("vType")
    }
    assert types["car-12x2.5"] == "12" and types["car"] is None
    env.close()


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"acell": 2.0}, "'accel'"),
        ({"maxspeed": 2.0}, "'maxSpeed'"),
        ({"zzz": 2.0}, "see https"),
        ({"speedFactor": 2.0}, "no effect"),
        ({"carFollowModel": "Kraus"}, "did you mean 'Krauss'"),
        ({"accel": "fast"}, "accel of 'odd' must be a number above 0, not 'fast'"),
        ({"length": "long"}, "length of 'odd' must be a number"),
        ({"length": 200.0}, "length of 'odd' must be from"),
        ({"tau": -1.0}, "tau of 'odd' must be a number at least 0, not -1"),
    ],
)
def test_attributes_that_sumo_would_ignore_or_refuse_are_named(attributes, message) -> None:
    with pytest.raises(ValueError, match=message):
        drivers("highway", 0.0)[0].like("odd", attributes)


def test_mistakes_in_a_task_of_ones_own_are_named() -> None:
    class Wrong(Slalom):
        ego_lane, names, terms = 0, ("v0", "v1"), True

        def ego(self, config: Any, road: Any, rng: Any) -> Any:
            return make_on_lane(road, "ego", ("0", "1", self.ego_lane), 10.0, 9.0, ego_driver(self))

        def vehicles(self, *arguments: Any) -> list[Any]:
            specs = super().vehicles(*arguments)
            return [spec._replace(id=name) for spec, name in zip(specs, self.names, strict=False)]

        def rewards(self, ego: Any, config: Any) -> Any:
            return super().rewards(ego, config) if self.terms else None

    for changes, message in (
        ({"ego_lane": 9}, r"'ego' cannot be placed: the road 'highway' has no lane \('0', '1', 9\)"),
        ({"names": ("v0", "v0")}, "two vehicles of the task 'slalom' are called 'v0'"),
        ({"names": ("ego",)}, "two vehicles of the task 'slalom' are called 'ego'"),
    ):
        env = DrivingEnv(type("Mine", (Wrong,), changes)())
        with pytest.raises(ConfigError, match=message):
            env.reset(seed=0)
    env = DrivingEnv(type("Mine", (Wrong,), {"terms": False})())
    with pytest.raises(TypeError) as raised:
        env.reset(seed=0)
    assert raised.value.__notes__ == ["in Mine.rewards of the task 'slalom'"]
    env.close()


def test_a_class_in_place_of_a_task_is_named() -> None:
    with pytest.raises(ConfigError, match=r"not its class: Highway\(\)"):
        DrivingEnv(Highway)
    with pytest.raises(TypeError, match=r"Highway\(\)"):
        sumo_env.register("test/class-v0", Highway)


def test_sumo_s_words_are_passed_on_when_it_refuses_a_driver() -> None:
    class Wrong(Slalom):
        def vehicles(self, *arguments: Any) -> list[Any]:
            return [
                spec._replace(driver=spec.driver.like("odd", {"emissionClass": "none of these"}))
                for spec in super().vehicles(*arguments)
            ]

    env = DrivingEnv(Wrong())
    with pytest.raises(SimulatorError, match="vehicle types"):
        env.reset(seed=0)
    env.close()


# -- networks ----------------------------------------------------------------------------------------------


def test_lanes_limits_and_junctions_are_read(blocks: Path, merge: Path) -> None:
    road = files.network(merge).road
    assert road.count("main:from", "main:to") == 2 and road.count("slip:from", "slip:to") == 1
    assert road.lane(files.lane("main")).speed_limit == 25.0
    left, right = (road.lane(files.lane("out", k)) for k in (0, 1))
    assert left.length < right.length  # it bends to the left
    assert ("slip:to", "out:from", 0) in road.lanes
    for net in (blocks, merge):
        for index, lane in files.network(net).road.lanes.items():
            for s in np.linspace(0.5, lane.length - 0.5, 7).tolist():
                assert lane.local_coordinates(*lane.position(s, 0.0)) == pytest.approx((s, 0.0), abs=0.3), (
                    index
                )
            assert lane.position(0.0, 1.0) != lane.position(0.0, -1.0)


@pytest.mark.slow
@pytest.mark.parametrize("risk", [0.0, 1.0])
def test_a_generated_network_is_driven(blocks: Path, risk: float) -> None:
    config = {"vehicles_count": 15, "risk": risk, "duration": 20}
    env = SumoDrivingEnv(blocks, ROUTES, EGO, config, render_mode="rgb_array")
    check_env(env, skip_render_check=True)
    first = episode(env, 1, seed=3)
    np.testing.assert_array_equal(episode(env, 1, seed=3), first)
    assert (len(env.scenario.events) > 0) == (risk > 0)
    other = SumoDrivingEnv(blocks, ROUTES, EGO, config)  # in a worker
    env.reset(seed=0)
    np.testing.assert_array_equal(episode(other, 1, seed=3), first)
    picture = env.render()
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 4
    other.close()
    env.close()


def test_the_ego_arrives_in_the_lane_that_leads_on_and_misses_its_turn_in_the_other(blocks: Path) -> None:
    env = SumoDrivingEnv(blocks, ROUTES, ["A0A1", "A1B1"], QUIET)
    keeps = 60 * [1]
    assert endings(env, range(2), [2, 2, *keeps]) == {"arrived_reward"}  # a right turn, from the right lane
    assert endings(env, range(2), [0, 0, *keeps]) == {"missed_turn_reward"}
    env.close()


def test_a_network_written_by_hand_with_its_demand(merge: Path) -> None:
    env = SumoDrivingEnv(merge, merge.with_name("m.rou.xml"), ["main", "out"], {"duration": 20})
    assert env.target_speeds == (0.0, 12.5, 25.0)
    seen: dict[str, float] = {}
    for _ in drive(env, seed=0):
        for vehicle in env.road.vehicles:
            seen.setdefault(vehicle.id, env.scene.time)
    assert {"ego", "first", "late", "stream.0"} <= set(seen)
    assert 3.0 <= seen["late"] <= 4.0  # at the first policy step after 2.5 s
    (lorry,) = (spec for spec in env.scenario.vehicles if spec.id == "first")
    assert dict(lorry.driver.attributes)["carFollowModel"] == "Krauss"
    assert lorry.lane == files.lane("main", 1)  # SUMO's lane 0 is the right one
    assert lorry.s == pytest.approx(117.5)
    env.close()


@pytest.mark.slow
def test_a_crash_on_a_network_is_recorded_and_exported(blocks: Path, tmp_path: Path) -> None:
    env = SumoDrivingEnv(blocks, ROUTES, EGO, {"vehicles_count": 40, "spawn_probability": 1.0, "risk": 1.0})
    for seed in range(30):
        episode(env, 3, seed)
        if env.vehicle.crashed:
            break
    assert env._last.crash.other in env.scene.ids
    env.export(tmp_path)
    shown = {name for cars in opened(tmp_path / "episode.sumocfg").values() for name in cars}
    assert set(env.scene.ids) <= shown
    env.close()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"network": "nowhere.net.xml"}, "there is no SUMO network"),
        ({"ego_route": ["A0A1", "B1B2"]}, "no connection leads from edge 'A0A1' to edge 'B1B2'"),
        ({"ego_route": ["A0A9"]}, "edge 'A0A9'"),
        ({"routes": [["A0A1", "B1B2"]]}, "route 0"),
        ({"routes": "nowhere.rou.xml"}, "route file"),
        ({"config": {"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 90]}}}, "target_speeds"),
    ],
)
def test_what_cannot_be_driven_is_named(blocks: Path, change: dict[str, Any], message: str) -> None:
    parts: dict[str, Any] = {"network": blocks, "routes": ROUTES, "ego_route": EGO, **change}
    with pytest.raises(ConfigError, match=message):
        SumoDrivingEnv(**parts).reset(seed=0)


@pytest.mark.parametrize(
    ("element", "message"),
    [
        ('<trip id="t" from="out" to="main" depart="0"/>', "no route leads from edge 'out' to edge 'main'"),
        ('<trip id="t" fromTaz="1" toTaz="2" depart="0"/>', "trip 't': it has no route"),
        ('<vehicle id="v" depart="triggered"><route edges="main"/></vehicle>', "depart='triggered'"),
        (
            '<vehicle id="v" depart="0"><route edges="main"/><stop lane="main_0" duration="9"/></vehicle>',
            "stops",
        ),
        ('<person id="p" depart="0"/>', "only vehicles drive here"),
        ('<vehicle id="v" depart="0" departLane="7"><route edges="main"/></vehicle>', "departs on lane 7"),
        ("<vehicle", "cannot be read"),
        ('<vehicle id="v"><route edges="main"/></vehicle>', "vehicle 'v': it needs a time to depart"),
        ('<vehicle id="ego" depart="0"><route edges="main"/></vehicle>', "'ego': there is another vehicle"),
        (2 * '<vehicle id="v" depart="0"><route edges="main"/></vehicle>', "'v': there is another vehicle"),
        (DEPARTING.format('departLane="firts"'), "departLane='firts'"),
        (DEPARTING.format('departPos="999"'), "departs at 999 m of edge 'main', which is 2.. m long"),
        (DEPARTING.format('departSpeed="-3"'), "departSpeed=-3 is negative"),
        ('<vType id="x" carFollowModel="Kraus"/>', "carFollowModel .* did you mean 'Krauss'"),
        ('<vType id="x" accel="fast"/>', "accel of 'x' must be a number above 0, not 'fast'"),
        ('<vType id="x" length="-3"/>', "length of 'x' must be a number above 0, not '-3'"),
        ('<vType id="x" vClass="buss"/>', "did you mean 'bus'"),
        ('<route id="r" edges="main"><stop lane="main_0" duration="9"/></route>', "stops"),
    ],
)
def test_what_a_route_file_cannot_say_is_named(merge: Path, tmp_path, element: str, message: str) -> None:
    demand = tmp_path / "wrong.rou.xml"
    demand.write_text(f"<routes>{element}</routes>")
    with pytest.raises(ConfigError, match=message):
        SumoDrivingEnv(merge, demand, ["main", "out"]).reset(seed=0)


def test_files_and_lists_in_each_other_s_place_are_named(merge: Path, tmp_path: Path) -> None:
    demand = tmp_path / "d.rou.xml"
    demand.write_text("<routes/>")
    for network, routes, message in (
        (merge, merge, "begins with <net> and not with <routes>"),
        (demand, [], "has no edges: is it a SUMO network"),
        (merge, ["main", "out"], "route 0 must be a list of edges, not 'main'"),
        (merge, {"r": "main out"}, "route r must be a list of edges"),
    ):
        with pytest.raises(ConfigError, match=message):
            SumoDrivingEnv(network, routes, ["main", "out"])


def test_vehicles_depart_in_the_lane_that_is_named(merge: Path, tmp_path: Path) -> None:
    demand = tmp_path / "d.rou.xml"
    for lane, number in (("0", 1), ("1", 0), ("first", 1)):
        demand.write_text(f"<routes>{DEPARTING}</routes>".format(f'departLane="{lane}" departPos="90"'))
        env = SumoDrivingEnv(merge, demand, ["main", "out"])
        env.reset(seed=0)
        assert env.road.vehicles[1].lane_index == files.lane("main", number)
        env.close()


def test_a_network_without_lanes_inside_its_junctions_is_refused(tmp_path: Path) -> None:
    net = grid(tmp_path, "--grid.number=2", "--no-internal-links")
    with pytest.raises(ConfigError, match="no-internal-links"):
        SumoDrivingEnv(net, [], ["A0A1"])


# -- options -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_sumo_writes_its_files(tmp_path: Path) -> None:
    """Of an environment in this process, and of one in a worker."""
    envs = []
    for number in range(2):
        trips, detectors = tmp_path / f"trips{number}.xml", tmp_path / f"loop{number}.add.xml"
        loop = (
            f'<inductionLoop id="loop" lane="0-1_0" pos="400" period="1" file="{tmp_path}/loop{number}.xml"/>'
        )
        detectors.write_text(f"<additional>{loop}</additional>")
        options = ["--tripinfo-output", str(trips), "--tripinfo-output.write-unfinished"]
        options.append(f"--additional-files={detectors}")
        envs.append(gym.make("sumo/highway-v0", config={"vehicles_count": 5}, sumo_options=options))
    plain = gym.make("sumo/highway-v0", config={"vehicles_count": 5})
    seen = [episode(env) for env in (*envs, plain)]
    np.testing.assert_array_equal(seen[0], seen[2])  # they change nothing
    np.testing.assert_array_equal(seen[1], seen[2])
    for env in (*envs, plain):
        env.close()
    for number in range(2):
        trips = ElementTree.parse(tmp_path / f"trips{number}.xml").findall("tripinfo")
        assert {trip.get("id") for trip in trips} == {"ego", *(f"v{k}" for k in range(5))}
        assert ElementTree.parse(tmp_path / f"loop{number}.xml").findall("interval")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--net-file", "x.net.xml"], "SumoDrivingEnv"),
        (["--step-length=0.5"], "simulation_frequency"),
        (["--gui"], "export"),
        ([3], "list of strings"),
    ],
)
def test_options_that_cannot_work_are_refused(options: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        DrivingEnv("highway", sumo_options=options)


def test_a_mistyped_option_is_named() -> None:
    env = DrivingEnv("highway", sumo_options=["--tripinfo-outptu", "trips.xml"])
    with pytest.raises(SimulatorError, match=r"--tripinfo-outptu=trips\.xml"):
        env.reset(seed=0)
    env.close()
