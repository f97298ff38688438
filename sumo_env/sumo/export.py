"""An episode as a SUMO scenario: files that ``sumo`` and ``sumo-gui`` open without this package.

``episode.sumocfg`` shows what happened: every vehicle is replayed along its recorded way, and traffic lights show what
they showed. The ego is blue, vehicles that crash in the episode are red, those on which a risk event acts are yellow,
the others white.

SUMO's convention differs from the scenes' (highway-env's): y points up, a position is the middle of the front bumper,
and an angle is in degrees, clockwise from north.
"""

import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from sumo_env.contacts.rectangles import state_of
from sumo_env.networks.mapping import Network, SumoLane
from sumo_env.scene import Scene
from sumo_env.traffic.scenario import EGO, Scenario, VehicleSpec

# What a replayed vehicle must be able to do, so that SUMO lets it start and move as it was recorded, also on lanes for
# buses or bicycles.
FREE = {"tau": "0.1", "minGap": "0", "decel": "200", "emergencyDecel": "200", "vClass": "ignoring"}
REPLAYED = {**FREE, "guiShape": "delivery"}
# Those of the pictures; a replayed vehicle cannot change its colour, so it has one for the whole episode.
COLOURS = {EGO: "0,114,178", "car": "233,237,241", "risky": "255,196,0", "crashed": "229,72,77"}
VIEW = "view.xml"
WINDOW = (1200, 800)  # [px] of sumo-gui
AROUND = 50.0  # [m] that it shows around the way of the ego


