"""Whoever takes a vehicle's speed or lanes from SUMO gives them back: nothing commanded is left on other vehicles."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import libsumo
import numpy as np
import pytest

import sumo_env
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scenarios.risky import deviation
from sumo_env.scenarios.simulator import FileSimulator
from sumo_env.scene import Scene
from sumo_env.simulator import EgoCommand, Step
from sumo_env.sumo.session import ALL_CHECKS_OFF, COMMANDED_LANE_CHANGES, NO_RULES, OWN_LANE_CHANGES, REGULAR
from sumo_env.sumo.vehicle import modes
from sumo_env.sumo.world import SumoSimulator
from sumo_env.tasks import TASKS
from sumo_env.traffic.risk import RiskEvent, RiskRates, pushes
from sumo_env.traffic.scenario import Scenario
from tests.sumo_env.plans import SUMO_DRIVES, needs_sumo
from tests.sumo_env.scenarios import files
from tests.sumo_env.situations import draw
from tests.tasks import every_task

HZ = 10  # of policy steps too, so that every sub-step is looked at
KINDS = ("cut-in", "brake", "surge")
ENOUGH = pytest.param(range(2, 60), marks=pytest.mark.long)
PACKAGE = Path(sumo_env.__file__).parent
WRECKED = ALL_CHECKS_OFF, COMMANDED_LANE_CHANGES
FURTHER = 1e-6  # [m/s] that a speed may differ from SUMO's own


def event(kind: Any, vehicle: str, time: float, rng: np.random.Generator) -> RiskEvent:
    more = {"direction": int(rng.choice([-1, 1])), **pushes(RiskRates()).get(kind, {})}
    if kind == "surge":
        more["way"] = float(rng.choice([10.0, 40.0, 200.0]))
    return RiskEvent(time, vehicle, kind, **more)


def overlapping(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    """Each vehicle has two events at most three seconds apart, of all pairs of kinds in turn, and some a third one."""
    events, pairs = [], list(product(KINDS, KINDS))
    for number, spec in enumerate(rng.permutation([spec.id for spec in scenario.vehicles]).tolist()):
        start = float(rng.uniform(0.0, 3.0))
        kinds = [*pairs[(number + int(rng.integers(9))) % 9], *rng.choice(KINDS, int(rng.integers(2)))]
        times = [start, *(start + rng.uniform(0.0, 3.0, len(kinds) - 1)).tolist()]
        events += [event(kind, spec, time, rng) for kind, time in zip(kinds, times, strict=True)]
    return replace(scenario, events=tuple(sorted(events, key=lambda event: event.time)))


def test_one_module_commands_vehicles() -> None:
    """The session sets the first modes of what it adds."""
    setters = re.compile(r"set(SpeedMode|LaneChangeMode|Speed)\(")
    found = {file.name for file in PACKAGE.rglob("*.py") if setters.search(file.read_text(encoding="utf-8"))}
    assert found == {"vehicle.py", "session.py"}


class Watch:
    """Looks for vehicles that are commanded, though no event does it, and for crashed ones that are not."""

    def __init__(self, base: Callable[[str], tuple[int, int]]) -> None:
        """base: the modes in which SUMO drives a vehicle."""
        self._base = base

    def found(self, scene: Scene, returning: Collection[str] = ()) -> list[str]:
        """What is wrong after a sub-step.

        returning: SUMO's EIDM that gets its speed back within limits (`events.SETTLING`): it brakes less than it would
        by itself, and no more.
        """
        found, of = [], libsumo.vehicle
        for row, name in enumerate(scene.ids):
            if row < scene.cars or name in scene.in_event or not of.getLaneID(name):
                continue
            now, own = (of.getSpeedMode(name), of.getLaneChangeMode(name)), of.getSpeedWithoutTraCI(name)
            wanted = WRECKED if scene.crashed[row] else self._base(name)
            if now != wanted:
                found.append(f"{scene.time} s, {name}: modes {now}, not {wanted}")
            # SUMO itself stops a vehicle at once at a red light that a surge has brought it to; modes tell then
            stands = scene.crashed[row] or of.getSpeed(name) == 0.0
            if not stands and name not in returning and abs(of.getSpeed(name) - own) > FURTHER:
                found.append(f"{scene.time} s, {name}: {of.getSpeed(name)} m/s, by itself {own}")
        return found


def of_files(scenario: Scenario, name: str) -> tuple[int, int]:
    """The modes in which SUMO drives a vehicle of files at risk 1."""
    assert scenario.traffic is not None
    models = dict(scenario.traffic.models)
    model = models.get(libsumo.vehicle.getTypeID(name).partition("@")[0], "")
    gives_way = deviation(scenario.traffic.ranges, 1.0, scenario.seed, name, model)["gives_way"]
    return REGULAR if gives_way else NO_RULES, OWN_LANE_CHANGES


@every_task
@pytest.mark.parametrize("seeds", [range(2), ENOUGH])
def test_after_any_events_a_vehicle_of_a_task_is_sumo_s(
    simulator: SumoSimulator, task: str, seeds: range
) -> None:
    for seed in seeds:
        rng = np.random.default_rng(seed)
        level = list(TASKS[task].levels.values())[-1]
        drawn = draw(
            task, seed, **{**level, "simulation_frequency": HZ, "policy_frequency": HZ, "risk": seed % 2}
        )
        scenario = overlapping(drawn, rng)
        specs = {spec.id: spec for spec in (*scenario.vehicles, *(one.vehicle for one in scenario.spawns))}
        base = {
            name: WRECKED if spec.is_obstacle else modes(spec, scenario.calibration)
            for name, spec in specs.items()
        }
        watch = Watch(base.__getitem__)
        simulator.reset(scenario)
        speed, lane, acted = scenario.ego.speed, scenario.ego.lane, set[str]()
        for _ in range(9 * HZ):
            step: Step = simulator.step({"ego": EgoCommand(speed, lane)})
            lane = step.ego.target_lane
            acted |= step.scene.in_event
            assert watch.found(step.scene) == []
            if step.ego.crash and step.scene.time > 8.0:
                break
        assert len(acted) > 1


@needs_sumo
@pytest.mark.parametrize("name", ["static", "actuated"])
@pytest.mark.parametrize("seeds", [range(2), ENOUGH])
def test_after_any_events_a_vehicle_of_files_is_sumo_s(tmp_path: Path, name: str, seeds: range) -> None:
    """Drivers that do not give way do not give way after an event either."""
    config = {"risk": 1.0, "policy_frequency": HZ, "duration": 40, "action": SUMO_DRIVES}
    simulator, net = FileSimulator({}), files.written(tmp_path / name, name)
    env = SumoDrivingEnv(net, ego_vehicle="ego", config=config, simulator=simulator)
    rates = {"cut_in": 0.3, "brake": 0.3, "surge": 0.3}
    acted = set[str]()
    for seed in seeds:
        env.reset(seed=seed, options={"risk_rates": rates})
        watch = Watch(partial(of_files, env.scenario))

        over = False
        while not over:
            *_, over, late, _ = env.step(0)
            acted |= env.scene.in_event
            assert simulator._events and watch.found(env.scene, simulator._events._returning) == []
            over = over or late
    env.close()
    assert len(acted) > 10
