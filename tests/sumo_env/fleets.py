"""Random fleets on random networks: whatever they do, an episode ends by itself or by a `SimulatorError`.

    python -m tests.sumo_env.fleets FIRST NUMBER

drives fleets with seeds from FIRST on, one after another in one process, and prints a line of JSON for each.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

import sumo_env
from sumo_env.config import ConfigError
from sumo_env.simulator import SimulatorError
from tests.sumo_env.plans import SUMO, route_file

EPISODES = 2  # of a fleet
MOST = 60  # policy steps of an episode
TYPES = (
    '<vType id="cav" accel="3" decel="5"/>',
    '<vType id="cav" carFollowModel="IDM"/>',
    '<vType id="cav" vClass="truck" length="12"/>',
)
SHAPES = {
    "grid": ("--grid", "--grid.number=3", "--grid.length=90"),
    "spider": ("--spider", "--spider.arm-number=4", "--spider.circle-number=2", "--spider.space-radius=60"),
    "rand": ("--rand", "--rand.iterations=12", "--rand.min-distance=50", "--rand.max-distance=120"),
}


def network(folder: Path, rng: np.random.Generator) -> Path:
    """A network of netgenerate."""
    net = folder / "random.net.xml"
    command: list[Any] = [SUMO.with_name("netgenerate"), *SHAPES[rng.choice(list(SHAPES))]]
    command += [f"--seed={rng.integers(1000)}", f"--default.lanenumber={rng.integers(1, 4)}", "-o", net]
    kinds = ["priority", "right_before_left", "traffic_light", "allway_stop"]
    command.append(f"--default-junction-type={rng.choice(kinds)}")
    if rng.random() < 0.5:
        command.append("--no-turnarounds")
    subprocess.run(command, check=True, capture_output=True)
    return net


def traffic(folder: Path, net: Path, rng: np.random.Generator) -> Path:
    """Vehicles between random edges, some of them learning cars."""
    from sumolib.net import readNet

    edges = [edge.getID() for edge in readNet(str(net)).getEdges()]
    rows = [(float(rng.uniform(0, 20)), "cav") for _ in range(8)]
    rows += [(float(rng.uniform(0, 40)), "DEFAULT_VEHTYPE") for _ in range(60)]
    trips = ""
    for number, (depart, kind) in enumerate(sorted(rows)):
        begin, end = rng.choice(edges, 2)
        trips += (
            f'<trip id="t{number}" type="{kind}" depart="{depart:.1f}" from="{begin}" to="{end}" '
            'departLane="random" departSpeed="max"/>'
        )
    return route_file(folder, str(rng.choice(TYPES)) + trips)


def drive(folder: Path, seed: int) -> dict[str, Any]:
    """Episodes of a random fleet: what they said, and what was wrong with them."""
    rng = np.random.default_rng(seed)
    net = network(folder, rng)
    routes = traffic(folder, net, rng)
    config = {
        "duration": int(rng.integers(20, MOST)),
        "risk": float(rng.integers(2)),
        "policy_frequency": int(rng.choice([1, 2])),
        "action": {"type": "DiscreteMetaAction", "target_speeds": [0.0, 7.0, 20.0]},
    }
    options = [f"--time-to-teleport={rng.choice([2, 5, 10, 300])}", "--ignore-route-errors=true"]
    removes = bool(rng.integers(2))
    found: dict[str, Any] = {"seed": seed, "endings": Counter(), "errors": [], "wrong": []}
    try:
        env = sumo_env.parallel_env(
            net,
            config,
            routes=routes,
            vehicle_type="cav",
            max_cars=6,
            remove_crashed=removes,
            sumo_options=options,
        )
        try:
            for episode in range(EPISODES):
                try:
                    _episode(env, seed + episode, rng, found)
                except SimulatorError as error:
                    found["errors"].append(str(error)[:300])
                except Exception as error:
                    trace = traceback.extract_tb(error.__traceback__)
                    found["wrong"].append(f"{error!r} at {trace[-1].filename}, {trace[-1].lineno}")
        finally:
            env.close()
    except ConfigError as error:
        found["errors"].append(str(error)[:300])
    return found


def _episode(env: Any, seed: int, rng: np.random.Generator, found: dict[str, Any]) -> None:
    paid, driven, ways = Counter[str](), Counter[str](), dict[str, float]()
    crashes: dict[str, dict[str, Any]] = {}
    keeps = {agent: int(rng.integers(5)) for agent in env.possible_agents}  # favourite actions
    env.reset(seed=seed)
    steps = 0
    while env.agents and steps < 2 * MOST:
        for agent in env.agents:
            ways.setdefault(agent, _way(env.cars["car_0"].sumo, env.ids[agent]))
            if rng.random() < 0.05:
                env.cars[agent].hand_over(bool(rng.integers(2)))
        actions = {a: keeps[a] if rng.random() < 0.6 else int(rng.integers(5)) for a in env.agents}
        _, rewards, ends, _, infos = env.step(actions)
        steps += 1
        for agent in actions:
            info = infos[agent]
            paid[agent] += rewards[agent]
            driven[agent] += info["distance"]
            if info["crash"]:
                crashes[env.ids[agent]] = info["crash"]
            if ends[agent]:
                found["endings"][info["ending"]] += 1
            if info["ending"] == "arrived" and driven[agent] < 0.95 * ways[agent]:
                found["wrong"].append(f"{agent} arrived after {driven[agent]:.1f} of {ways[agent]:.1f} m")
            if paid[agent] > 10.0 + 1e-6:
                found["wrong"].append(f"{agent} was paid {paid[agent]:.3f} of 10")
    for one, other in combinations(crashes, 2):
        if crashes[one]["other"] == other and crashes[other]["other"] == one:
            found["endings"]["pairs"] += 1
            found["wrong"] += mismatch(crashes[one], crashes[other])


def _way(sumo: Any, ego: str) -> float:
    """What is left of a car's route [m], without the ways through junctions."""
    vehicle, lane = sumo.vehicle, sumo.lane
    edges = vehicle.getRoute(ego)[max(vehicle.getRouteIndex(ego), 0) :]
    lengths = [lane.getLength(f"{edge}_0") for edge in edges]
    if vehicle.getRoadID(ego) == edges[0]:
        lengths[0] -= vehicle.getLanePosition(ego)
    return float(sum(lengths))


def mismatch(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """What two records of one contact do not agree on."""
    apart = [float(np.hypot(crash["relative_x"], crash["relative_y"])) for crash in (one, other)]
    turn = (one["relative_heading"] + other["relative_heading"] + np.pi) % (2 * np.pi) - np.pi
    wrong = []
    if abs(apart[0] - apart[1]) > 1e-6 or abs(turn) > 1e-6:
        wrong.append(f"one contact at {apart[0]:.2f} and {apart[1]:.2f} m, {turn:.2f} rad")
    wrong += [
        f"one contact with two {key}s: {one[key]}, {other[key]}"
        for key in ("type", "time", "detected_by")
        if one[key] != other[key]
    ]
    return wrong


def main() -> None:
    """See the module."""
    first, number = map(int, sys.argv[1:])
    for seed in range(first, first + number):
        with tempfile.TemporaryDirectory() as folder:
            print(json.dumps(drive(Path(folder), seed)), flush=True)


if __name__ == "__main__":
    main()
