"""Several learning cars among the vehicles of SUMO's own files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sumo_env
from sumo_env.scenarios import SumoDrivingEnv
from tests.sumo_env.plans import SUMO_DRIVES, build, floating_car_data, needs_sumo, route_file

pytest.importorskip("pettingzoo")
pytestmark = needs_sumo

PLAN = ("a 0 0, b 1500 0, c 2000 0", "ab a b 2 25, bc b c 2 25")
TRAFFIC = """
    <vType id="cav" accel="2.0" decel="4.0"/>
    <flow id="f" begin="0" end="900" period="3" departLane="random"><route edges="ab bc"/></flow>
    <vehicle id="early" type="cav" depart="2"><route edges="ab bc"/></vehicle>
    <vehicle id="late" type="cav" depart="12"><route edges="ab bc"/></vehicle>
    <flow id="g" type="cav" begin="30" end="900" period="5"><route edges="ab bc"/></flow>
"""


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("road")
    return build(folder, PLAN), route_file(folder, TRAFFIC)


def places(scene: Any) -> dict[str, float]:
    return dict(zip(scene.ids, scene.x.tolist(), strict=True))


def test_cars_of_the_files_come_when_sumo_lets_them(road: tuple[Path, Path]) -> None:
    """car_0 departs ten seconds after car_1. SUMO drives both: all drive as without a second learning car."""
    network, routes = road
    config = {"duration": 40, "action": SUMO_DRIVES}
    picture: dict[str, Any] = {"render_mode": "rgb_array", "routes": routes}
    env = sumo_env.parallel_env(network, config, vehicles=["late", "early"], **picture)
    single = SumoDrivingEnv(network, routes, ego_vehicle="early", config=config)
    assert env.possible_agents == ["car_0", "car_1"]
    observations, _ = env.reset(seed=0)
    single.reset(seed=0)
    assert list(observations) == ["car_1"] == env.agents
    came = []
    while env.agents:
        found = env.step(dict.fromkeys(env.agents, 0))
        assert env.render() is not None  # also before car_0 is there
        single.step(0)
        assert places(env.cars["car_1"].scene) == places(single.scene)
        came.append(len(found[0]))
        if came.count(2) == 1:
            assert found[1]["car_0"] == 0.0 and env.agents == ["car_0", "car_1"]
    assert came == [1] * 9 + [2] * 31
    assert all(found[3].values()) and env.cars["car_0"].scene.place.lane[0].startswith("ab")


def test_a_further_car_writes_the_episode_of_all_and_imagines_what_is_to_come(road, tmp_path) -> None:
    """As the first one does, in a task and among vehicles of SUMO's files."""
    fleet = sumo_env.parallel_env(road[0], {"risk": 1.0}, routes=road[1], vehicle_type="cav", max_cars=2)
    two = sumo_env.parallel_env("sumo/highway-v0", {"controlled_vehicles": 2})
    for env in (two, fleet):
        env.reset(seed=0)
        while len(env.ids) < 2 or env.cars["car_1"].steps < 3:
            env.step(dict.fromkeys(env.agents, 1))
        twin = env.cars["car_1"].imagine(1)
        twin.step(1)
        assert twin.ego_id == env.ids["car_1"]
        written = []
        for number, car in enumerate((*env.cars.values(), twin)):
            car.export(tmp_path / str(number))
            written.append(floating_car_data(tmp_path / str(number) / "recorded.fcd.xml"))
            last = written[-1][max(written[-1])]
            assert last.keys() == set(car.scene.ids)
        assert written[0] == written[1] != written[2] and len(written[2]) > len(written[1])
        twin.close()
        env.close()


def test_cars_of_a_type_take_the_next_agent(road: tuple[Path, Path]) -> None:
    """Further vehicles of the type are SUMO's; a car that has arrived leaves the agents."""
    network, routes = road
    config = {"duration": 150, "action": {**SUMO_DRIVES, "longitudinal": True}}
    env = sumo_env.parallel_env(network, config, routes=routes, vehicle_type="cav", max_cars=4)
    env.reset(seed=0)
    assert env.agents == ["car_0"] and len(env.possible_agents) == 4
    ends: dict[str, str] = {}
    while env.agents:
        _, _, terminated, _, infos = env.step(dict.fromkeys(env.agents, 2))  # FASTER
        ends |= {agent: info["ending"] for agent, info in infos.items() if terminated[agent]}
    assert set(ends) == set(env.possible_agents) and "arrived" in ends.values()
    assert list(env.ids.values()) == ["early", "late", "g.0", "g.1"]


