"""Draws the pictures of the documentation: ``python docs/figures.py``.

docs/img/networks/*.png       SUMO's lanes (grey, orange in junctions) under highway-env's centre lines (bright, dashed)
docs/img/collisions.png       how contacts are looked for
"""

import math
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[0] = str(ROOT)

import matplotlib

matplotlib.use("agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from sumo_env.contacts.rectangles import LENGTH, WIDTH, State, separation, state_between, touch_moment
from sumo_env.networks import lanes
from sumo_env.networks.mapping import Network, network
from sumo_env.networks.roads import road

IMAGES = ROOT / "docs" / "img"


Window = tuple[float, float, float, float]
# task -> windows (x from, x to, y from, y to) [m], highway-env's coordinates; the second one is a close-up
WINDOWS: dict[str, list[Window]] = {
    "roundabout": [(-75.0, 75.0, -75.0, 75.0), (-4.0, 30.0, 4.0, 38.0)],
    "intersection": [(-50.0, 50.0, -50.0, 50.0), (-14.0, 14.0, -14.0, 14.0)],
    "u-turn": [(-30.0, 160.0, -12.0, 60.0), (118.0, 158.0, 36.0, 52.0)],
}


def band(line: np.ndarray) -> np.ndarray:
    """Outline (2n, 2) [m] of a lane about its centre line (n, 2)."""
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    aside = along[:, ::-1] * (-1, 1) * lanes.WIDTH / 2
    return np.concatenate([line + aside, (line - aside)[::-1]])


def draw_network(axes: Axes, net: Network, window: Window) -> None:
    """One window of a network."""
    for name, sumo_lane in net.sumo_lanes.items():
        joint, shape = name.startswith(":"), np.array(sumo_lane.shape)
        axes.fill(*band(shape).T, color="#f3c89a" if joint else "#d9dde2", lw=0, zorder=1 + joint)
        axes.plot(*shape.T, color="#c65d00" if joint else "#3c444c", lw=2.6, zorder=3 + joint)
    for (start, end, number), lane in net.road.lanes.items():
        s = np.arange(0.0, lane.length + 0.25, 0.5).clip(max=lane.length)
        line = [lane.position(float(v), 0.0) for v in s]
        axes.plot(*zip(*line, strict=True), color="#49b6ff", lw=1.2, ls=(0, (3, 3)), zorder=6)
        if number == 0:
            node(axes, start, line[0], window)
            node(axes, end, lane.position(lane.length, 0.0), window)
    axes.set(xlim=window[:2], ylim=window[3:1:-1], xlabel="x [m]", ylabel="y [m], down", aspect="equal")


def node(axes: Axes, name: str, place: lanes.Point, window: Window) -> None:
    """Mark one of highway-env's nodes."""
    x, y = place
    axes.plot(x, y, ".", color="#1f6fd0", ms=4, zorder=7)
    if window[0] < x < window[1] and window[2] < y < window[3]:
        right, below = x > sum(window[:2]) / 2, y > sum(window[2:]) / 2
        axes.annotate(
            name, (x, y), xytext=(5 if right else -5, -5 if below else 5), textcoords="offset points",
            ha="left" if right else "right", va="top" if below else "bottom", fontsize=7, color="#0b4a86",
            zorder=8, bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75},
        )  # fmt: skip


def networks() -> None:
    """One picture for each road that is not straight."""
    legend = [
        Line2D([], [], color="#3c444c", lw=2.6, label="SUMO lane"),
        Line2D([], [], color="#c65d00", lw=2.6, label="SUMO lane inside a junction"),
        Line2D([], [], color="#49b6ff", lw=1.2, ls="--", label="highway-env lane, with its nodes"),
    ]
    for task, windows in WINDOWS.items():
        size = (9.0, 3.0 if task == "u-turn" else 4.9)
        figure, axes = plt.subplots(1, len(windows), figsize=size, layout="constrained")
        for axis, window in zip(axes, windows, strict=True):
            draw_network(axis, network(road(task)), window)
        figure.legend(handles=legend, loc="outside upper center", ncols=3, fontsize=8, frameon=False)
        figure.savefig(IMAGES / "networks" / f"{task}.png", dpi=110, metadata={"Software": None})


