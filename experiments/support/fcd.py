"""Floating car data: an episode as SUMO's tools read it (sumo.dlr.de, "FCDOutput").

SUMO's convention differs from the scenes' (highway-env's): y points up, a position is the middle of the front
bumper, and an angle is in degrees, clockwise from north.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from sumo_env.networks.mapping import network
from sumo_env.scene import VEHICLE_LENGTH


def write(path: Path, scenes: Sequence[Any], task: str, config: Mapping[str, Any]) -> list[Path]:
    """Write the scenes of an episode, and beside them a .sumocfg that names their road.

    Args:
        path: the file to write.
        scenes: `sumo_env.scene.Scene` of each policy step.
        task: which road; config: its settings (lanes_count, road_length).

    Returns:
        The files written.

    Raises:
        OSError: a file cannot be written.
    """
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<fcd-export>"]
    for scene in scenes:
        lines.append(f'    <timestep time="{scene.time:.2f}">')
        for row, name in enumerate(scene.ids):
            heading = float(scene.heading[row])
            x = float(scene.x[row]) + VEHICLE_LENGTH / 2 * math.cos(heading)
            y = float(scene.y[row]) + VEHICLE_LENGTH / 2 * math.sin(heading)
            angle = (math.degrees(heading) + 90.0) % 360.0
            kind = "ego" if row == 0 else "car"
            lines.append(
                f'        <vehicle id={quoteattr(name)} x="{x:.3f}" y="{-y:.3f}" angle="{angle:.2f}" '
                f'type="{kind}" speed="{float(scene.speed[row]):.3f}" pos="0.00" lane="" slope="0.00"/>'
            )
        lines.append("    </timestep>")
    path.write_text("\n".join([*lines, "</fcd-export>", ""]))
    roads = network(task, int(config.get("lanes_count", 4)), float(config.get("road_length", 800.0)))
    settings = path.with_name(path.name.removesuffix(".xml").removesuffix(".fcd") + ".sumocfg")
    settings.write_text(
        "<configuration>\n    <input>\n"
        f"        <net-file value={quoteattr(str(roads.net_file.resolve()))}/>\n"
        "    </input>\n</configuration>\n"
    )
    return [path, settings]