def test_a_car_that_arrives_before_its_agent_has_acted_is_paid_and_the_others_drive_on(tmp_path) -> None:
    net = build(tmp_path, ("a 0 0, b 500 0, c 520 0", "ab a b 1 25, bc b c 1 25"))
    cars = '<vType id="cav"/><trip id="long" type="cav" depart="0" from="ab" to="bc"/>'
    cars += '<trip id="short" type="cav" depart="1.2" from="bc" to="bc" departSpeed="max"/>'
    env = sumo_env.parallel_env(net, routes=route_file(tmp_path, cars), vehicle_type="cav", max_cars=2)
    env.reset(seed=0)
    while "car_1" not in env.agents:
        env.step(dict.fromkeys(env.agents, 3))
    _, rewards, ends, _, infos = env.step(dict.fromkeys(env.agents, 3))
    assert infos["car_1"]["ending"] == "arrived" and rewards["car_1"] == pytest.approx(10.0)
    assert ends == {"car_0": False, "car_1": True} and env.agents == ["car_0"]
    env.step({"car_0": 3})
    env.close()


def test_a_crashed_car_stays_an_obstacle_after_sumo_has_teleported_it(road, tmp_path) -> None:
    """The second car drives into the first one, which stands; SUMO puts both on the next edge after a while."""
    cars = """
        <vType id="cav" accel="3" decel="5"/>
        <vehicle id="ahead" type="cav" depart="0" departPos="300"><route edges="ab bc"/></vehicle>
        <vehicle id="behind" type="cav" depart="0" departPos="200" departSpeed="15"><route edges="ab bc"/></vehicle>
        <vehicle id="third" type="cav" depart="0" departPos="5"><route edges="ab bc"/></vehicle>
    """
    action = {"type": "DiscreteMetaAction", "target_speeds": [0.0, 3.0, 15.0]}
    routes, names = route_file(tmp_path, cars), ["ahead", "behind", "third"]
    given: dict[str, Any] = {"routes": routes, "vehicles": names, "sumo_options": ["--time-to-teleport=12"]}
    env = sumo_env.parallel_env(road[0], {"duration": 60, "action": action}, **given)
    env.reset(seed=0)
    found, sumo = {"ahead": set[str](), "behind": set[str]()}, env.cars["car_0"].sumo.vehicle
    for step in range(60):
        creeps = 4 if env.cars["car_2"].ego_state.speed > 4.0 else 3
        assert "car_2" in env.agents
        actions = {"car_0": 4, "car_1": 3, "car_2": creeps if step < 5 else 1}
        env.step({agent: actions[agent] for agent in env.agents})
        for name, places in found.items():
            if step > 20 and name in sumo.getIDList():
                places.add(sumo.getRoadID(name))
                assert sumo.getSpeed(name) < 0.1
    assert all("bc" in places for places in found.values())
    env.close()


def test_for_super_suit_all_agents_act_from_the_beginning(road: tuple[Path, Path]) -> None:
    """Those that come later see zeros until then; all end together."""
    supersuit = pytest.importorskip("supersuit")
    from sumo_env.parallel import AllAgents

    config = {"duration": 15, "action": SUMO_DRIVES}
    cars = sumo_env.parallel_env(road[0], config, routes=road[1], vehicle_type="cav", max_cars=3)
    envs = supersuit.pettingzoo_env_to_vec_env_v1(AllAgents(cars))
    seen, _ = envs.reset(seed=0)
    assert [bool(rows.any()) for rows in seen] == [True, False, False]
    found = [envs.step(np.zeros(3, int)) for _ in range(15)]
    assert [bool(rows.any()) for rows in found[13][0]] == [True, True, False]
    assert sum(result[1][2] for result in found) == 0.0
    assert found[-1][3].all() and not any(result[3].any() for result in found[:-1])
    assert not any(result[2].any() for result in found)
    envs.close()
