"""How well crashes are noticed: SUMO's detection, our geometry, and both together, against exact contacts.

    python experiments/collision_corpus.py --out results/collisions               # five minutes of processor time
    python experiments/collision_corpus.py --out /tmp/collisions --cases 50 --tasks u-turn

An ego that acts at random drives in regular and in risky traffic. Detectors are only watched: nobody becomes a wreck,
so that what follows a report shows whether it was true. The truth is the distance of shapely polygons along the
trajectories, interpolated to 5 ms: evenly from pose to pose and, as a check on that, along curves that leave and reach
each pose in the direction of its heading. Cases are an ego's first contact with a vehicle, and near-contacts: vehicles
that came closer than 0.5 m and never touched. Pairs of other vehicles are kept as well and counted apart. Writes
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
from typing import Any, Literal

import numpy as np
import pandas as pd
import shapely
import tyro
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from experiments.study.grid import choose_tasks
from experiments.study.seeds import stream_seed
from experiments.support.errors import run_command
from sumo_env.collision import (
    DIAGONAL,
    LENGTH,
    SUMO_TOLERANCE,
    WIDTH,
    classify,
    contacts,
    distance,
    meetings,
)
from sumo_env.env import DrivingEnv
from sumo_env.simulation import simulation
from sumo_env.tasks import TASKS, get_task
from sumo_env.world import World

PARTS = 20  # of a sub-step of 0.1 s: the truth is looked at every 5 ms
NEAR = 0.5  # [m] a vehicle that comes closer without contact is a near-contact
FOLLOW_UP = (
    1.0  # [s] after the ego's first contact; also how far a report may be from the contact that it means
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
    level: Literal["lowest", "highest"] = "lowest"
    """The level of each task."""
    check_junctions: bool = True
    """Whether SUMO also compares outlines inside junctions."""


@dataclass
class Encounter:
    """Two vehicles in one episode.

    Attributes:
        closest: least distance [m] that the polygons ever had, 0 in contact.
        contact: time of the first contact [s], inf without one; kind: its type (`collision.classify`).
        curved: time of the first contact on the curved way [s].
        depth: deepest penetration in the second after the first contact [m].
        lanes: SUMO's lanes of the two at the last report, or else at the contact.
        reports: (time [s], distance of the rectangles [m]) of SUMO's reports.
        steps: times of the sub-steps at whose end the rectangles are in contact [s].
        seen: times at which `collision.meetings` finds a contact [s].
    """

    closest: float = math.inf
    contact: float = math.inf
    kind: str = ""
    curved: float = math.inf
    depth: float = 0.0
    lanes: tuple[str, str] = ("", "")
    reports: list[tuple[float, float]] = field(default_factory=list)
    steps: list[float] = field(default_factory=list)
    seen: list[float] = field(default_factory=list)


def polygons(poses: NDArray[np.float64]) -> NDArray[Any]:
    """Shapely polygons of vehicles, shape (n,), from x, y [m] and heading [rad], shape (n, 3)."""
    cos, sin = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x = poses[:, :1] + cos * CORNERS[:, 0] - sin * CORNERS[:, 1]
    y = poses[:, 1:2] + sin * CORNERS[:, 0] + cos * CORNERS[:, 1]
    return np.asarray(shapely.polygons(np.stack([x, y], axis=-1)))


def between(before: Sequence[float], now: Sequence[float], curved: bool = False) -> NDArray[np.float64]:
    """Poses on the way from one to the other, without the first, shape (PARTS, 3).

    The way is straight and even or, if `curved`, a cubic that leaves and arrives in the direction of the headings
    (Hermite's, with the length of the way as speed at both ends), as a vehicle does that follows a bend. The heading
    turns evenly.
    """
    t = np.linspace(1 / PARTS, 1, PARTS)[:, None]
    start, end = np.asarray(before[:2]), np.asarray(now[:2])
    turn = (now[2] - before[2] + math.pi) % (2 * math.pi) - math.pi
    if curved:
        length = math.hypot(*(end - start))
        leave, arrive = (
            length * np.array([math.cos(heading), math.sin(heading)]) for heading in (before[2], now[2])
        )
        place = start + (3 * t**2 - 2 * t**3) * (end - start)
        place = place + (t**3 - 2 * t**2 + t) * leave + (t**3 - t**2) * arrive
    else:
        place = start + t * (end - start)
    return np.hstack([place, before[2] + t * turn])


def _signed_distance(first: Sequence[float], second: Sequence[float]) -> float:
    """`collision.distance` of two poses [m], negative in contact."""
    (x, y, heading), (x2, y2, heading2) = first, second
    return distance(x, y, heading, x2, y2, heading2, LENGTH, WIDTH)


def _near(before: NDArray[np.float64], now: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs i < j of vehicles that may come closer than `NEAR` within a sub-step.

    before, now: x, y [m] and heading [rad], shape (3, n).
    """
    (x, y), (x2, y2) = (poses[:2, None, :] - poses[:2, :, None] for poses in (before, now))
    way = np.hypot(x2 - x, y2 - y)
    turn = np.abs((now[2] - before[2] + math.pi) % (2 * math.pi) - math.pi) * DIAGONAL / 2
    # how far the nearest two points may come together on the way, which may be curved
    moved = 1.2 * (way + turn + turn[:, None])
    circles = np.argwhere(np.triu(np.hypot(x, y) - DIAGONAL - moved < NEAR, k=1)).tolist()
    poses = before.T.tolist()
    gaps = {(i, j): _signed_distance(poses[i], poses[j]) for i, j in circles}
    return [pair for pair, gap in gaps.items() if gap - moved[pair] < NEAR]


class WatchedEnv(DrivingEnv):
    """The detectors report, and nothing follows from it.

    Attributes:
        encounters: by the names of the vehicles, in the order of their rows: the ego comes first.
    """

    encounters: defaultdict[tuple[str, str], Encounter]

    def reset(self, **arguments: Any) -> tuple[NDArray[Any], dict[str, Any]]:
        """Start an episode and a new record."""
        self.encounters = defaultdict(Encounter)
        return super().reset(**arguments)

    def _open_world(self) -> World:
        world = super()._open_world()
        world._undisturbed = lambda most: 0  # type: ignore[method-assign]  # every sub-step is looked at here
        world._look_for_contacts = lambda touching, ttc: self._watch(world)  # type: ignore[method-assign]
        return world

    def _watch(self, world: World) -> None:
        now = np.array([world.x, world.y, world.heading])
        for pair in world.sim.collisions():
            if all(name in world.row for name in pair):
                i, j = sorted(world.row[name] for name in pair)
                encounter = self.encounters[world.ids[i], world.ids[j]]
                encounter.reports.append(
                    (world.time, _signed_distance(now[:, i].tolist(), now[:, j].tolist()))
                )
                encounter.lanes = (world.sim.lane_of(world.ids[i]), world.sim.lane_of(world.ids[j]))
        everybody = np.ones(len(world.ids), np.bool_)
        for i, j in contacts(world.x, world.y, world.heading, everybody):
            self.encounters[world.ids[i], world.ids[j]].steps.append(world.time)
        pairs, moments = meetings(world.cars.before, world.x, world.y, world.heading, everybody)
        for (i, j), moment in zip(pairs, moments, strict=True):
            time = world.time - world.dt * (1.0 - float(moment))
            self.encounters[world.ids[i], world.ids[j]].seen.append(time)
        for i, j in _near(world.cars.before, now):
            encounter = self.encounters[world.ids[i], world.ids[j]]
            if world.time <= encounter.contact + FOLLOW_UP:
                self._measure(encounter, world, now, i, j)

    def _measure(self, encounter: Encounter, world: World, now: NDArray[np.float64], i: int, j: int) -> None:
        """The truth of one sub-step."""
        ends = [(world.cars.before[:, row].tolist(), now[:, row].tolist()) for row in (i, j)]
        ways = [between(*poses) for poses in ends]
        gaps = shapely.distance(*map(polygons, ways))
        if gaps.min() == 0.0:
            at = int(np.argmax(gaps == 0.0))
            if encounter.contact == math.inf:
                encounter.contact = world.time - world.dt * (1 - (at + 1) / PARTS)
                encounter.kind = self._kind(ways[0][at], ways[1][at])
                if not encounter.reports:
                    encounter.lanes = (world.sim.lane_of(world.ids[i]), world.sim.lane_of(world.ids[j]))
            deepest = min(
                _signed_distance(a, b) for a, b in zip(*(way.tolist() for way in ways), strict=True)
            )
            encounter.depth = max(encounter.depth, -deepest)
        encounter.closest = min(encounter.closest, float(gaps.min()))
        if encounter.curved == math.inf and gaps.min() < 1.0:
            curves = [between(*poses, curved=True) for poses in ends]
            if shapely.distance(*map(polygons, curves)).min() == 0.0:
                encounter.curved = world.time

    @staticmethod
    def _kind(ego: NDArray[np.float64], other: NDArray[np.float64]) -> str:
        dx, dy = other[:2] - ego[:2]
        cos, sin = math.cos(ego[2]), math.sin(ego[2])
        turn = (other[2] - ego[2] + math.pi) % (2 * math.pi) - math.pi
        return classify(dx * cos + dy * sin, dy * cos - dx * sin, turn)


def collect(task: str, dose: float, cases: int, level: int = 0) -> list[dict[str, Any]]:
    """At least so many cases at the `level`-th level of a task, as rows of corpus.csv.

    More where an episode brings several.
    """
    env = WatchedEnv(task, {**list(get_task(task).levels.values())[level], "risk": dose})
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
        if not true or abs(time - encounter.contact) <= FOLLOW_UP
    ]
    latest = encounter.contact + FOLLOW_UP  # inf without a contact
    seen = [time for time in encounter.seen if time <= latest]
    return {
        "contact": true,
        "curved_contact": encounter.curved <= latest and math.isfinite(encounter.curved),
        "type": encounter.kind or "none",
        "closest": encounter.closest,
        "depth": encounter.depth,
        "lane": encounter.lanes[0],
        "other_lane": encounter.lanes[1],
        "sumo": bool(meant),
        "steps": any(time <= latest for time in encounter.steps),
        "geometry": bool(seen),
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
            curved = cases[cases["curved_contact"] & (cases["type"].eq(kind) | (kind == "all"))]
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
                        "curved_recall": noticed[curved.index].mean(),
                        # false crashes have no type
                        "false": len(false) if kind == "all" else math.nan,
                        "precision": true / (true + len(false)) if kind == "all" and true else math.nan,
                        "worst_false_distance": false["closest"].max() if kind == "all" else math.nan,
                    }
                )
    return pd.DataFrame(rows)


