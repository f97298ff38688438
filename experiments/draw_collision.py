"""Draw how contacts are looked for (python experiments/draw_collision.py): the idea of the paper's figure 4."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from sumo_env.collision import LENGTH, WIDTH, meeting, separation

TARGET = Path(__file__).resolve().parent.parent / "docs" / "img" / "collisions.png"
EGO, OTHER, AXIS = "#0072b2", "#d55e00", "#555555"
Pose = tuple[float, float, float]  # x, y [m], heading [rad]


def corners(pose: Pose) -> NDArray[np.float64]:
    """Corners of a vehicle [m], shape (4, 2)."""
    x, y, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    local = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * (LENGTH / 2, WIDTH / 2)
    return local @ np.array([[cos, sin], [-sin, cos]]) + (x, y)


def car(axes: Axes, pose: Pose, colour: str, alpha: float = 0.35) -> None:
    """A vehicle as a rectangle."""
    axes.add_patch(Polygon(corners(pose), facecolor=colour, edgecolor=colour, alpha=alpha, lw=1.2))


def shadows(axes: Axes, first: Pose, second: Pose, heading: float, foot: tuple[float, float]) -> None:
    """The axis through `foot` along `heading`, and what the two vehicles cover of it."""
    direction = np.array([math.cos(heading), math.sin(heading)])
    aside = np.array([-direction[1], direction[0]])
    line = np.array(foot) + np.outer([-5.0, 6.5], direction)
    axes.plot(*line.T, color=AXIS, lw=0.7, ls=":")
    for pose, colour, offset in ((first, EGO, 0.12), (second, OTHER, -0.12)):
        along = (corners(pose) - foot) @ direction
        ends = np.array(foot) + np.outer([along.min(), along.max()], direction) + offset * aside
        axes.plot(*ends.T, color=colour, lw=3, solid_capstyle="butt")


def panel(axes: Axes, title: str, half: float = 6.6, centre: tuple[float, float] = (0.0, 0.0)) -> None:
    """The frame of a drawing, `half` as wide and high [m]."""
    axes.set_title(title, fontsize=8.5)
    axes.set_aspect("equal")
    axes.set_xlim(centre[0] - half, centre[0] + half)
    axes.set_ylim(centre[1] - half, centre[1] + half)
    axes.axis("off")


def caption(axes: Axes, text: str) -> None:
    """A line below a drawing."""
    axes.text(0.5, 0.02, text, fontsize=8, ha="center", transform=axes.transAxes)


def main() -> None:
    """Apart, in contact, and in contact between two looks."""
    figure, (apart, contact, grazed) = plt.subplots(1, 3, figsize=(10.5, 3.8))
    ego: Pose = (0.0, 0.0, 0.0)
    for axes, other, verdict in (
        (apart, (3.6, 3.8, 0.6), "apart: one axis with a gap is enough"),
        (contact, (3.6, 2.2, 0.6), "contact: the shadows overlap\non all four axes (two shown)"),
    ):
        panel(axes, verdict)
        car(axes, ego, EGO)
        car(axes, other, OTHER)
        shadows(axes, ego, other, ego[2], (0.0, -3.2))
        shadows(axes, ego, other, ego[2] + math.pi / 2, (-4.6, 0.5))
        gap = separation(*ego, *other, LENGTH, WIDTH)
        caption(axes, f"largest gap {gap:.2f} m" if gap > 0 else f"depth of penetration {-gap:.2f} m")
    panel(grazed, "contact on the way between two looks", half=5.2, centre=(3.0, 0.8))
    car(grazed, ego, EGO)
    # Seen from the ego, which drives as well, the other does not move along its own heading: it slides past the corner.
    heading = math.pi / 4
    middle = np.array([2.5, 1.0]) + (LENGTH / 2 - 0.15) * np.array([math.cos(heading), math.sin(heading)])
    aside = np.array([math.sin(heading), -math.cos(heading)])
    start, end = middle + 2.0 * aside, middle - 1.25 * aside
    before = np.array([[ego[0], start[0]], [ego[1], start[1]], [ego[2], heading]])
    moment = meeting(0, 1, before, np.array([ego[0], end[0]]), np.array([ego[1], end[1]]), before[2])
    x, y = start + moment * (end - start)
    for place in (start, end):
        car(grazed, (*place, heading), OTHER, alpha=0.15)
    car(grazed, (x, y, heading), OTHER, alpha=0.5)
    grazed.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": AXIS, "lw": 0.8})
    caption(grazed, f"apart at both ends (light), first contact at {moment:.2f} of the way (dark)")
    figure.tight_layout()
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(TARGET, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
