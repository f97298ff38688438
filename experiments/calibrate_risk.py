"""What a dose of risky traffic does: to the ego, by driver, and to the traffic itself, in both simulators.

    python experiments/calibrate_risk.py --out results/risk                      # an hour and a half on one core
    python experiments/calibrate_risk.py --out /tmp/risk --episodes 10 --tasks u-turn --backends sumo

Writes risk.csv (a row for each simulator, task, dose and driver of the ego) and risk.png. The rates of the tasks' risk
events (`risk_rates` in sumo_env/tasks) were chosen by this table; docs/decisions.md, "Risk", says how. Rows that are
there already are not measured again.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.support.threads import limit_threads

limit_threads()

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise, product
from typing import Any

import numpy as np
import pandas as pd
import tyro
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from agents.rules import make_policy
from experiments.study.grid import BACKENDS, choose_tasks
from experiments.study.seeds import stream_seed
from experiments.support.errors import run_command, unknown
from experiments.support.substeps import RecordedEnv
from experiments.validation.stage import open_env
from sumo_env.models.mobil import MIN_GAIN, SAFE_BRAKING, closest_lanes, criteria
from sumo_env.safety import NEAR_MISS_TTC, pair_ttc
from sumo_env.scenario import EGO
from sumo_env.scene import Scene
from sumo_env.tasks import TASKS, get_task

POLICIES = ("idle", "slower", "faster", "idm", "careful")
KEYS = ["backend", "task", "level", "dose", "episodes"]  # what makes a measurement
LANE_WIDTH = 4.0  # [m]
# sub-steps from the decision to change lane to the last scene on the old lane: half of the way takes 0.47 s
HALF_CHANGE = 4
COLOURS = {
    "idle": "#56b4e9",
    "slower": "#009e73",
    "faster": "#d55e00",
    "idm": "#cc79a7",
    "careful": "#000000",
}


@dataclass(frozen=True)
class Options:
    """What a dose of risky traffic does: to the ego, by driver, and to the traffic itself."""

    out: Path
    """Directory for risk.csv and risk.png."""
    tasks: tuple[str, ...] = ()
    """Some of highway, two-way, roundabout, intersection, u-turn (default: all)."""
    backends: tuple[str, ...] = BACKENDS
    """Simulators: sumo, highway-env or both."""
    level: int = 1
    """Traffic level, 1 is the lowest."""
    doses: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0)
    """Doses of risky traffic."""
    episodes: int = 100
    """Scenarios, the same ones for every dose and driver."""


@dataclass
class TrafficLog:
    """What the other vehicles do, summed over episodes. Pairs count once an episode; wrecks do not count on.

    Attributes:
        hours: vehicle-hours of the other vehicles before they crash.
        crashes: other vehicles that became wrecks, the one that the ego hit left out.
        near_misses: pairs whose time to collision fell below 1.5 s, neither of them a wreck in the end. Velocities are
            extrapolated straight, so that on bends cars side by side count too.
        accelerations: realised, over one sub-step each [m/s2]; one array an episode.
        changes, violations: lane changes judged by MOBIL's criteria, and those that break one (highway on SUMO only).
    """

    hours: float = 0.0
    crashes: int = 0
    near_misses: int = 0
    accelerations: list[np.ndarray] = field(default_factory=list)
    changes: int = 0
    violations: int = 0

    def add(self, env: Any, hit: str | None) -> None:
        """Count the episode that `env` has just played. `hit`: the vehicle that the ego crashed with."""
        scenes = env.scenes
        wrecks: set[str] = set()
        endangered: set[frozenset[str]] = set()
        accelerations = []
        for before, now in pairwise(scenes):
            rows = _others(before)
            self.hours += len(rows) * (now.time - before.time) / 3600.0
            accelerations.append(_accelerations(before, now, rows))
            wrecks |= {now.ids[row] for row in np.flatnonzero(now.crashed)}
            endangered |= set(_pairs_near(now))
        self.crashes += len(wrecks - {EGO, hit})
        self.near_misses += sum(not pair & wrecks for pair in endangered)
        self.accelerations.append(np.concatenate(accelerations))
        if env.task.name == "highway" and isinstance(env, RecordedEnv):
            self._judge_lane_changes(env)

    def _judge_lane_changes(self, env: RecordedEnv) -> None:
        world, scenes = env._world, env.scenes
        assert world is not None
        lanes_count = int(env.config["lanes_count"])
        lanes = [closest_lanes(scene.y, lanes_count, LANE_WIDTH) for scene in scenes]
        for k in range(HALF_CHANGE + 1, len(scenes)):
            for row in np.flatnonzero(lanes[k] != lanes[k - 1]):
                scene = scenes[k - HALF_CHANGE - 1]
                if row == 0 or scenes[k].crashed[row]:
                    continue
                imposed, gain = criteria(
                    int(row), int(lanes[k][row]), scene.x, scene.y, scene.speed, scene.heading,
                    lanes[k - HALF_CHANGE - 1], world.target_speed, world.drivers, LANE_WIDTH,
                    world.road_length, world.limit,
                )  # fmt: skip
                self.changes += 1
                self.violations += imposed < -SAFE_BRAKING or gain < MIN_GAIN

    def summary(self, episodes: int) -> dict[str, float]:
        """Rates by vehicle-hour and by episode, and percentiles of the accelerations [m/s2]."""
        low, high = np.percentile(np.concatenate(self.accelerations), [1, 99])
        return {
            "crashes_per_vehicle_hour": self.crashes / self.hours,
            "near_misses_per_vehicle_hour": self.near_misses / self.hours,
            "wrecks_per_episode": self.crashes / episodes,
            "acceleration_p1": float(low),
            "acceleration_p99": float(high),
            "lane_changes": float(self.changes),
            "violating_mobil": self.violations / self.changes if self.changes else float("nan"),
        }


def _others(scene: Scene) -> np.ndarray:
    """Rows of the other vehicles that still drive."""
    return np.flatnonzero(~scene.crashed[1:]) + 1


def _accelerations(before: Scene, now: Scene, rows: np.ndarray) -> np.ndarray:
    at = {name: row for row, name in enumerate(now.ids)}
    kept = [(row, at[before.ids[row]]) for row in rows if before.ids[row] in at]
    kept = [(old, new) for old, new in kept if not now.crashed[new]]
    return np.array([now.speed[new] - before.speed[old] for old, new in kept]) / (now.time - before.time)


def _pairs_near(scene: Scene) -> Iterator[frozenset[str]]:
    rows = _others(scene)
    x, y, vx, vy, heading = (a[rows] for a in (scene.x, scene.y, scene.vx, scene.vy, scene.heading))
    for i, j in np.argwhere(pair_ttc(x, y, vx, vy, heading, NEAR_MISS_TTC) < NEAR_MISS_TTC):
        yield frozenset((scene.ids[rows[i]], scene.ids[rows[j]]))


def recorded(backend: str, task: str, config: dict[str, Any]) -> Any:
    """An environment that keeps the scenes after every sub-step of an episode as `scenes`."""
    if backend == "sumo":
        return RecordedEnv(task, config)
    env: Any = open_env(backend, task, config).unwrapped
    look, reset = env._scene, env.reset

    def scene() -> Scene:
        found = look()
        if not env.scenes or found.time > env.scenes[-1].time:  # it is also asked for in between
            env.scenes.append(found)
        return found

    def start(**arguments: Any) -> Any:
        env.scenes = []
        return reset(**arguments)

    env._scene, env.reset = scene, start
    return env


def measure(backend: str, task: str, level: int, dose: float, episodes: int) -> list[dict[str, Any]]:
    """A row for each driver of the ego; the measures of the traffic are over the episodes of all of them."""
    settings = list(get_task(task).levels.values())[level - 1]
    env = recorded(backend, task, {**settings, "risk": dose})
    traffic = TrafficLog()
    rows = []
    for name in POLICIES:
        policy = make_policy(name, env)
        outcomes = [
            _play(env, policy, stream_seed("risk dose", task, level, k), traffic) for k in range(episodes)
        ]
        means = {key: float(np.mean([outcome[key] for outcome in outcomes])) for key in outcomes[0]}
        rows.append(
            {
                "backend": backend,
                "task": task,
                "level": level,
                "dose": dose,
                "policy": name,
                "episodes": episodes,
                **means,
            }
        )
    env.close()
    summary = traffic.summary(episodes * len(POLICIES))
    return [{**row, **summary} for row in rows]


def _play(env: Any, policy: Any, seed: int, traffic: TrafficLog) -> dict[str, float]:
    observation, _ = env.reset(seed=seed)
    policy.reset(seed)
    speeds, near_misses, total = [], 0, 0.0
    ended = False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        speeds.append(info["speed"])
        near_misses += info["near_miss"]
        total += reward
        ended = terminated or truncated
    traffic.add(env, info["crash"].get("other"))
    return {
        "crash_rate": float(info["crashed"]),
        "return": total,
        "length": float(len(speeds)),
        "mean_speed": float(np.mean(speeds)),
        "ego_near_misses": float(near_misses),
    }


def draw(table: pd.DataFrame, path: Path) -> None:
    """The dose-response curves: the ego above, the traffic below, a column for each task; highway-env dashed."""
    tasks = list(dict.fromkeys(table["task"]))
    present = [backend for backend in BACKENDS if (table["backend"] == backend).any()]
    figure, axes = plt.subplots(2, len(tasks), figsize=(max(2.6 * len(tasks), 4.0), 5.4), squeeze=False, sharex=True)
    for column, task in enumerate(tasks):
        for backend, style in zip(present, ("-", "--"), strict=False):
            rows = table[(table["task"] == task) & (table["backend"] == backend)]
            if len(rows):
                _draw_ego(axes[0, column], rows, style)
                _draw_traffic(axes[1, column], rows[rows["policy"] == POLICIES[0]], style)
        axes[0, column].set_title(task)
        for axis in axes[:, column]:
            axis.set_ylim(bottom=0)
            axis.spines[["top", "right"]].set_visible(False)
            axis.tick_params(labelsize=8)
        axes[1, column].set_xlabel("dose")
    for place, row in zip((0.07, 0.0), axes, strict=True):
        handles, labels = row[0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="lower center", bbox_to_anchor=(0.5, place), ncols=5, fontsize=8, frameon=False
        )
    figure.tight_layout(rect=(0, 0.12, 1, 1))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_ego(axis: Axes, rows: pd.DataFrame, style: str) -> None:
    survival = bool((rows["task"] == "two-way").all())  # where every driver that does not overtake crashes
    for name, group in rows.groupby("policy", sort=False):
        values = group["length"] if survival else 100 * group["crash_rate"]
        label = str(name) if style == "-" else None
        axis.plot(
            group["dose"], values, style, marker="o", ms=3, lw=1.2, color=COLOURS[str(name)], label=label
        )
    axis.set_ylabel("episode length [s]" if survival else "crashes of the ego [% of episodes]", fontsize=8)


def _draw_traffic(axis: Axes, rows: pd.DataFrame, style: str) -> None:
    for key, marker, colour in (("near_misses", "o", "#999999"), ("crashes", "s", "#333333")):
        label = key.replace("_", "-") if style == "-" else None
        values = rows[f"{key}_per_vehicle_hour"]
        axis.plot(rows["dose"], values, style, marker=marker, ms=3, lw=1.2, color=colour, label=label)
    axis.set_ylabel("traffic [1 / vehicle-hour]", fontsize=8)


def run(options: Options) -> int:
    """Measure, print and write; the exit status."""
    for backend in options.backends:
        if backend not in BACKENDS:
            raise unknown("backend", backend, BACKENDS)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "risk.csv"
    done = pd.read_csv(path) if path.exists() else pd.DataFrame(columns=KEYS)
    parts = []
    for task in choose_tasks(options.tasks or tuple(TASKS)):
        for backend, dose in product(options.backends, options.doses):
            key = (backend, task, options.level, dose, options.episodes)
            part = done[(done[KEYS] == list(key)).all(axis=1)]
            if len(part) < len(POLICIES):
                part = pd.DataFrame(measure(*key)).round(4)
                done = pd.concat([done, part]) if len(done) else part
                done.to_csv(path, index=False)
                print(part.drop(columns="level").round(2).to_string(index=False), flush=True)
            parts.append(part)
    draw(pd.concat(parts), options.out / "risk.png")
    return 0


def main() -> int:
    """The command line."""
    return run(tyro.cli(Options, description=__doc__))


if __name__ == "__main__":
    run_command(main)
