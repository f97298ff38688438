"""How well crashes are noticed: SUMO's detection, our separating-axis test, and both, against exact contacts.

    python experiments/collision_corpus.py --out results/collisions               # half an hour on one core
    python experiments/collision_corpus.py --out /tmp/collisions --cases 50 --tasks u-turn

An ego that acts at random drives in regular and in risky traffic. Detectors are only watched: nobody becomes a wreck,
so that what follows a report shows whether it was true. The truth is the distance of shapely polygons along the
trajectories, interpolated to 5 ms. Cases are an ego's first contact with a vehicle, and near-contacts: vehicles that
came closer than 0.5 m and never touched. Pairs of other vehicles are kept as well and counted apart. Writes
corpus.csv (a row a case), detection.csv and detection.png; docs/collisions.md reads them.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.support.threads import limit_threads

limit_threads()

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import shapely
import tyro
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from experiments.study.grid import choose_tasks
from experiments.study.seeds import stream_seed
from experiments.support.errors import run_command
from sumo_env.collision import DIAGONAL, LENGTH, WIDTH, classify, contacts, distance
from sumo_env.env import DrivingEnv
from sumo_env.tasks import TASKS, get_task
from sumo_env.world import World

PARTS = 20  # of a sub-step of 0.1 s: the truth is looked at every 5 ms
EVERY = 4  # parts between two looks of the "swept" test: 20 ms
NEAR = 0.5  # [m] a vehicle that comes closer without contact is a near-contact
FOLLOW_UP = (
    1.0  # [s] after the ego's first contact; also how far a report may be from the contact that it means
)
TOLERANCE = (
    0.25  # [m] how far apart the cars may be for SUMO's report to count, in two of the detectors compared
)
CORNERS = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * (LENGTH / 2, WIDTH / 2)


@dataclass(frozen=True)
class Options:
    """How well crashes are noticed: SUMO's detection, our separating-axis test, and both."""

    out: Path
    """Directory for corpus.csv, detection.csv and detection.png."""
    tasks: tuple[str, ...] = ()
    """Some of highway, two-way, roundabout, intersection, u-turn (default: all)."""
    cases: int = 1000
    """Cases of each task with the ego in them; half of them in risky traffic."""


@dataclass
class Encounter:
    """Two vehicles in one episode.

    Attributes:
        closest: least distance [m] that the polygons ever had, 0 in contact.
        contact: time of the first contact [s], inf without one; kind: its type (`collision.classify`).
        depth: deepest penetration in the second after the first contact [m].
        reports: (time [s], distance of the rectangles [m]) of SUMO's reports.
        seen: times at which the separating-axis test found a contact [s].
        swept: whether that test, made every 20 ms on the way through the sub-step, found one.
    """

    closest: float = math.inf
    contact: float = math.inf
    kind: str = ""
    depth: float = 0.0
    reports: list[tuple[float, float]] = field(default_factory=list)
    seen: list[float] = field(default_factory=list)
    swept: bool = False


Pose = tuple[float, float, float]


def polygons(poses: NDArray[np.float64]) -> NDArray[Any]:
    """Shapely polygons of vehicles, shape (n,), from x, y [m] and heading [rad], shape (n, 3)."""
    cos, sin = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x = poses[:, :1] + cos * CORNERS[:, 0] - sin * CORNERS[:, 1]
    y = poses[:, 1:2] + sin * CORNERS[:, 0] + cos * CORNERS[:, 1]
    return np.asarray(shapely.polygons(np.stack([x, y], axis=-1)))


def between(before: Pose, now: Pose) -> NDArray[np.float64]:
    """Poses on the straight way from one to the other, without the first, shape (PARTS, 3)."""
    turn = (now[2] - before[2] + math.pi) % (2 * math.pi) - math.pi
    change = np.array([now[0] - before[0], now[1] - before[1], turn])
    return np.array(before) + np.linspace(1 / PARTS, 1, PARTS)[:, None] * change


def _signed_distance(first: Sequence[float], second: Sequence[float]) -> float:
    """`collision.distance` of two poses [m], negative in contact."""
    (x, y, heading), (x2, y2, heading2) = first, second
    return distance(x, y, heading, x2, y2, heading2, LENGTH, WIDTH)


