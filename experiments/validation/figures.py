"""The figures of validation.html: each a pure function of stored results that returns an SVG text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from experiments.reporting.figures import CONTROL, GRID, INK, MUTED, TREATMENT, new_figure, styled, to_svg
from experiments.study.grid import level_names
from experiments.validation.compare import histogram
from experiments.validation.episodes import BIN, BINS, policies
from experiments.validation.stage import Motion

if TYPE_CHECKING:
    import pandas as pd

SUMO, REFERENCE = TREATMENT, CONTROL
NAMES = {"sumo": "SUMO", "highway-env": "highway-env"}
KEYS = [
    Line2D([], [], color=REFERENCE, lw=2.4, label="highway-env"),
    Line2D([], [], color=SUMO, lw=1.6, label="SUMO"),
]


def _legend(figure: Any) -> None:
    figure.legend(handles=KEYS, loc="outside upper right", ncols=2)


def _line(axes: Axes, time: Any, values: Any, engine: str) -> None:
    """highway-env broad below, SUMO thin above: where only one line is seen, both agree."""
    style: Any = (
        {"color": SUMO, "lw": 1.2} if engine == "sumo" else {"color": REFERENCE, "lw": 2.6, "alpha": 0.55}
    )
    axes.plot(time, values, **style)


@styled
def time_space(motions: Mapping[str, Motion]) -> str:
    """Stop and go: places of the leader and its followers over time, and their speeds."""
    figure, axes = new_figure(1, 2, 3.0)
    for engine in ("highway-env", "sumo"):
        motion = motions[engine]
        for vehicle in range(motion.x.shape[1]):
            _line(axes[0, 0], motion.time, motion.x[:, vehicle], engine)
        for vehicle in (0, 1, motion.x.shape[1] - 1):
            _line(axes[0, 1], motion.time, motion.speed[:, vehicle], engine)
    axes[0, 0].set_ylabel("Place along the road [m]")
    axes[0, 1].set_ylabel("Speed of leader, first and last follower [m/s]")
    for panel in axes[0]:
        panel.set_xlabel("Time [s]")
    _legend(figure)
    return to_svg(
        figure, "time-space", "Time-space diagram of a platoon in stop-and-go traffic, both simulators"
    )


@styled
def responses(motions: Mapping[str, Mapping[str, Motion]]) -> str:
    """The ego after FASTER and SLOWER, and in a lane change."""
    figure, axes = new_figure(1, 3, 2.6)
    for engine in ("highway-env", "sumo"):
        own = motions[engine]
        for name, motion in own.items():
            kind, task, scene = name.split(" | ")
            if kind == "ladder" and task in ("highway", "roundabout"):
                _line(axes[0, 0], motion.time, motion.speed[:, 0], engine)
            if kind == "lane change" and scene in ("LANE_LEFT at 25 m/s", "LANE_RIGHT at 8 m/s"):
                lateral = np.abs(motion.y[:, 0] - motion.y[0, 0])
                panel = axes[0, 1 if "25" in scene else 2]
                _line(panel, motion.time, lateral, engine)
                panel.set_title(f"lane change at {scene.split()[2]} m/s", fontsize=8.5)
    axes[0, 0].set_title("FASTER and SLOWER", fontsize=8.5)
    axes[0, 0].set_ylabel("Speed [m/s]")
    axes[0, 1].set_ylabel("Moved to the side [m]")
    for panel in axes[0]:
        panel.set_xlabel("Time [s]")
        panel.set_xlim(0, 4)
    _legend(figure)
    return to_svg(
        figure, "responses", "Speed and lateral position of the ego after meta-actions, both simulators"
    )


@styled
def artefact(motions: Mapping[str, Motion]) -> str:
    """A follower before the u-turn's bend: stock connected lanes, the path variant, v0 and SUMO.

    motions: by engine; vehicle 1 leads, vehicle 2 follows it towards the bend.
    """
    colours = {"connected": "#cc79a7", "v0": MUTED, "highway-env": REFERENCE, "sumo": SUMO}
    labels = {"connected": "connected lanes as shipped", "highway-env": "distance along the path"}
    figure, axes = new_figure(1, 2, 2.8)
    for engine, motion in motions.items():
        style = {"color": colours[engine], "lw": 2.4 if engine == "highway-env" else 1.5}
        style["ls"] = "--" if engine == "v0" else "-"
        axes[0, 0].plot(
            motion.time, motion.speed[:, 2], label=labels.get(engine, NAMES.get(engine, engine)), **style
        )
    path = motions["highway-env"]
    for vehicle, colour, label in ((1, MUTED, "leader"), (2, INK, "follower")):
        axes[0, 1].plot(path.x[:, vehicle], path.y[:, vehicle], color=colour, label=label)
        axes[0, 1].plot(path.x[0, vehicle], path.y[0, vehicle], "o", color=colour)
    axes[0, 1].invert_yaxis()
    axes[0, 1].set_aspect("equal", adjustable="datalim")
    axes[0, 1].set_xlabel("x [m]")
    axes[0, 1].set_ylabel("y [m]")
    axes[0, 1].legend()
    axes[0, 0].set_xlabel("Time [s]")
    axes[0, 0].set_ylabel("Speed of the follower [m/s]")
    axes[0, 0].legend()
    return to_svg(
        figure, "artefact", "Speed of a car that follows another into a bend, by variant of highway-env"
    )


@styled
def distributions(table: pd.DataFrame, task: str) -> str:
    """Headways, traffic speed and return of a task's episodes over each other, a row a traffic level."""
    levels = sorted(set(table["level"]))
    figure, axes = new_figure(len(levels), 3, 0.7 + 1.35 * len(levels), sharex="col")
    rows = table[table["traffic"] == "regular"]
    for number, level in enumerate(levels):
        part = {engine: rows[(rows["level"] == level) & (rows["engine"] == engine)] for engine in NAMES}
        for engine in ("highway-env", "sumo"):
            style: Any = {"color": SUMO, "lw": 1.2} if engine == "sumo" else {
                "color": REFERENCE, "lw": 2.6, "alpha": 0.55,
            }  # fmt: skip
            counts = histogram(part[engine]["headways"])
            axes[number, 0].stairs(counts / max(counts.sum(), 1), np.arange(BINS + 1) * BIN, **style)
            for column, measure in ((1, "traffic_speed"), (2, "return")):
                values = np.sort(part[engine][measure].dropna().to_numpy(float))
                axes[number, column].step(
                    values, np.arange(1, len(values) + 1) / max(len(values), 1), **style
                )
        axes[number, 0].set_ylabel(level_names(task)[level - 1])
        axes[number, 0].set_yticklabels([])
    axes[0, 0].set_title("headways (shares)")
    axes[0, 1].set_title("traffic speed (cumulative)")
    axes[0, 2].set_title("return (cumulative)")
    for column, unit in enumerate(("[s]", "mean of an episode [m/s]", "of an episode")):
        axes[-1, column].set_xlabel(unit)
    _legend(figure)
    return to_svg(figure, f"distributions-{task}", f"Distributions of headway, speed and return on {task}")


