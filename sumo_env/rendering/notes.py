"""What a picture says beside what is to be seen: marks of vehicles, lines of text, and how much of the time is over."""

from collections.abc import Iterator
from math import inf
from typing import NamedTuple

from sumo_env.contacts.measures import NEAR_MISS_TTC, ego_ttc
from sumo_env.contacts.rectangles import states
from sumo_env.scene import RED, YELLOW, Scene
from sumo_env.simulator import EgoStep
from sumo_env.traffic.scenario import Scenario

EVENT, CRASH, NEAR_MISS = "event", "crash", "near miss"  # kinds of marks and lines, beside those of lights
LIGHTS = {RED: "red light", YELLOW: "yellow light"}
STEP = 0.1  # [s] events act in whole simulation steps, so a little earlier or longer than planned
SEEN_LIGHT = 60.0  # [m] to a light that is told of


class Mark(NamedTuple):
    """A ring around a vehicle, and the words beside it."""

    kind: str
    name: str  # of the vehicle
    text: str


class Notes(NamedTuple):
    """What is written into a picture."""

    marks: tuple[Mark, ...] = ()
    lines: tuple[tuple[str, str], ...] = ()  # kinds ("" for what is always said) and texts
    share: float | None = None  # of the episode's time that is over, from 0 to 1; None for no bar


def notes(scene: Scene, scenario: Scenario, met: EgoStep | None, action: str, duration: float) -> Notes:
    """The notes on a scene of an episode, which lasts for this duration [s].

    met: what the ego meets in this policy step, as ``info`` says it, None before the first one; action: name of its
    last meta-action, "" without one.
    """
    lines = [("", f"{scene.time:.1f} s   {scene.speed.item(0):.1f} m/s   {action}".rstrip())]
    light = scene.light
    if light.state in LIGHTS and light.distance <= SEEN_LIGHT:
        lines.append((LIGHTS[light.state], f"{LIGHTS[light.state]} in {light.distance:.0f} m"))
    other = met.crash.other if met is not None and met.crash is not None else ""
    marks = [*_events(scene, scenario), *_crashes(scene, other)]
    if scene.crashed[0]:
        lines.append((CRASH, f"crash with {other}" if other else "crash"))
    elif met is not None and met.min_ttc < NEAR_MISS_TTC:
        for mark in _near(scene):  # of this moment: the step may have another one
            lines.append((NEAR_MISS, f"near miss: {mark.text}"))
            marks.append(mark)
    return Notes(tuple(marks), tuple(lines), min(scene.time / duration, 1.0))


def _events(scene: Scene, scenario: Scenario) -> Iterator[Mark]:
    begun = [event for event in scenario.events if event.time < scene.time + STEP]
    kinds: dict[str, str] = {event.vehicle: "cut-in" for event in begun if event.kind == "cut-in"}
    # a vehicle that brakes or surges may cut in as well
    kinds |= {
        event.vehicle: str(event.kind) for event in begun if scene.time < event.time + event.duration + STEP
    }
    for name in scene.ids:
        if name in scene.in_event:
            yield Mark(EVENT, name, kinds.get(name, ""))


def _crashes(scene: Scene, other: str) -> Iterator[Mark]:
    """Crashed learning cars, and with whom the ego has crashed."""
    for name, crashed in zip(scene.ids[: scene.cars], scene.crashed.tolist(), strict=False):
        if crashed:
            yield Mark(CRASH, name, "")
    if scene.crashed[0] and other in scene.ids:
        yield Mark(CRASH, other, other)


def _near(scene: Scene) -> Iterator[Mark]:
    """The vehicle that the ego would hit first, if that were a near miss now; its time is cut, not rounded."""
    own, *halves = ((length / 2.0, width / 2.0) for length, width in map(scene.size, scene.ids))
    ego, *others = states(scene)
    times = [
        ego_ttc(ego, (other,), NEAR_MISS_TTC, half, own) for other, half in zip(others, halves, strict=True)
    ]
    least = min(times, default=inf)
    if least < inf:
        yield Mark(NEAR_MISS, scene.ids[1 + times.index(least)], f"{int(10.0 * least) / 10.0} s")