def _detectors(cases: pd.DataFrame) -> dict[str, pd.Series]:
    return {
        "SUMO": cases["sumo"],
        "geometry every 0.1 s": cases["steps"],
        "SUMO or that": cases["sumo"] | cases["steps"],
        "geometry": cases["geometry"],
        "together": cases["geometry"] | (cases["sumo_gap"] <= SUMO_TOLERANCE),  # what counts as a crash
    }


def draw(corpus: pd.DataFrame, path: Path) -> None:
    """How far apart the ego and the other were when SUMO reported a crash, and how deep the missed contacts were."""
    figure, (gaps, depths) = plt.subplots(1, 2, figsize=(10, 3.2))
    mine = corpus[corpus["who"] == "ego"]
    reported = mine[mine["sumo"]]
    bins = np.linspace(0, 0.5, 26)
    for contact, colour, label in ((True, "#009e73", "contact follows"), (False, "#d55e00", "no contact")):
        values = reported.loc[reported["contact"] == contact, "first_report_gap"].clip(upper=bins[-1])
        gaps.hist(values, bins=bins, color=colour, alpha=0.7, label=f"{label} ({len(values)})")
    gaps.axvline(SUMO_TOLERANCE, color="#555555", lw=0.8, ls=":")
    gaps.text(SUMO_TOLERANCE + 0.005, gaps.get_ylim()[1] * 0.5, "tolerance", fontsize=8, color="#555555")
    gaps.set_xlabel("distance at SUMO's first report [m] (last bar: 0.5 and more)")
    true = mine[mine["contact"]]
    for detector, colour in (
        ("SUMO", "#56b4e9"),
        ("geometry every 0.1 s", "#cc79a7"),
        ("together", "#000000"),
    ):
        missed = true.loc[~_detectors(true)[detector], "depth"].clip(upper=1.2)
        label = f"{detector} ({len(missed)} of {len(true)})"
        depths.hist(missed, bins=np.linspace(0, 1.2, 25), histtype="step", lw=1.4, color=colour, label=label)
    depths.set_ylim(top=depths.get_ylim()[1] * 8)  # room for the legend
    depths.set_xlabel("depth of the contacts missed [m] (last bar: 1.2 and more)")
    for axis in (gaps, depths):
        axis.set_yscale("symlog", linthresh=1)
        axis.set_ylabel("cases of the ego")
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(frameon=False, fontsize=8, loc="upper right")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def run(options: Options) -> int:
    """Collect, judge and write; the exit status."""
    options.out.mkdir(parents=True, exist_ok=True)
    simulation().check_junctions = options.check_junctions
    rows: list[dict[str, Any]] = []
    for task in choose_tasks(options.tasks or tuple(TASKS)):
        for dose in (0.0, 1.0):
            rows += collect(task, dose, math.ceil(options.cases / 2), 0 if options.level == "lowest" else -1)
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