@styled
def egos(table: pd.DataFrame) -> str:
    """Return and crash rate of every ego on every task and level, SUMO against highway-env."""
    tasks = list(dict.fromkeys(table["task"]))
    figure, axes = new_figure(2, len(tasks), 3.6)
    rows = table[table["traffic"] == "regular"]
    marks = {"idle": "o", "random": "D", "faster": "^", "slower": "v", "idm": "s", "careful": "*"}
    for column, task in enumerate(tasks):
        for row, measure in enumerate(("return", "crashed")):
            panel = axes[row, column]
            part = rows[rows["task"] == task].astype({"crashed": float})
            means = part.groupby(["engine", "level", "policy"])[measure].mean().unstack("engine")
            for policy in policies(task):
                chosen = means.xs(policy, level="policy")
                panel.plot(chosen["highway-env"], chosen["sumo"], marks[policy], color=SUMO, ms=4, alpha=0.8)
            low, high = float(np.nanmin(means.to_numpy())), float(np.nanmax(means.to_numpy()))
            panel.axline((low, low), (high, high + 1e-9), color=MUTED, lw=0.8)
            panel.set_aspect("equal", adjustable="datalim")
        axes[0, column].set_title(task)
    axes[0, 0].set_ylabel("Return, SUMO")
    axes[1, 0].set_ylabel("Crash rate, SUMO")
    for panel in axes[1]:
        panel.set_xlabel("highway-env")
    handles = [Line2D([], [], color=SUMO, ls="", marker=mark, label=name) for name, mark in marks.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=5)
    return to_svg(figure, "egos", "Return and crash rate of all egos in SUMO against highway-env")