def write(
    folder: Path, scenario: Scenario, scenes: Sequence[Scene], recorded: Path | None = None
) -> list[Path]:
    """Write an episode to a folder, which is made; returns the files.

    Args:
        folder: where to; files of an earlier export are overwritten.
        scenario: the episode before it was driven.
        scenes: from its start on, at equal intervals (after every sub-step, say).
        recorded: floating car data of SUMO's own, whose last time is that of the last scene; else the vehicles' ways
            are looked up in the scenario.

    Raises:
        OSError: a file cannot be written.
    """
    road = scenario.network
    step = round((scenes[1].time if len(scenes) > 1 else 1.0 / scenario.simulation_frequency), 3)
    if recorded is None:
        ways = _floating_car_data(scenario, scenes, step)
    else:
        ways = _of_sumo(road, recorded, scenes, step)
    sizes = {size for scene in scenes for size in scene.sizes.values()}
    types = ElementTree.Element("additional")
    types.extend(
        ElementTree.Element("vType", {"id": _type(name, size), "color": colour, **REPLAYED, **_extent(size)})
        for name, colour in COLOURS.items()
        for size in (None, *sorted(sizes))
    )
    types.extend(_programs(scenes, step))
    inputs = {"net-file": "network.net.xml", "additional-files": "types.add.xml"}
    contents = {
        "recorded.fcd.xml": ways,
        "types.add.xml": types,
        VIEW: _view(road, scenes),
        "episode.sumocfg": _configuration(inputs, "recorded.fcd.xml", step, len(scenes)),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name in (inputs["net-file"], *contents):
        (folder / name).unlink(missing_ok=True)  # a link in its place is not followed
    shutil.copyfile(road.net_file, folder / inputs["net-file"])
    for name, root in contents.items():
        ElementTree.indent(root)
        ElementTree.ElementTree(root).write(folder / name, encoding="utf-8", xml_declaration=True)
    return [folder / name for name in (inputs["net-file"], *contents)]


def _floating_car_data(scenario: Scenario, scenes: Sequence[Scene], step: float) -> ElementTree.Element:
    """Ways of the vehicles of a scenario, as SUMO's device fcd-replay reads them."""
    road = scenario.network
    by_edge: dict[str, list[SumoLane]] = {}
    for lane in road.sumo_lanes.values():
        by_edge.setdefault(lane.id.rpartition("_")[0], []).append(lane)
    seen = {name for scene in scenes for name in scene.ids}
    ways = {spec.id: _Way(road, spec, by_edge) for spec in scenario.everybody if spec.id in seen}
    shown = _colours(scenes)
    root = ElementTree.Element("fcd-export")
    for number, scene in enumerate(scenes):
        now = ElementTree.SubElement(root, "timestep", time=f"{number * step:.3f}")
        for row, name in enumerate(scene.ids):
            if name not in ways:
                continue
            x, y, speed, heading = state_of(scene, row)
            half = scene.size(name)[0] / 2
            x, y = x + half * math.cos(heading), y + half * math.sin(heading)
            lane_id, position = ways[name].locate(x, y)
            kind = _type(shown.get(name, "car"), scene.sizes.get(name))
            ElementTree.SubElement(
                now,
                "vehicle",
                id=name,
                x=f"{x:.3f}",
                y=f"{-y:.3f}",
                angle=f"{(math.degrees(heading) + 90.0) % 360.0:.3f}",
                type=kind,
                speed=f"{speed:.3f}",
                pos=f"{position:.3f}",
                lane=lane_id,
                slope="0",
            )
    return root


def _of_sumo(road: Network, recorded: Path, scenes: Sequence[Scene], step: float) -> ElementTree.Element:
    """The vehicles of the scenes as SUMO has recorded them."""
    timesteps = ElementTree.parse(recorded).getroot().findall("timestep")[-len(scenes) :]
    cars = [car for timestep in timesteps for car in timestep.iter("vehicle")]
    on_edges = {car.get("id") for car in cars if not car.get("lane", "").startswith(":")}
    for car in cars:
        if car.get("id") not in on_edges:  # SUMO needs an edge, and crashes without one
            lane = road.sumo_lanes[car.get("lane", "")]
            while lane.id.startswith(":") and lane.preceding:
                lane = road.sumo_lanes[lane.preceding[0]]
            car.attrib.update(lane=lane.id, pos=f"{lane.length:.2f}")
    shown = _colours(scenes)
    root = ElementTree.Element("fcd-export")
    for number, (timestep, scene) in enumerate(zip(timesteps, scenes, strict=True)):
        now = ElementTree.SubElement(root, "timestep", time=f"{number * step:.3f}")
        for vehicle in timestep.findall("vehicle"):
            name = vehicle.get("id", "")
            if name in scene.ids:
                vehicle.set("type", _type(shown.get(name, "car"), scene.sizes.get(name)))
                now.append(vehicle)
    return root


def _colours(scenes: Sequence[Scene]) -> dict[str, str]:
    """The vehicles that are no regular others -> what they are."""
    shown = dict.fromkeys((name for scene in scenes for name in scene.in_event), "risky")
    last = scenes[-1]
    shown |= {name: "crashed" for name, crashed in zip(last.ids, last.crashed, strict=True) if crashed}
    return shown | {scenes[0].ids[0]: EGO}


def _programs(scenes: Sequence[Scene], step: float) -> Iterator[ElementTree.Element]:
    """What each traffic light showed, as one of SUMO's programs: a scene has what was set a step before it."""
    for name in scenes[0].signals:
        program = ElementTree.Element("tlLogic", id=name, type="static", programID="episode", offset="0")
        for state, same in groupby(scene.signals[name] for scene in scenes[1:] or scenes):
            ElementTree.SubElement(program, "phase", duration=f"{len([*same]) * step:.3f}", state=state)
        yield program


def _type(name: str, size: tuple[float, float] | None) -> str:
    """The vehicle type of a replayed vehicle; cars have no size in its name."""
    return name if size is None else f"{name}-{size[0]:g}x{size[1]:g}"


def _extent(size: tuple[float, float] | None) -> dict[str, str]:
    return {} if size is None else {"length": f"{size[0]:g}", "width": f"{size[1]:g}"}


class _Way:
    """A vehicle's route as SUMO's lanes, on which its places are looked up in driving order."""

    def __init__(self, road: Network, spec: VehicleSpec, by_edge: Mapping[str, list[SumoLane]]) -> None:
        self._lanes = [by_edge[edge] for edge in road.routes[road.sumo_route(spec.lane, spec.destination)]]
        self._edge = 0

    def locate(self, x: float, y: float) -> tuple[str, float]:
        """SUMO's lane and the position on it [m] nearest to (x, y) [m], never on an edge before the last one."""
        from sumolib.geomhelper import distancePointToPolygon, polygonOffsetWithMinimumDistanceToPoint

        ahead = [(k, lane) for k, lanes in enumerate(self._lanes) if k >= self._edge for lane in lanes]
        self._edge, lane = min(ahead, key=lambda item: distancePointToPolygon((x, y), item[1].shape))
        offset: float = polygonOffsetWithMinimumDistanceToPoint((x, y), lane.shape)
        return lane.id, offset * lane.length / lane.drawn


def _view(road: Network, scenes: Sequence[Scene]) -> ElementTree.Element:
    """Settings of sumo-gui: the whole way of the ego in the window, 0.1 s between two steps."""
    places = np.array([point for lane in road.sumo_lanes.values() for point in lane.shape])
    way = np.array([(scene.x[0], scene.y[0]) for scene in scenes])
    wide, high = np.ptp(way, axis=0) + 2 * AROUND
    aspect = WINDOW[0] / WINDOW[1]
    whole = np.ptp(places, axis=0)
    # in per cent of what shows the whole network
    zoom = 100.0 * max(whole[0], whole[1] * aspect) / max(wide, high * aspect)
    x, y = (way.min(axis=0) + way.max(axis=0)) / 2
    view = ElementTree.Element("viewsettings")
    ElementTree.SubElement(view, "scheme", name="real world")
    ElementTree.SubElement(view, "delay", value="100")
    ElementTree.SubElement(view, "viewport", zoom=f"{zoom:.0f}", x=f"{x:.2f}", y=f"{-y:.2f}")
    return view


def _configuration(inputs: Mapping[str, str], replayed: str, step: float, scenes: int) -> ElementTree.Element:
    """A .sumocfg with files relative to it, so that the folder can be moved.

    sumo-gui pauses after the first step, when the vehicles are there, and with the last scene, before SUMO's own end.
    """
    pauses = dict.fromkeys((step, (scenes - 1) * step))
    options = {
        "input": inputs,
        "time": {"begin": "0", "end": f"{(scenes + 1) * step:g}", "step-length": f"{step:g}"},
        "processing": {
            "collision.action": "none",
            "collision.check-junctions": "true",
            "collision.mingap-factor": "0",
            "time-to-teleport": "-1",
            "default.speeddev": "0",
        },
        "fcd_replay": {"device.fcd-replay.file": replayed},
        "report": {"no-step-log": "true", "no-warnings": "true", "duration-log.disable": "true"},
        "gui_only": {
            "gui-settings-file": VIEW,
            "start": "true",
            "window-size": ",".join(map(str, WINDOW)),
            "breakpoints": ",".join(f"{time:g}" for time in pauses if time > 0),
        },
    }
    root = ElementTree.Element("configuration")
    for section, values in options.items():
        group = ElementTree.SubElement(root, section)
        for name, value in values.items():
            ElementTree.SubElement(group, name, value=value)
    return root