def _near(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Pairs i < j of vehicles so close that they may touch within a sub-step, shape (n, n)."""
    apart = np.hypot(x[:, None] - x[None, :], y[:, None] - y[None, :])
    return np.triu(apart < 2 * DIAGONAL, k=1)


class WatchedEnv(DrivingEnv):
    """Both detectors report, and nothing follows from it.

    Attributes:
        encounters: by row of the vehicles' names; the ego, if it is one of them, comes first.
    """

    encounters: defaultdict[tuple[str, str], Encounter]

    def reset(self, **arguments: Any) -> tuple[NDArray[Any], dict[str, Any]]:
        """Start an episode and a new record."""
        self.encounters = defaultdict(Encounter)
        self._poses: dict[str, Pose] = {}
        return super().reset(**arguments)

    def _open_world(self) -> World:
        world = super()._open_world()
        world._look_for_contacts = lambda: self._watch(world)  # type: ignore[method-assign]
        return world

    def _watch(self, world: World) -> None:
        poses = {
            name: (float(world.x[row]), float(world.y[row]), float(world.heading[row]))
            for name, row in world.row.items()
        }
        for pair in world.sim.collisions():
            if all(name in poses for name in pair):
                first, second = sorted(pair, key=world.row.__getitem__)
                gap = _signed_distance(poses[first], poses[second])
                self.encounters[first, second].reports.append((world.time, gap))
        everybody = np.ones(len(world.ids), np.bool_)
        for i, j in contacts(world.x, world.y, world.heading, everybody):
            self.encounters[world.ids[i], world.ids[j]].seen.append(world.time)
        for i, j in np.argwhere(_near(world.x, world.y)):
            first, second = world.ids[i], world.ids[j]
            if first in self._poses and second in self._poses:
                self._measure(self.encounters[first, second], first, second, poses, world)
        self._poses = poses

    def _measure(
        self, encounter: Encounter, first: str, second: str, poses: dict[str, Pose], world: World
    ) -> None:
        """The truth of one sub-step."""
        if world.time > encounter.contact + FOLLOW_UP:
            return
        here, there = between(self._poses[first], poses[first]), between(self._poses[second], poses[second])
        gaps = shapely.distance(polygons(here), polygons(there))
        if gaps.min() < NEAR:
            signed = [_signed_distance(a, b) for a, b in zip(here.tolist(), there.tolist(), strict=True)]
            encounter.depth = max(encounter.depth, -min(signed))
            encounter.swept = encounter.swept or min(signed[EVERY - 1 :: EVERY]) <= 0.0
        if gaps.min() == 0.0 and not math.isfinite(encounter.contact):
            at = int(np.argmax(gaps == 0.0))
            encounter.contact = world.time - world.dt * (1 - (at + 1) / PARTS)
            encounter.kind = self._kind(here[at], there[at])
        encounter.closest = min(encounter.closest, float(gaps.min()))

    @staticmethod
    def _kind(ego: NDArray[np.float64], other: NDArray[np.float64]) -> str:
        dx, dy = other[:2] - ego[:2]
        cos, sin = math.cos(ego[2]), math.sin(ego[2])
        turn = (other[2] - ego[2] + math.pi) % (2 * math.pi) - math.pi
        return classify(dx * cos + dy * sin, dy * cos - dx * sin, turn)


def collect(task: str, dose: float, cases: int) -> list[dict[str, Any]]:
    """At least so many cases of a task, as rows of corpus.csv; more where an episode brings several."""
    env = WatchedEnv(task, {**next(iter(get_task(task).levels.values())), "risk": dose})
    rows: list[dict[str, Any]] = []
    found = episode = 0
    while found < cases:
        seed = stream_seed("collision corpus", task, str(dose), episode)
        env.reset(seed=seed)
        actions = np.random.default_rng(seed)
        over, end = False, math.inf
        while not over and env.scene.time < end:
            _, _, terminated, truncated, _ = env.step(int(actions.integers(len(env.actions))))
            mine = [e.contact for pair, e in env.encounters.items() if "ego" in pair]
            first = min(mine, default=math.inf)
            end = first + FOLLOW_UP  # what the ego meets afterwards, it meets inside another car
            over = terminated or truncated
        for pair, encounter in env.encounters.items():
            later = "ego" in pair and first < encounter.contact < math.inf
            if later or (encounter.closest >= NEAR and not encounter.reports):
                continue
            who = "ego" if "ego" in pair else "traffic"
            found += who == "ego"
            case = {"task": task, "dose": dose, "episode": episode, "who": who, "pair": "-".join(pair)}
            rows.append({**case, **_judge(encounter)})
        episode += 1
    env.close()
    return rows


def _judge(encounter: Encounter) -> dict[str, Any]:
    """What happened, and what each detector said about it."""
    true = math.isfinite(encounter.contact)
    meant = [
        (time, gap)
        for time, gap in encounter.reports
        if not true or -FOLLOW_UP <= time - encounter.contact <= FOLLOW_UP
    ]
    seen = [time for time in encounter.seen if not true or time <= encounter.contact + FOLLOW_UP]
    return {
        "contact": true,
        "type": encounter.kind or "none",
        "closest": encounter.closest,
        "depth": encounter.depth,
        "sumo": bool(meant),
        "geometry": bool(seen),
        "swept": encounter.swept,
        # a report counts within a tolerance if any of those about this case is made at such a distance
        "sumo_gap": min((max(gap, 0.0) for _, gap in meant), default=math.nan),
        "first_report_gap": max(meant[0][1], 0.0) if meant else math.nan,
        "sumo_delay": meant[0][0] - encounter.contact if true and meant else math.nan,
        "geometry_delay": seen[0] - encounter.contact if true and seen else math.nan,
    }


def summarise(corpus: pd.DataFrame) -> pd.DataFrame:
    """Recall and precision of the detectors, by task, by who crashes, by type of crash (and "all")."""
    rows = []
    for (task, who), cases in corpus.groupby(["task", "who"], sort=False):
        for kind in ("all", *sorted(set(cases["type"]) - {"none"})):
            relevant = cases[cases["contact"]]
            relevant = relevant if kind == "all" else relevant[relevant["type"] == kind]
            for detector, noticed in _detectors(cases).items():
                true = int(noticed[relevant.index].sum())
                false = cases[noticed & ~cases["contact"]]
                rows.append(
                    {
                        "task": task,
                        "who": who,
                        "type": kind,
                        "detector": detector,
                        "contacts": len(relevant),
                        "noticed": true,
                        "recall": true / len(relevant) if len(relevant) else math.nan,
                        # false crashes have no type
                        "false": len(false) if kind == "all" else math.nan,
                        "precision": true / (true + len(false)) if kind == "all" and true else math.nan,
                        "worst_false_distance": false["closest"].max() if kind == "all" else math.nan,
                    }
                )
    return pd.DataFrame(rows)


def _detectors(cases: pd.DataFrame) -> dict[str, pd.Series]:
    within = cases["sumo_gap"] <= TOLERANCE
    return {
        "sumo": cases["sumo"],
        "geometry": cases["geometry"],
        "both": cases["sumo"] | cases["geometry"],
        "geometry, SUMO within 0.25 m": cases["geometry"] | within,
        "swept geometry": cases["swept"],
        "swept geometry, SUMO within 0.25 m": cases["swept"] | within,
    }


def draw(corpus: pd.DataFrame, path: Path) -> None:
    """How far apart the cars really were when SUMO reported a crash, and how long after contact each one reports."""
    figure, (gaps, delays) = plt.subplots(1, 2, figsize=(9, 3.2))
    reported = corpus[corpus["sumo"]]
    bins = np.linspace(0, 1.5, 31)
    for contact, colour, label in ((True, "#009e73", "contact follows"), (False, "#d55e00", "no contact")):
        values = reported.loc[reported["contact"] == contact, "first_report_gap"]
        gaps.hist(values, bins=bins, color=colour, alpha=0.7, label=f"{label} ({len(values)})")
    gaps.set_yscale("log")
    gaps.set_xlabel("distance at SUMO's first report [m]")
    gaps.set_ylabel("cases")
    true = corpus[corpus["contact"]]
    for column, colour in (("sumo_delay", "#56b4e9"), ("geometry_delay", "#000000")):
        label = column.removesuffix("_delay")
        delays.hist(
            true[column].dropna(), bins=np.linspace(-1, 1, 41), histtype="step", color=colour, label=label
        )
    delays.set_yscale("log")
    delays.set_xlabel("first report after the contact [s]")
    for axis in (gaps, delays):
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(frameon=False, fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def run(options: Options) -> int:
    """Collect, judge and write; the exit status."""
    options.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for task in choose_tasks(options.tasks or tuple(TASKS)):
        for dose in (0.0, 1.0):
            rows += collect(task, dose, math.ceil(options.cases / 2))
        corpus = pd.DataFrame(rows)
        corpus.round(4).to_csv(options.out / "corpus.csv", index=False)
        table = summarise(corpus)
        table.round(4).to_csv(options.out / "detection.csv", index=False)
        print(table[(table["task"] == task) & (table["type"] == "all")].to_string(index=False), flush=True)
    draw(corpus, options.out / "detection.png")
    return 0


def main() -> int:
    """The command line."""
    return run(tyro.cli(Options, description=__doc__))


if __name__ == "__main__":
    run_command(main)