@styled
def fundamental(table: pd.DataFrame) -> str:
    """Flow and speed against density on the highway, a point an episode."""
    figure, axes = new_figure(1, 2, 2.7)
    rows = table[(table["task"] == "highway") & (table["traffic"] == "regular")]
    for engine, marker, size in (("highway-env", "o", 22), ("sumo", "x", 12)):
        part = rows[rows["engine"] == engine]
        style: Any = {"s": size, "marker": marker, "c": SUMO if engine == "sumo" else REFERENCE, "alpha": 0.6}
        axes[0, 0].scatter(part["ahead"], part["flow"], **style)
        axes[0, 1].scatter(part["ahead"], part["traffic_speed"], **style)
    axes[0, 0].set_ylabel("Flow, four lanes [vehicles/h]")
    axes[0, 1].set_ylabel("Speed [m/s]")
    for panel in axes[0]:
        panel.set_xlabel("Density, 200 m ahead of the ego [vehicles/km]")
    _legend(figure)
    return to_svg(figure, "fundamental", "Fundamental diagram of the highway")


@styled
def overview(records: Mapping[str, Any]) -> str:
    """Every check with a target: difference as a share of its margin, with interval, by task."""
    tasks = list(records)
    figure, axes = new_figure(1, len(tasks), 2.6, sharey=True, sharex=True)
    metrics: Sequence[tuple[str, str]] = (
        ("return", "return"), ("crashed", "crash rate"), ("traffic_speed", "traffic speed"),
        ("wasserstein", "headways"), ("agreement", "same outcome"),
    )  # fmt: skip
    for panel, task in zip(axes[0], tasks, strict=True):
        panel.axvspan(-1, 1, color=GRID, alpha=0.6, lw=0)
        panel.axvline(0, color=INK, lw=0.8)
        panel.set_title(task)
        levels = records[task]["levels"]
        for number, level in enumerate(levels.values()):
            shift = 0.3 - 0.6 * number / max(len(levels) - 1, 1)
            for row, (metric, _) in enumerate(metrics):
                for item in level["checks"]:
                    if item["metric"] != metric or not item["margin"]:
                        continue
                    y = -row + shift
                    colour = {True: REFERENCE, False: SUMO}.get(item["passed"], MUTED)  # grey: no verdict
                    share = item["difference"] / item["margin"]
                    if item["low"] is not None:
                        ends = np.array([item["low"], item["high"]]) / item["margin"]
                        panel.plot(np.clip(ends, -3, 3), [y, y], color=colour, lw=1)
                    panel.plot(np.clip(share, -3, 3), y, "o", color=colour, ms=3.5)
        panel.grid(axis="y", visible=False)
        panel.set_xlim(-3, 3)
    axes[0, 0].set_yticks([-row for row in range(len(metrics))], [label for _, label in metrics])
    figure.supxlabel(
        "difference as a share of its margin (grey: within), a line a level, 90 % intervals", fontsize=8.5
    )
    return to_svg(figure, "overview", "All targets: difference over margin")
