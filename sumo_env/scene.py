"""The state of the traffic at one instant. Simulators produce scenes; observations, rewards and measures read them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sumo_env.networks.roads import LaneIndex

VEHICLE_LENGTH = 5.0  # [m] highway_env.vehicle.kinematics.Vehicle.LENGTH
VEHICLE_WIDTH = 2.0  # [m] Vehicle.WIDTH
CAR_SIZE = (VEHICLE_LENGTH, VEHICLE_WIDTH)
OBSTACLE_SIZE = (2.0, 2.0)  # [m] highway_env.vehicle.objects.RoadObject
OBSTACLE = "obstacle:"  # ids of obstacles begin with it
MAX_SPEED = 40.0  # [m/s] Vehicle.MAX_SPEED
PERCEPTION_DISTANCE = 200.0  # [m] 5 * Vehicle.MAX_SPEED, AbstractEnv.PERCEPTION_DISTANCE

Floats = NDArray[np.float64]
UNLIT, RED, YELLOW, GREEN = -1, 0, 1, 2  # states of a traffic light; UNLIT where there is none
# What SUMO's letters mean (https://sumo.dlr.de/docs/Simulation/Traffic_Lights.html); those that are left out mean that
# the light is off.
TURN = "s"  # lets vehicles turn right after a stop
LETTERS = {"r": RED, "u": RED, TURN: RED, "y": YELLOW, "Y": YELLOW, "g": GREEN, "G": GREEN}


class Light(NamedTuple):
    """A traffic light on the ego's way: its state, and how far its stop line is from the ego's front [m].

    seconds: until the next phase begins [s]; where the light looks at the traffic, not before. lets_turn: whether it is
    red and lets vehicles turn after a stop.
    """

    state: int = UNLIT
    distance: float = inf
    seconds: float = 0.0
    lets_turn: bool = False


NO_LIGHT = Light()

# The nearest vehicles on the ego's lane and on those beside it, with the names of their features.
NEIGHBOURS = ("leader", "left_leader", "left_follower", "right_leader", "right_follower")
# Features of an observation, of the ego alone, on a network of a user's own: how far its lane and the lanes beside it
# lead along its route [m], the state of the next traffic light, how far its stop line is [m], and how far each
# neighbour is [m] and at which speed the gap closes [m/s]. Distances are PERCEPTION_DISTANCE at most.
LANE_ENDS = ("lane_end", "lane_end_left", "lane_end_right")
GAPS = tuple(f"{name}_gap" for name in NEIGHBOURS)
CLOSING = tuple(f"{name}_closing" for name in NEIGHBOURS)
ON_ITS_WAY = (*LANE_ENDS, "light", "light_distance", *GAPS, *CLOSING)
# Likewise, where they are asked for: the time until the light's next phase [s]; of the vehicle to which the ego has to
# give way at the next junction, how far it is from there [m], and its speed [m/s]; the ego's target speed [m/s].
SECONDS_LEFT, FOE = "light_seconds", ("foe_gap", "foe_speed")
ON_REQUEST = (SECONDS_LEFT, *FOE, "target_speed")


def is_obstacle(name: str) -> bool:
    """Whether an id in a scene is that of an obstacle, which is no vehicle."""
    return name.startswith(OBSTACLE)


class Neighbour(NamedTuple):
    """A leader or follower in a lane: its id, the gap between the bumpers [m], its speed along the lane [m/s]."""

    id: str
    gap: float
    speed: float


NOBODY = Neighbour("", inf, 0.0)


class Place(NamedTuple):
    """Where SUMO says that the ego is on its way through a network of a user's own.

    Attributes:
        lane: that it is on; in a junction, the way through it.
        left, right: whether it may change to the lane beside, by the road's markings and the lanes' classes.
        ahead: what is left of its route, as edges, the present one (or the one before the junction) first.
        free: how far it gets along its route without a lane change [m]; inf where the lane leads on.
        free_left, free_right: likewise from the lane beside; 0 where it may not change to that lane.
        progress: metres of this policy step over those of the whole way as it then stands, driven and left.
        ended: "" on its way, "arrived", "missed turn" (its lane does not lead on, and it can no longer change),
            or "removed" (by SUMO: teleported, say).
        red_lights: stop lines that it has driven over at red in this policy step.
        waiting: number of vehicles that wait until SUMO can insert them.
        neighbours: leader and follower in the lane to the left, in the own lane and in that to the right, by SUMO.
        foe: the next vehicle to which it has to give way at the next junction, where a feature asks for it: see
            `nearby_vehicles.foe`.
        target_speed: that is commanded [m/s]; its own speed where SUMO drives.
        overlap: id of a vehicle whose outline the ego's has touched in this policy step without a crash, "" if none.
        fuel: burnt in this policy step [mg]; electricity: consumed [Wh].
        on_road: whether it is on a lane of SUMO, or has arrived; it is on none while it is parked beside the road.
    """

    lane: LaneIndex
    left: bool
    right: bool
    ahead: tuple[str, ...]
    free: float
    free_left: float = 0.0
    free_right: float = 0.0
    progress: float = 0.0
    ended: str = ""
    red_lights: int = 0
    waiting: int = 0
    neighbours: tuple[Neighbour, ...] = (NOBODY,) * 6
    foe: Neighbour = NOBODY
    target_speed: float = 0.0
    fuel: float = 0.0
    electricity: float = 0.0
    overlap: str = ""
    on_road: bool = True


class NearEvents(NamedTuple):
    """Risk events near learning cars, which come more often (`traffic.tilt`), since the start of the episode.

    Attributes:
        events: that have come.
        expected_events: mean number of these at factor 1, given who was near.
        other_events: of all other vehicles, those to come included.
        log_weight: logarithm of the likelihood at factor 1 over that of what has happened.
    """

    events: int
    expected_events: float
    other_events: int
    log_weight: float


@dataclass(frozen=True, slots=True)
class Scene:
    """Struct of arrays, one row per vehicle, the learning cars first; highway-env's coordinates (x east, y *down*).

    Obstacles of the road are rows, too (`is_obstacle`).

    Row 0 is the ego: the only learning car, or the one by which the scene is seen (`seen_by`).

    Attributes:
        ids: names of the vehicles.
        x, y: centres of the vehicles [m], shape (n,).
        speed: along the heading [m/s], shape (n,).
        heading: from +x towards +y [rad], shape (n,).
        crashed: whether the vehicle has crashed, shape (n,).
        time: since the start of the episode [s].
        in_event: names of the vehicles on which a risk event acts now.
        sizes: length and width [m] of the vehicles that do not have highway-env's size.
        light: the nearest traffic light on the ego's way that is not green, or else the next one.
        place: the ego's on a network with SUMO's own traffic, None elsewhere.
        cars: number of first rows that are learning cars.
        further: light and place of the learning cars but the ego, by their ids.
        signals: what each traffic light of a network shows, in SUMO's letters, by its id.
        near_events: after a policy step of an episode in which events near learning cars come more often.
    """

    ids: tuple[str, ...]
    x: Floats
    y: Floats
    speed: Floats
    heading: Floats
    crashed: NDArray[np.bool_]
    time: float
    in_event: frozenset[str] = frozenset()
    sizes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    light: Light = NO_LIGHT
    place: Place | None = None
    cars: int = 1
    further: Mapping[str, tuple[Light, Place | None]] = field(default_factory=dict)
    signals: Mapping[str, str] = field(default_factory=dict)
    near_events: NearEvents | None = None

    def seen_by(self, name: str) -> "Scene":
        """The scene in which this learning car is the ego; KeyError if there is no such one."""
        if self.ids[:1] == (name,):
            return self
        light, place = self.further[name]
        row = self.ids.index(name)
        order = [row, *range(row), *range(row + 1, len(self))]
        arrays = {key: getattr(self, key)[order] for key in ("x", "y", "speed", "heading", "crashed")}
        ids = tuple(self.ids[k] for k in order)
        return replace(self, ids=ids, **arrays, light=light, place=place, further={})

    def size(self, name: str) -> tuple[float, float]:
        """Length and width of a vehicle [m]."""
        return self.sizes.get(name, CAR_SIZE)

    def __deepcopy__(self, memo: dict[int, object]) -> "Scene":
        return self  # immutable

    def __len__(self) -> int:
        return len(self.ids)


def same(one: Scene | None, other: Scene | None) -> bool:
    """Whether two scenes are the same to the last bit."""
    if one is None or other is None:
        return one is other
    arrays = ("ids", "x", "y", "speed", "heading", "crashed")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays)