EGO, OTHER, AXIS = "#0072b2", "#d55e00", "#555555"


def car(axes: Axes, vehicle: State, colour: str, alpha: float = 0.35) -> Rectangle:
    """Draw a vehicle."""
    x, y, _, heading = vehicle
    drawn = Rectangle((x - LENGTH / 2, y - WIDTH / 2), LENGTH, WIDTH, rotation_point="center")
    drawn.set(angle=math.degrees(heading), facecolor=colour, edgecolor=colour, alpha=alpha, lw=1.2)
    axes.add_patch(drawn)
    return drawn


def shadows(axes: Axes, first: Rectangle, second: Rectangle, heading: float, foot: lanes.Point) -> None:
    """The axis through `foot` along `heading`, and what the two vehicles cover of it."""
    direction = np.array([math.cos(heading), math.sin(heading)])
    aside = np.array([-direction[1], direction[0]])
    axes.plot(*(np.array(foot) + np.outer([-5.0, 6.5], direction)).T, color=AXIS, lw=0.7, ls=":")
    for vehicle, colour, offset in ((first, EGO, 0.12), (second, OTHER, -0.12)):
        along = (vehicle.get_corners() - foot) @ direction
        ends = np.array(foot) + np.outer([along.min(), along.max()], direction) + offset * aside
        axes.plot(*ends.T, color=colour, lw=3, solid_capstyle="butt")


def panel(axes: Axes, title: str, caption: str, half: float = 6.6, centre: lanes.Point = (0.0, 0.0)) -> None:
    """The frame of a drawing, `half` as wide and high [m]."""
    x, y = centre
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal")
    axes.set_title(title, fontsize=8.5)
    axes.axis("off")
    axes.text(0.5, 0.02, caption, fontsize=8, ha="center", transform=axes.transAxes)


def collisions() -> None:
    """Apart, in contact, and in contact between two looks."""
    figure, (apart, contact, grazed) = plt.subplots(1, 3, figsize=(10.5, 3.8))
    ego: State = (0.0, 0.0, 0.0, 0.0)
    for axes, other, title in (
        (apart, (3.6, 3.8, 0.0, 0.6), "apart: one axis with a gap is enough"),
        (contact, (3.6, 2.2, 0.0, 0.6), "contact: the shadows overlap\non all four axes (two shown)"),
    ):
        gap = separation(ego, other)
        words = f"largest gap {gap:.2f} m" if gap > 0 else f"depth of penetration {-gap:.2f} m"
        panel(axes, title, words)
        drawn = car(axes, ego, EGO), car(axes, other, OTHER)
        shadows(axes, *drawn, ego[3], (0.0, -3.2))
        shadows(axes, *drawn, ego[3] + math.pi / 2, (-4.6, 0.5))
    # Seen from the ego, which drives as well, the other does not move along its own heading: it slides past the corner.
    heading = math.pi / 4
    middle = np.array([2.5, 1.0]) + (LENGTH / 2 - 0.15) * np.array([math.cos(heading), math.sin(heading)])
    aside = np.array([math.sin(heading), -math.cos(heading)])
    first, last = ((x, y, 0.0, heading) for x, y in (middle + np.outer([2.0, -1.25], aside)).tolist())
    moment = touch_moment(ego, ego, first, last)
    words = f"apart at both ends (light), first contact at {moment:.2f} of the way (dark)"
    panel(grazed, "contact on the way between two looks", words, half=5.2, centre=(3.0, 0.8))
    car(grazed, ego, EGO)
    car(grazed, first, OTHER, alpha=0.15)
    car(grazed, last, OTHER, alpha=0.15)
    car(grazed, state_between(first, last, moment), OTHER, alpha=0.5)
    grazed.annotate("", last[:2], first[:2], arrowprops={"arrowstyle": "->", "color": AXIS, "lw": 0.8})
    figure.tight_layout()
    figure.savefig(IMAGES / "collisions.png", dpi=110)


if __name__ == "__main__":
    networks()
    collisions()
