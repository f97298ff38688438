"""Pictures of collisions (the paper's figure 3): who was hit where, seen from the ego, and how often by type."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patches import FancyArrow, Rectangle
from numpy.typing import NDArray

from experiments.analysis.scores import TASK_ORDER
from experiments.reporting.style import INK, MUTED, PAPER, new_figure, styled, to_svg
from experiments.study.arms import ARMS, TRAFFICS

LENGTH, WIDTH = 5.0, 2.0  # [m] of every vehicle, in both simulators
# Seen best by all eyes beside each other: Okabe and Ito's sky blue, orange, reddish purple and yellow-green.
TYPES = {"rear-end": "#e69f00", "side": "#56b4e9", "frontal": "#cc79a7", "junction": "#7f9f3f"}
UNKNOWN = MUTED
MOST = 60  # vehicles drawn in one picture; the points of contact are all there
BIN = 0.5  # [m] between dots
POSE = ["crash_relative_x", "crash_relative_y", "crash_relative_heading"]


def corners(x: NDArray, y: NDArray, heading: NDArray) -> NDArray[np.float64]:
    """Corners (n, 4, 2) [m] of vehicles with these centres [m] and headings [rad]."""
    local = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * (LENGTH / 2, WIDTH / 2)
    return _place(local, x, y, heading)


def _place(points: NDArray, x: NDArray, y: NDArray, heading: NDArray) -> NDArray[np.float64]:
    """Points (m, 2) of a vehicle's own frame, for every vehicle: (n, m, 2)."""
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    along, across = points[:, 0], points[:, 1]
    return np.stack(
        [x[:, None] + cos * along - sin * across, y[:, None] + sin * along + cos * across], axis=-1
    )


def contacts(x: NDArray, y: NDArray, heading: NDArray) -> NDArray[np.float64]:
    """Where each of the others touches the ego, (n, 2) [m] in the ego's frame.

    The mean of those points of the other's area that lie within the ego, or, if it only comes close, the
    point nearest to the ego. Args: the others' centres [m] and headings [rad] in the ego's frame.
    """
    along, across = np.meshgrid(np.linspace(-0.5, 0.5, 26) * LENGTH, np.linspace(-0.5, 0.5, 11) * WIDTH)
    points = _place(np.column_stack([along.ravel(), across.ravel()]), x, y, heading)
    outside = np.maximum(np.abs(points) - (LENGTH / 2, WIDTH / 2), 0)
    distance = np.hypot(outside[..., 0], outside[..., 1])
    inside = distance <= distance.min(axis=1, keepdims=True) + 1e-9
    return (points * inside[..., None]).sum(axis=1) / inside.sum(axis=1, keepdims=True)


@styled
def collisions(episodes: pd.DataFrame) -> str:
    """The trained agents' crashes by task: a picture for each arm, and the share of episodes by type of crash.

    episodes: the test episodes of one backend.
    """
    agents = episodes[episodes["kind"] == "agent"]
    tasks = sorted(agents["task"].unique(), key=TASK_ORDER.__getitem__)
    figure, axes = new_figure(len(tasks), 3, 0.5 + 1.75 * len(tasks), width_ratios=[1, 1, 0.8])
    for row, task in enumerate(tasks):
        chosen = agents[agents["task"] == task]
        for column, arm in enumerate(ARMS):
            _picture(axes[row, column], chosen[(chosen["arm"] == arm) & chosen["crashed"]])
            axes[row, column].set_title(f"{task}, {arm}")
        _bars(axes[row, 2], chosen)
        axes[row, 2].set_title("share of episodes")
    for column in range(len(ARMS)):
        axes[-1, column].set_xlabel("metres ahead of the ego's centre")
    unknown = (agents["crashed"] & ~agents["crash_type"].isin(list(TYPES))).any()
    legend = {**TYPES, **({"not recorded": UNKNOWN} if unknown else {})}
    handles = [Rectangle((0, 0), 1, 1, color=colour, label=kind) for kind, colour in legend.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(legend))
    backend = episodes["backend"].iloc[0]
    return to_svg(figure, f"{backend}-collisions", "Collisions in the ego's frame, by task and arm")


def _picture(axes: Axes, crashes: pd.DataFrame) -> None:
    """The ego from above, heading right; others at the moment of contact; points of contact, larger where frequent."""
    posed = crashes.dropna(subset=POSE)
    if len(posed):
        x, y, heading = posed[POSE].to_numpy(dtype=float).T
        shown = np.unique(np.linspace(0, len(posed) - 1, MOST).astype(int))  # spread over seeds and traffics
        edges = [TYPES.get(kind, UNKNOWN) for kind in posed["crash_type"].iloc[shown]]
        outlines = list(corners(x, y, heading)[shown])
        axes.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=edges, lw=0.7, alpha=0.5))
        # Counted on a grid: a dot for each crash would make the file grow with the number of crashes.
        places = pd.DataFrame(np.round(contacts(x, y, heading) / BIN) * BIN, columns=["x", "y"])
        places["kind"] = posed["crash_type"].array
        counts = places.groupby(["x", "y", "kind"]).size().reset_index(name="n")
        sizes = (1.5 + 9 * np.sqrt(counts["n"] / len(posed))).round()  # few sizes keep the file small
        for (kind, size), dots in counts.groupby(["kind", sizes]):
            colour = TYPES.get(kind, UNKNOWN)
            axes.plot(dots["x"], dots["y"], "o", ms=size, color=colour, mew=0, alpha=0.85, zorder=4)
    axes.add_patch(Rectangle((-LENGTH / 2, -WIDTH / 2), LENGTH, WIDTH, fc=PAPER, ec=INK, lw=1.4, zorder=3))
    axes.add_patch(
        FancyArrow(-1.2, 0, 2, 0, width=0.12, head_width=0.6, head_length=0.7, color=INK, lw=0, zorder=3)
    )
    text = f"{len(crashes)} crashes" if len(crashes) != 1 else "1 crash"
    axes.text(0.02, 0.02, text, transform=axes.transAxes, fontsize=7.5, color=MUTED)
    axes.set(xlim=(-8, 8), ylim=(6, -6), aspect="equal", xticks=[-5, 0, 5], yticks=[-5, 0, 5])  # y is down
    axes.grid(visible=False)


def _bars(axes: Axes, episodes: pd.DataFrame) -> None:
    """Share of the test episodes that end in each type of crash, a bar for each arm and traffic."""
    labels = []
    for number, (traffic, arm) in enumerate((traffic, arm) for traffic in TRAFFICS for arm in ARMS):
        chosen = episodes[(episodes["arm"] == arm) & (episodes["traffic"] == traffic)]
        left = 0.0
        types = chosen.loc[chosen["crashed"], "crash_type"]
        types = types.where(types.isin(list(TYPES)), "unknown")
        for kind, colour in {**TYPES, "unknown": UNKNOWN}.items():
            share = (types == kind).sum() / max(len(chosen), 1)
            axes.barh(-number, share, left=left, color=colour, height=0.62)
            left += share
        labels.append(f"{arm}\n{traffic}")
    axes.set_yticks([-number for number in range(len(labels))], labels, fontsize=6.5)
    axes.set_xlim(0, 1)
    axes.set_xticks([0, 0.5, 1], ["0", "50 %", "100 %"])
    axes.grid(axis="y", visible=False)
