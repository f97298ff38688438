"""Risk in units of the road: ``python docs/road_units.py [TASK ..]`` writes results/road-units.parquet (all tasks).

The other vehicles in the lightest traffic of each task, around the careful driver: at five doses, and measured drivers
(`sumo_env.traffic.measured`); the same scenarios in each. Rates are per vehicle and minute. The first SETTLED seconds
do not count: vehicles are placed faster than the limit and closer than they like, as in highway-env, and brake at once.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from agents.rules import make_policy
from experiments.study.design.arms import scenario_seed
from experiments.study.design.sheet import GRID
from experiments.validation.episodes import traffic_near
from sumo_env.contacts.measures import headways
from sumo_env.env import DrivingEnv
from sumo_env.scene import Scene
from sumo_env.simulator import Commands, Step
from sumo_env.sumo.process import SumoProcess
from sumo_env.tasks import TASKS
from sumo_env.traffic.scenario import Scenario

TABLE = Path(__file__).resolve().parents[1] / "results" / "road-units.parquet"
TRAFFICS: dict[str, Mapping[str, Any]] = {
    **{f"{dose:g}": {"risk": dose} for dose in (0.0, 0.25, 0.5, 0.75, 1.0)},
    "measured": {"drivers": "measured"},
}
SCENARIOS = {"highway": 40}  # of the others 100
SETTLED = 3.0  # [s]
HARD = (3.0, 4.4)  # [m/s2] harsh braking of UDRIVE's trucks, and 0.45 g


class Traced(SumoProcess):
    """SUMO that keeps the scene after every sub-step."""

    def reset(self, scenario: Scenario) -> Scene:
        """Begin an episode."""
        self.scenes = [super().reset(scenario)]
        return self.scenes[0]

    def step(self, commands: Commands, trace: bool = False) -> Step:
        """Drive one policy step."""
        step = super().step(commands, trace=True)
        self.scenes += step.trace
        return step


def episodes(task: str, config: Mapping[str, Any], count: int) -> Iterator[tuple[Scenario, list[Scene]]]:
    """Scenarios and their scenes, one a sub-step, until the episode ends."""
    level = next(iter(TASKS[task].levels.values()))
    simulator = Traced(here=True)
    with closing(DrivingEnv(task, {**level, **config}, simulator=simulator)) as env:
        policy = make_policy("careful", env)
        for number in range(count):
            seed = scenario_seed(task, 1, number, "gate")
            observation, _ = env.reset(seed=seed)
            policy.reset(seed)
            over = False
            while not over:
                observation, _, terminated, truncated, _ = env.step(policy.act(observation))
                over = terminated or truncated
            assert env.scenario is not None
            yield env.scenario, simulator.scenes


def measures(task: str, config: Mapping[str, Any], count: int) -> dict[str, float]:
    """Vehicle-minutes, quantiles of the headway [s], its share below 1 s, rates of braking, cut-ins, lane changes."""
    times, changes, minutes, braking, cut_ins = [], [], 0.0, np.zeros(len(HARD)), 0
    for scenario, scenes in episodes(task, config, count):
        dt = 1.0 / scenario.simulation_frequency
        first = round(SETTLED / dt)
        speeds: dict[str, float] = {}
        hard = {limit: set[str]() for limit in HARD}  # vehicles that brake so hard now
        for number, scene in enumerate(scenes[first:]):
            driving = ~scene.crashed
            driving[0] = False
            rows = np.flatnonzero(driving)
            now = {scene.ids[row]: float(scene.speed[row]) for row in rows}
            minutes += len(rows) * dt / 60.0
            for k, limit in enumerate(HARD):
                at = {name for name, speed in now.items() if speeds.get(name, speed) - speed > limit * dt}
                braking[k] += len(at - hard[limit])
                hard[limit] = at
            speeds = now
            if number % scenario.simulation_frequency == 0:
                gaps = headways(*map(np.ascontiguousarray, (scene.x, scene.y, scene.speed, scene.heading)))
                times += gaps[driving & np.isfinite(gaps)].tolist()
        seconds = scenes[first :: scenario.simulation_frequency]
        if len(seconds) > 1:
            changes.append(traffic_near(seconds, task, scenario.road, 1.0)["lane_changes"])
        for event in scenario.events:
            after = math.ceil(event.time / dt) + 1  # the scene after the sub-step in which it begins
            if event.kind == "cut-in" and first < after < len(scenes):
                cut_ins += event.vehicle in scenes[after].in_event
    headway = np.array(times)
    return {
        "minutes": minutes,
        "headway_5": float(np.quantile(headway, 0.05)),
        "headway": float(np.median(headway)),
        "below_1": float(np.mean(headway < 1.0)),
        **{f"braking_{limit:g}": float(rate) for limit, rate in zip(HARD, braking / minutes, strict=True)},
        "cut_ins": cut_ins / minutes,
        "lane_changes": float(np.mean(changes)),
    }


def main(tasks: list[str]) -> None:
    """Write the lines of these tasks."""
    before = pd.read_parquet(TABLE) if TABLE.exists() else pd.DataFrame(columns=["task"])
    lines = [before[~before["task"].isin(tasks)]]
    for task in tasks:
        for traffic, config in TRAFFICS.items():
            line = {"task": task, "traffic": traffic, **measures(task, config, SCENARIOS.get(task, 100))}
            print(line, flush=True)
            lines.append(pd.DataFrame([line]))
    table = pd.concat([part for part in lines if len(part)])
    table = table.sort_values(["task"], key=lambda names: names.map(list(TASKS).index), kind="stable")
    table.to_parquet(TABLE, index=False)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    known = ", ".join(TASKS)
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=f"of {known}; by default the study's")
    named = parser.parse_args().tasks or list(GRID)
    if unknown := set(named) - TASKS.keys():
        parser.error(f"unknown task {sorted(unknown)[0]!r}: choose from {known}")
    main(named)
