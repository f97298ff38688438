"""SUMO networks for tests, made by the tools of eclipse-sumo, and how episodes on them end."""

import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from sumo_env.scenarios import SumoDrivingEnv
from tests.sumo_env.rollout import drive

try:
    from sumo import SUMO_HOME  # of the eclipse-sumo wheel
except ImportError:
    SUMO_HOME = "nowhere"

SUMO = Path(SUMO_HOME) / "bin" / "sumo"  # itself: the script of this name beside Python starts a Python first
needs_sumo = pytest.mark.skipif(not SUMO.exists(), reason="needs eclipse-sumo: pip install '.[gui]'")
QUIET: dict[str, Any] = {"vehicles_count": 0, "spawn_probability": 0.0}
SUMO_DRIVES: dict[str, Any] = {"type": "DiscreteMetaAction", "longitudinal": "sumo", "lateral": "sumo"}
# Nodes, edges and connections, each as XML or as the values of KINDS with commas between, of which the last may lack.
Plan = tuple[str, ...]
KINDS = {"node": "id x y type", "edge": "id from to numLanes speed", "connection": "from fromLane to toLane"}


def streets(*names: str, lanes: int = 1) -> str:
    """Edges of a plan, each by the names of its two nodes."""
    return ", ".join(f"{name} {name[0]} {name[1]} {lanes} 14" for name in names)


def build(folder: Path, plan: Plan, *options: str) -> Path:
    """The network of a plan."""
    net = folder / "plan.net.xml"
    net.write_bytes(converted(plan, options))
    return net


@cache
def converted(plan: Plan, options: tuple[str, ...]) -> bytes:
    """What netconvert makes of a plan, which several tests drive on."""
    with tempfile.TemporaryDirectory() as folder:
        net = Path(folder) / "plan.net.xml"
        for (tag, names), text in zip(KINDS.items(), plan, strict=False):
            if "<" not in text:
                rows = [dict(zip(names.split(), row.split(), strict=False)) for row in text.split(",")]
                text = "".join(ElementTree.tostring(ElementTree.Element(tag, row), "unicode") for row in rows)
            file = net.with_name(f"{tag}s.xml")
            file.write_text(f"<{tag}s>{text}</{tag}s>")
            options += (f"--{tag}-files", str(file))
        subprocess.run([SUMO.with_name("netconvert"), *options, "-o", net], check=True, capture_output=True)
        return net.read_bytes()


def route_file(folder: Path, elements: str) -> Path:
    """A route file with these elements."""
    file = folder / "d.rou.xml"
    file.write_text(f"<routes>{elements}</routes>")
    return file


def grid(folder: Path, *options: str) -> Path:
    """A network of netgenerate."""
    net = folder / "grid.net.xml"
    command: list[str | Path] = [SUMO.with_name("netgenerate"), "--grid", *options, "-o", net]
    subprocess.run(command, check=True, capture_output=True)
    return net


def another(
    env: SumoDrivingEnv, route: Sequence[str], lane: str, position: float, speed: float = 0.0
) -> None:
    """The vehicle "another" on a lane [m], which keeps its speed [m/s] and its lane, whoever comes."""
    vehicle = env.sumo.vehicle
    env.sumo.route.add("another", route)
    vehicle.add("another", "another", departSpeed="0")
    vehicle.moveTo("another", lane, position)
    vehicle.setSpeedMode("another", 32)
    vehicle.setLaneChangeMode("another", 0)
    vehicle.setSpeed("another", speed)


Rows = dict[float, dict[str, dict[str, str]]]  # time [s] -> vehicle -> attributes


def floating_car_data(path: Path) -> Rows:
    steps = ElementTree.parse(path).getroot()
    cars = [{car.get("id", ""): car.attrib for car in now} for now in steps]
    return {round(float(now.get("time", "")), 2): there for now, there in zip(steps, cars, strict=True)}


def opened(configuration: Path) -> Rows:
    """What SUMO shows of a configuration, without a word."""
    out = configuration.with_suffix(".out.xml")
    command: list[str | Path] = [SUMO, "-c", configuration, "--fcd-output", out]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return floating_car_data(out)


def endings(env: SumoDrivingEnv, seeds: Iterable[int], actions: Iterable[int] | None = None) -> set[str]:
    """How episodes end, under these actions or random ones; all that is seen is finite."""
    found = set()
    for seed in seeds:
        chosen = np.random.default_rng(seed).integers(len(env.actions), size=1000).tolist()
        results = list(drive(env, chosen if actions is None else actions, seed))
        assert all(np.isfinite(seen).all() and np.isfinite(reward) for seen, reward, *_ in results)
        rewards = results[-1][4]["rewards"]
        terms = ("collision_reward", "arrived_reward", "missed_turn_reward")
        found |= {name for name in terms if rewards[name]} or {"time"}
    return found
