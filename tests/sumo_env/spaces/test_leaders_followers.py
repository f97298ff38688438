"""Leaders and followers, what is left of a light, and the terms of a reward that are made of them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle

from sumo_env.env import DrivingEnv
from sumo_env.networks.roads import highway
from sumo_env.scenarios import NetworkTask, SumoDrivingEnv
from sumo_env.scene import NOBODY, Neighbour, Scene
from sumo_env.spaces.leaders_followers import neighbours_on
from sumo_env.spaces.observation import on_its_way
from tests.sumo_env.plans import QUIET, build, route_file

FASTER, SLOWER = 3, 4
SEEN = {"type": "LeadersFollowers", "normalize": False}


def net(folder: Path, *options: str) -> Path:
    return build(folder, ("a 0 0, b 300 0 priority, c 600 0", "ab a b 3 20, bc b c 3 20"), *options)


def road(path: Path, seed: int = 0, **config: Any) -> SumoDrivingEnv:
    env = SumoDrivingEnv(path, [["ab", "bc"]], ["ab", "bc"], {**QUIET, **config})
    env.reset(seed=seed)
    return env


@pytest.mark.parametrize("seen", [SEEN, {"type": "Kinematics", "vehicles_count": 1}])
def test_a_task_of_ones_own_may_see_something_else(tmp_path: Path, seen: dict[str, Any]) -> None:
    """A configuration with a table of its own still has the network's features and ranges."""
    sees: Any = type("Sees", (NetworkTask,), {"defaults": {**NetworkTask.defaults, "observation": seen}})
    way = (net(tmp_path), [["ab", "bc"]], ["ab", "bc"])
    env, usual = DrivingEnv(sees(*way)), SumoDrivingEnv(*way)
    assert env.config["observation"].items() >= seen.items()
    assert env.observation_space.shape == ((16,) if seen is SEEN else (1, 22))
    for one in (env, usual):
        one.configure({"observation": {"type": "Kinematics", "vehicles_count": 4}})
    assert np.array_equal(env.reset(seed=0)[0], usual.reset(seed=0)[0])


# -- leaders and followers -----------------------------------------------------------------------------------------


def test_leaders_and_followers_are_highway_env_s_neighbours() -> None:
    rng, ours = np.random.default_rng(0), highway(4)
    theirs = Road(RoadNetwork.straight_road_network(4))
    found = 0
    sizes = {"7": (5.25, 2.0)}
    for _ in range(30):
        x, y = rng.uniform(100.0, 300.0, 12), rng.choice([0.0, 4.0, 8.0, 12.0], 12) + rng.uniform(-1, 1, 12)
        theirs.vehicles = [Vehicle(theirs, [a, b], 0.0, 20.0) for a, b in zip(x, y, strict=True)]
        still, turned = np.zeros(12), rng.uniform(-4.0, 4.0, 12)
        scene = Scene(tuple(map(str, range(12))), x, y, still + 20.0, turned, still > 0, 0.0, sizes=sizes)
        ego: Any = theirs.vehicles[0]
        start, end, own = ego.lane_index
        seen = neighbours_on(scene, ours, ego.lane_index)
        for side, lane in enumerate((own - 1, own, own + 1)):
            expected = [NOBODY, NOBODY]
            if 0 <= lane < 4:
                for place, other in enumerate(theirs.neighbour_vehicles(ego, (start, end, lane))):
                    if other is not None:
                        row = theirs.vehicles.index(other)
                        gap = abs(x[row] - x[0]) - 2.5 - scene.size(str(row))[0] / 2.0
                        expected[place] = Neighbour(str(row), gap, 20.0 * math.cos(turned[row]))
                        found += 1
            assert list(seen[2 * side : 2 * side + 2]) == expected
    assert found > 60


@pytest.mark.parametrize("hand", ["", "--lefthand=true"])
def test_on_a_network_they_are_sumo_s_beyond_junctions_too(tmp_path: Path, hand: str) -> None:
    """Against places on a straight road; left is left where people drive on the left."""
    busy = {"vehicles_count": 30, "spawn_probability": 0.8, "warm_up": 6, "observation": SEEN, "duration": 25}
    env = road(net(tmp_path, *filter(None, [hand])), 3, **busy)
    env.sumo.vehicle.setMinGap("ego", 1.0)  # SUMO's gaps lack that of the vehicle behind
    found = beyond = steps = 0
    over = False
    while not over:
        observation, _, over, late, _ = env.step(SLOWER if steps % 4 < 2 else FASTER)
        scene, place, steps, over = env.scene, env.scene.place, steps + 1, over or late
        assert place is not None
        if place.lane[0].startswith(":"):
            continue
        for side, (exists, dy) in enumerate(((place.left, -3.2), (True, 0.0), (place.right, 3.2))):
            gaps, speeds = [200.0, 200.0], [0.0, 0.0]  # [m], and [m/s] more than the ego's
            for row in range(1, len(scene)):
                dx = scene.x[row] - scene.x[0]
                far = abs(dx) - 5.0
                if exists and abs(scene.y[row] - scene.y[0] - dy) < 0.5 and far < gaps[int(dx < 0)]:
                    gaps[int(dx < 0)], speeds[int(dx < 0)] = far, scene.speed[row] - scene.speed[0]
                    beyond += place.lane[0] == "ab:from" and scene.x[row] > 310.0
            lane, ahead, faster, back, closing = observation[1 + 5 * side : 6 + 5 * side]
            assert lane == exists and (ahead, back) == pytest.approx(gaps, abs=0.2)
            assert (faster, closing) == pytest.approx(speeds, abs=1e-4)
            # the same as columns of Kinematics, without the follower in the own lane
            table = on_its_way(scene)
            for behind, name in enumerate(("leader", "follower")[: 1 + (side != 1)]):
                column = f"{('left_', '', 'right_')[side]}{name}"
                gap, nearer = exists * max(gaps[behind], 0.0), speeds[behind] if behind else -speeds[behind]
                assert min(table[f"{column}_gap"], 200.0) == pytest.approx(gap, abs=0.2)
                if gap < 200.0 or not place.neighbours[2 * side + behind].id:
                    assert table[f"{column}_closing"] == pytest.approx(nearer, abs=1e-4)
            found += (ahead < 200.0) + (back < 200.0)
    assert found > 50 and beyond


