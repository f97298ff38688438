"""Draw the pictures of docs/networks.md: `python -m experiments.draw_networks`.

SUMO's lanes are grey bands with a dark centre line, joints are orange; highway-env's centre lines lie over
them, bright and dashed. Written to docs/img/networks/<task>.png.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import matplotlib
import numpy as np

matplotlib.use("agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from sumo_env.networks.lanes import WIDTH, Point
from sumo_env.networks.mapping import TASKS, Network, network

Window = tuple[float, float, float, float]
FOLDER = Path(__file__).resolve().parent.parent / "docs" / "img" / "networks"
# task -> windows (x from, x to, y from, y to) [m], highway-env's coordinates; the second one is a close-up
WINDOWS: dict[str, list[Window]] = {
    "highway": [(-60.0, 260.0, -12.0, 24.0)],
    "two-way": [(-60.0, 260.0, -14.0, 18.0)],
    "roundabout": [(-75.0, 75.0, -75.0, 75.0), (-4.0, 30.0, 4.0, 38.0)],
    "intersection": [(-50.0, 50.0, -50.0, 50.0), (-14.0, 14.0, -14.0, 14.0)],
    "u-turn": [(-30.0, 160.0, -12.0, 60.0), (118.0, 158.0, 36.0, 52.0)],
}


def shapes(net: Network) -> dict[str, np.ndarray]:
    """SUMO lane id -> points of its shape, (n, 2) [m], y down."""
    root = ElementTree.parse(net.net_file).getroot()
    return {
        lane.attrib["id"]: np.array(
            [[float(v) for v in point.split(",")] for point in lane.attrib["shape"].split()]
        )
        * (1, -1)
        for lane in root.iter("lane")
    }


def band(line: np.ndarray, width: float = WIDTH) -> np.ndarray:
    """Outline (2n, 2) [m] of a lane of this width about its centre line (n, 2)."""
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    aside = along[:, ::-1] * (-1, 1) * width / 2
    return np.concatenate([line + aside, (line - aside)[::-1]])


def draw(axes: Axes, net: Network, window: Window) -> None:
    """One window of a network."""
    lines = shapes(net)
    inside = {lane.id for lane in net.lanes.values()}
    for name, line in lines.items():
        joint = name not in inside
        axes.fill(*band(line).T, color="#f3c89a" if joint else "#d9dde2", lw=0, zorder=1 + joint)
    for name, line in lines.items():
        joint = name not in inside
        axes.plot(*line.T, color="#c65d00" if joint else "#3c444c", lw=2.6, zorder=3 + joint)
    for index, lane in net.road.lanes.items():
        s = np.arange(0.0, lane.length + 0.25, 0.5).clip(max=lane.length)
        line = np.array([lane.position(float(v), 0.0) for v in s])
        axes.plot(*line.T, color="#49b6ff", lw=1.2, ls=(0, (3, 3)), zorder=6)
        nodes(axes, index, lane.position(0.0, 0.0), lane.position(lane.length, 0.0), window)
    axes.set(xlim=window[:2], ylim=window[3:1:-1], xlabel="x [m]", ylabel="y [m], down")
    axes.set_aspect("equal")


def nodes(axes: Axes, index: tuple[str, str, int], start: Point, end: Point, window: Window) -> None:
    """Mark where a lane starts and ends, with highway-env's names."""
    for name, (x, y) in zip(index[:2], (start, end), strict=True):
        axes.plot(x, y, ".", color="#1f6fd0", ms=4, zorder=7)
        if window[0] < x < window[1] and window[2] < y < window[3] and index[2] == 0:
            right, below = x > sum(window[:2]) / 2, y > sum(window[2:]) / 2
            axes.annotate(
                name, (x, y), xytext=(5 if right else -5, -5 if below else 5), textcoords="offset points",
                ha="left" if right else "right", va="top" if below else "bottom", fontsize=7, color="#0b4a86",
                zorder=8, bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75},
            )  # fmt: skip


def main() -> None:
    """Write one picture a task."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    legend = [
        Line2D([], [], color="#3c444c", lw=2.6, label="SUMO lane"),
        Line2D([], [], color="#c65d00", lw=2.6, label="SUMO joint (inside a junction)"),
        Line2D([], [], color="#49b6ff", lw=1.2, ls="--", label="highway-env lane, with its nodes"),
    ]
    for task in TASKS:
        windows = WINDOWS[task]
        wide = task in ("highway", "two-way")
        figure, axes = plt.subplots(
            1,
            len(windows),
            figsize=(9, {"highway": 2.4, "two-way": 2.2, "u-turn": 3.0}.get(task, 4.9)),
            squeeze=False,
            layout="constrained",
        )
        for axis, window in zip(axes[0], windows, strict=True):
            draw(axis, network(task), window)
        if wide:  # ten times stretched across, or nothing would be seen of the lanes
            axes[0, 0].set_aspect("auto")
        figure.legend(handles=legend, loc="outside upper center", ncols=3, fontsize=8, frameon=False)
        path = FOLDER / f"{task}.png"
        figure.savefig(path, dpi=110, metadata={"Software": None})
        plt.close(figure)
        print(path.relative_to(FOLDER.parents[2]), f"{path.stat().st_size / 1024:.0f} KB")


if __name__ == "__main__":
    main()
