"""An episode: what all learning cars of one simulation share of it, and what it is for one of them."""

import copy
import math
from dataclasses import replace

import numpy as np

from sumo_env.config import pace
from sumo_env.contacts.rectangles import state_of
from sumo_env.networks import files
from sumo_env.networks.roads import LaneIndex
from sumo_env.scene import Scene
from sumo_env.simulator import Commands, EgoStep, Simulator, Step, WindowClosed
from sumo_env.spaces.actions import PlainAction, Situation
from sumo_env.tasks.base import EgoState, Task
from sumo_env.traffic.scenario import Scenario, VehicleSpec

EgoPlace = tuple[LaneIndex, float, float, bool]  # lane, s and lateral there [m], whether it is on the road


class Episode:
    """What all learning cars of one simulation share, from one reset to the next."""

    def __init__(self, simulator: Simulator, scenario: Scenario, drawn_by: Task) -> None:
        """drawn_by: the task, as the options of the reset have changed it."""
        self.simulator, self.drawn_by = simulator, drawn_by
        self.scenario = scenario  # of all cars; vehicles whose arrival is drawn on the way are added
        self.specs = {spec.id: spec for spec in scenario.everybody}
        self.frequency = pace(scenario.simulation_frequency, scenario.policy_frequency)  # [Hz]
        self.commands: list[Commands] = []  # of all policy steps so far
        self.met: EgoStep | None = None  # what the scene's first car has met in the last policy step
        self.is_closed = False  # whether the user has closed a window
        self.scene = simulator.reset(scenario)  # the present one, of all cars

    def __deepcopy__(self, memo: dict[int, object]) -> "Episode":
        """A copy with a simulator of its own; both share commands and vehicles, for nobody changes one."""
        twin = copy.copy(self)
        twin.simulator = copy.deepcopy(self.simulator, memo)
        twin.commands = self.commands.copy()
        twin.specs = memo[id(self.specs)] = self.specs.copy()  # cars have them, too
        return twin

    def step(self, commands: Commands, trace: bool = False) -> Step:
        """Drive one policy step. If the user has closed SUMO's own window, nothing moves, and no car meets anything."""
        self.commands.append(commands)
        try:
            step = self.simulator.step(commands, trace=trace)
        except WindowClosed:
            self.is_closed = True
            return Step(self.scene, {})
        self.scene, self.met = step.scene, step.egos.get(next(iter(step.scene.ids), ""))
        return step

    def imagine(self, scenario: Scenario) -> None:
        """Let what is to come be that of another scenario, see `Simulator.imagine`."""
        self.scenario = scenario
        self.simulator.imagine(scenario)


class CarEpisode:
    """An episode as one learning car drives it."""

    rng: np.random.Generator  # shuffles the rows of observations; there, like `ego_state`, once the car is
    ego_state: EgoState
    before_ego = 0  # see `Situation`
    arrived = False  # whether it has reached a goal (`Task.arrived`)
    ending = ""  # see `info.ending`
    is_over = False
    is_handed_over = False  # to SUMO

    def __init__(self, episode: Episode, ego: VehicleSpec, scene: Scene) -> None:
        """ego: what the car was made from; scene: the first one that it sees."""
        self.episode, self.ego, self.scene = episode, ego, scene
        self.id = next(iter(scene.ids), ego.id)
        self.road, self.specs = episode.scenario.road, episode.specs
        self.route = ego.route(self.road)  # with SUMO's own traffic, what is left of it
        self.met = EgoStep(ego.lane if scene.place is None else scene.place.lane, None, math.inf, 0.0)
        self.steps = len(episode.commands)  # of the episode, up to the last one of this car
        self._find_route()

    @property
    def scenario(self) -> Scenario:
        """The scenario in which this car is the ego."""
        whole = self.episode.scenario
        return whole if whole.ego.id == self.ego.id else replace(whole, ego=self.ego)

    def advance(self, step: Step) -> None:
        """Take over what a policy step has brought."""
        self.scene = step.scene.seen_by(self.id)
        self.met = step.egos[self.id] if step.egos else self.met._replace(distance=0.0)
        self.steps += 1
        self._find_route()

    def look(self, place: EgoPlace, action: PlainAction | None, speed_index: int, speed_count: int) -> None:
        """Make its state of what it sees; action: that has led here, None at first; the rest as of `EgoState`."""
        scene, target_lane, frequency = self.scene, self.met.target_lane, self.episode.frequency
        lane, s, lateral, on_road = place
        last, speed = None if action is None else self.ego_state, scene.speed.item(0)
        acceleration = (speed - last.speed) * frequency if last else 0.0
        self.ego_state = EgoState(
            lane=lane,
            s=s,
            lateral=lateral,
            speed=speed,
            heading=scene.heading.item(0),
            target_lane=target_lane,
            speed_index=speed_index,
            speed_count=speed_count,
            action=action,
            crashed=scene.crashed.item(0),
            on_road=on_road,
            scene=scene,
            acceleration=acceleration,
            jerk=(acceleration - last.acceleration) * frequency if last else 0.0,
            before=last.scene if last else None,
            lanes_abreast=self.road.count(*target_lane[:2]),
            ended=self.met.ended,
        )

    def place(self) -> EgoPlace:
        """Where it is, by SUMO or else by the road."""
        x, y, _, heading = state_of(self.scene, 0)
        known = self.scene.place
        index = known.lane if known is not None else self.road.closest_lane(x, y, heading)
        lane = self.road.lane(index)
        s, lateral = lane.local_coordinates(x, y)
        return index, s, lateral, lane.covers(s, lateral) if known is None else known.on_road

    def situation(self, target_speeds: tuple[float, ...]) -> Situation:
        """What its actions and observations are made of now."""
        seen = self.scene, self.road, self.ego_state, self.specs, self.rng, target_speeds
        return Situation(*seen, self.route, self.before_ego, is_first=self.ego_state.before is None)

    def _find_route(self) -> None:
        """With SUMO's own traffic: what is left of the route, as SUMO has it now."""
        if self.scene.place is None:
            return
        edges = self.scene.place.ahead
        self.route = tuple(node for edge in edges for node in files.lane(edge)[:2])
        last = files.lane(edges[-1])
        if last in self.road.lanes:
            self.specs = {self.ego.id: self.ego._replace(lane=last, destination=last[1])}
