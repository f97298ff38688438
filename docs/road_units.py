"""What a dose of risk is in units of the road: ``python docs/road_units.py [SCENARIOS] [TASK ..]``.

The other vehicles in the lightest traffic of each task, around the careful driver, at five doses; the same
scenarios at each. Rates are per vehicle and minute. The first SETTLED seconds do not count: vehicles are placed faster
than the limit and closer than they like, as in highway-env, and brake hard at once.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from agents.rules import make_policy
from experiments.study.design.arms import scenario_seed
from experiments.validation.episodes import traffic_near
from sumo_env.contacts.measures import headways
from sumo_env.env import DrivingEnv
from sumo_env.scene import Scene
from sumo_env.simulator import Commands, Step
from sumo_env.sumo.process import SumoProcess
from sumo_env.tasks import TASKS
from sumo_env.traffic.scenario import Scenario

DOSES = (0.0, 0.25, 0.5, 0.75, 1.0)
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


def episodes(task: str, dose: float, count: int) -> Iterator[tuple[Scenario, list[Scene]]]:
    """Scenarios and their scenes, one a sub-step, until the episode ends."""
    level = next(iter(TASKS[task].levels.values()))
    simulator = Traced(here=True)
    with closing(DrivingEnv(task, {**level, "risk": dose}, simulator=simulator)) as env:
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


def measures(task: str, dose: float, count: int) -> list[float]:
    """Vehicle-minutes, quantiles of the headway, its share below 1 s, rates of braking, cut-ins, lane changes."""
    times, changes, minutes, braking, cut_ins = [], [], 0.0, np.zeros(len(HARD)), 0
    for scenario, scenes in episodes(task, dose, count):
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
    quantiles = np.quantile(times, (0.05, 0.5)) if times else (np.nan, np.nan)
    share = float(np.mean(np.array(times) < 1.0)) if times else np.nan
    return [minutes, *quantiles, share, *(braking / minutes), cut_ins / minutes, float(np.mean(changes))]


def main(count: int, tasks: list[str]) -> None:
    """Print the table."""
    names = ["task", "dose", "vehicle-minutes", "headway, 5 and 50 % [s]", "below 1 s"]
    names += ["braking > 3 m/s2", "> 4.4 m/s2", "cut-ins", "lane changes"]
    print("|", " | ".join(names), "|")
    print("|---|---|---|---|---|---|---|---|---|")
    for task in tasks:
        for dose in DOSES:
            minutes, low, middle, share, *rates = measures(task, dose, count)
            shown = " | ".join(f"{rate:.2f}" for rate in rates)
            print(
                f"| {task} | {dose} | {minutes:.0f} | {low:.1f}, {middle:.1f} | {share:.0%} | {shown} |",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40, sys.argv[2:] or list(TASKS))