# -- info, and terms of a reward -----------------------------------------------------------------------------------


def test_info_has_acceleration_and_jerk() -> None:
    action = {"type": "ContinuousAction", "lateral": False, "acceleration_range": [-5, 5]}
    env = DrivingEnv("highway", {"action": action, "policy_frequency": 5, "vehicles_count": 0})
    _, info = env.reset(seed=0)
    assert (info["acceleration"], info["jerk"]) == (0.0, 0.0)
    for number, acceleration, jerk in ((0.4, 2.0, 10.0), (0.4, 2.0, 0.0), (-0.2, -1.0, -15.0)):
        *_, info = env.step(np.array([number], np.float32))
        assert (info["acceleration"], info["jerk"]) == pytest.approx((acceleration, jerk), abs=1e-4)


def test_fuel_is_what_sumo_says_on_request(tmp_path: Path) -> None:
    path = net(tmp_path)
    env = road(path, policy_frequency=10, measure_energy=True)
    for _ in range(20):
        *_, info = env.step(FASTER)
        burnt = 0.1 * env.sumo.vehicle.getFuelConsumption("ego")  # [mg], and the reward is for each gram
        assert (info["fuel"], 1e3 * info["rewards"]["fuel_reward"]) == pytest.approx((burnt, burnt))
        assert burnt > 0.0 == info["electricity"]
    electric = road(path, fuel_reward=-2.0, electricity_reward=-0.5)
    electric.sumo.vehicle.setEmissionClass("ego", "Energy/unknown")
    _, reward, _, _, info = electric.step(FASTER)
    terms = info["rewards"]
    assert info["electricity"] > 0.0 and terms["electricity_reward"] == info["electricity"]
    assert reward == pytest.approx(5 * terms["progress_reward"] - 0.5 * terms["electricity_reward"])
    quiet = road(path)
    assert quiet.step(FASTER)[4]["fuel"] == 0.0


def test_a_gap_and_braking_that_is_caused_cost(tmp_path: Path) -> None:
    """A car creeps ahead of the ego, and another one follows the ego, which brakes."""
    kind = '<vType id="{}" lcKeepRight="0" lcSpeedGain="0" {}/>'
    car = '<vehicle id="{}" type="{}" route="r" depart="{}" departLane="1" departSpeed="0"/>'
    ways = kind.format("slow", 'maxSpeed="3"') + kind.format("even", 'speedDev="0" sigma="0"')
    ways += '<route id="r" edges="ab bc"/>' + car.format("ahead", "slow", 0)
    ways += car.format("ego", "even", 25) + car.format("behind", "even", 27)
    weights = {"gap_reward": -1, "braking_reward": -0.1, "progress_reward": 0, "policy_frequency": 5}
    action = {"type": "DiscreteMetaAction", "lateral": False, "target_speeds": [3, 12]}
    files = net(tmp_path), route_file(tmp_path, ways)
    env = SumoDrivingEnv(*files, ego_vehicle="ego", config={**weights, "action": action})
    env.reset(seed=0)
    speed = env.sumo.vehicle.getSpeed
    gaps = braking = lost = 0.0
    brakes, slow = False, 0
    while slow < 15:
        assert env.scene.place is not None
        brakes |= env.scene.place.neighbours[2].gap < 16.0
        slow += brakes and env.scene.speed[0] < 3.5
        before = speed("behind")
        _, reward, _, _, info = env.step(0 if brakes else 2)  # SLOWER, FASTER
        terms = info["rewards"]
        lost += max(before - speed("behind"), 0.0) if before >= 0.0 else 0.0
        braking += terms["braking_reward"]
        gaps += terms["gap_reward"]
        left = env.scene.place.neighbours[2].gap / max(info["speed"], 1e-9)
        assert terms["gap_reward"] == pytest.approx(max(1.0 - left / 1.5, 0.0) / 5.0)
        assert reward == pytest.approx(-terms["gap_reward"] - 0.1 * terms["braking_reward"])
    assert gaps > 0.1 and braking == pytest.approx(lost, abs=0.01) and lost > 1.0


def test_comfort_counts_the_square_of_the_acceleration_over_time(tmp_path: Path) -> None:
    path = net(tmp_path)
    costs = []
    for frequency in (1, 10):
        action = {"type": "ContinuousAction", "lateral": False, "acceleration_range": [-4, 4]}
        env = road(path, action=action, policy_frequency=frequency, comfort_reward=-1, progress_reward=0)
        costs.append(sum(env.step(np.array([0.5], np.float32))[1] for _ in range(2 * frequency)))
        env.close()
    assert costs == pytest.approx([-8.0, -8.0], rel=1e-3)  # 2 s at 2 m/s2
