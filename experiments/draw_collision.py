"""Draw the separating-axis test (python experiments/draw_collision.py): the idea of the paper's figure 4."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from sumo_env.collision import LENGTH, WIDTH, separation

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


def panel(axes: Axes, title: str) -> None:
    """The frame of a drawing."""
    axes.set_title(title, fontsize=8.5)
    axes.set_aspect("equal")
    axes.set_xlim(-7.0, 7.0)
    axes.set_ylim(-6.2, 6.2)
    axes.axis("off")


def main() -> None:
    """Apart, in contact, and in contact between two looks."""
    figure, (apart, contact, missed) = plt.subplots(1, 3, figsize=(10.5, 3.8))
    ego: Pose = (0.0, 0.0, 0.0)
    for axes, other, verdict in (
        (apart, (3.6, 3.8, 0.6), "apart: one axis with a gap is enough"),
        (contact, (3.6, 2.2, 0.6), "contact: the shadows overlap on all four axes (two shown)"),
    ):
        panel(axes, verdict)
        car(axes, ego, EGO)
        car(axes, other, OTHER)
        shadows(axes, ego, other, ego[2], (0.0, -3.2))
        shadows(axes, ego, other, ego[2] + math.pi / 2, (-4.6, 0.5))
        gap = separation(*ego, *other, LENGTH, WIDTH)
        label = f"largest gap {gap:.2f} m" if gap > 0 else f"depth of penetration {-gap:.2f} m"
        axes.text(-6.8, -5.8, label, fontsize=8)
    panel(missed, "contact between two sub-steps of 0.1 s")
    car(missed, ego, EGO)
    # seen from the ego, which drives as well, the other car does not move along its own heading
    start, direction, heading, way = (4.02, 2.55), 2.41, 1.38, 1.5
    end = (start[0] + way * math.cos(direction), start[1] + way * math.sin(direction))
    for k in range(6):
        x, y = (start[i] + (end[i] - start[i]) * k / 5 for i in range(2))
        car(missed, (x, y, heading), OTHER, alpha=0.35 if k in (0, 5) else 0.08)
    missed.text(-6.8, -5.8, "both looks: apart; at the tests every 20 ms: in contact", fontsize=8)
    figure.tight_layout()
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(TARGET, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
