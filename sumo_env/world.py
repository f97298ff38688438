"""An episode on SUMO: a scenario in, one scene after every policy step out.

The sub-step is always the same: the rule commands the traffic, the ego and the wrecks are commanded, SUMO steps,
everybody's state is read, contacts on the way are looked for by SUMO and by geometry, dangers are measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sumo_env import direct, loop
from sumo_env.cars import Cars, Flags
from sumo_env.collision import (
    LENGTH,
    NEAR,
    SUMO_TOLERANCE,
    WIDTH,
    CrashRecord,
    Detector,
    crash_record,
    distance,
    meetings,
    scene_between,
)
from sumo_env.computed import Computed
from sumo_env.config import Config
from sumo_env.drivers import TOLD
from sumo_env.ego import Ego
from sumo_env.loop import Progress, Traffic
from sumo_env.models.dangers import dangers
from sumo_env.models.hazards import has_room
from sumo_env.models.idm import driver_rows
from sumo_env.motion import OnLanes
from sumo_env.networks.catalogue import Network
from sumo_env.networks.roads import LaneIndex
from sumo_env.safety import HORIZON
from sumo_env.scenario import EGO, Scenario, VehicleSpec
from sumo_env.scene import Floats, Scene
from sumo_env.simulation import ALL_CHECKS_OFF, NO_LANE_CHANGES, Fleet, Settings, Simulation, simulation
from sumo_env.steering import Steering
from sumo_env.tasks.base import Task
from sumo_env.tasks.intersection import fits
from sumo_env.traffic import rule_for

# [s] where SUMO changes lanes; the ego's centre then crosses the line when highway-env's does, after 0.45 to 0.5 s
LANE_CHANGE_DURATION = 0.8


class World:
    """The state of an episode. Arrays have one row a vehicle, row 0 the ego, in highway-env's coordinates.

    Attributes that rules read: ids, row (id -> row), specs, cars (and some of its rows: x, y, speed, heading, crashed,
    target_speed, yielding, lane), drivers (columns of `models.idm`), time, dt, ego, road, network, config,
    road_length, limit, sim, fleet.
    """

    cars: Cars
    x: Floats
    y: Floats
    heading: Floats
    speed: Floats
    target_speed: Floats
    drivers: Floats
    crashed: Flags
    yielding: Flags
    fleet: Fleet

    def __init__(self, task: Task, config: Config, network: Network) -> None:
        self.task = task
        self.config = config
        self.network = network
        self.road = task.road(config)
        self.dt = 1.0 / config["simulation_frequency"]
        self.substeps = round(config["simulation_frequency"] / config["policy_frequency"])
        first = next(iter(self.road.lanes.values()))
        self.road_length, self.limit = first.length, first.speed_limit
        self.rule = rule_for(task.name, config["traffic_model"], self.road)
        rule = self.rule
        self.steering = Steering(network) if isinstance(rule, Computed) and rule.steers else None
        self.motion = self.steering or OnLanes(network)
        self.lane_change_duration = 0.0 if self.steering else LANE_CHANGE_DURATION
        self.sim: Simulation = simulation()
        self._lane_ids: tuple[str, ...] = ()
        self._settings: dict[float | None, Settings] = {}  # by the risk of those who are not told where to drive
        self.time = 0.0
        self.cars = Cars(0)

    # -- start of an episode -------------------------------------------------------------------------------

    def reset(self, scenario: Scenario, ego: Ego) -> Scene:
        """Place a scenario; the first scene."""
        self.scenario, self.ego = scenario, ego
        kind = None if self.steering else scenario.risk
        if kind not in self._settings:
            drivers = (TOLD,) if self.steering else self.task.drivers(scenario.risk)
            routes = tuple(self.network.routes.items())
            self._settings[kind] = Settings(
                self.network.net_file,
                routes,
                self.dt,
                self.lane_change_duration,
                self.steering is not None,
                drivers,
            )
        self.time = 0.0
        self.policy_step = 0
        self.crash: CrashRecord | None = None
        self._events = list(scenario.events)
        self._comes_and_goes = self.task.name == "intersection" or bool(scenario.spawns)
        # vehicle -> (end [s], acceleration [m/s2], way that has to be free [m])
        specs = [scenario.ego]
        specs += [
            spec for spec in scenario.vehicles if self.task.concerns_ego(spec, scenario.ego, self.config)
        ]
        places = {spec.id: self.network.place(spec.lane, spec.s, spec.destination) for spec in specs}
        self.sim.acquire(self, self._settings[kind], {name: place[0] for name, place in places.items()})
        if self._lane_ids is not self.sim.lane_ids:
            self._learn_lanes()
        if self.steering:
            self.steering.entered.clear()  # of a reset that was interrupted
        for spec in specs:
            self._place(spec, places[spec.id])
        self._set_rows(specs)
        return self.scene()

    def _learn_lanes(self) -> None:
        """What is to be known of each of SUMO's lanes, by number."""
        self._lane_ids = ids = self.sim.lane_ids
        self._lane_index = [self.network.indices.get(lane) for lane in ids]  # highway-env's
        self.motion.learn_lanes(ids, np.array([self.network.stretch(lane) for lane in ids]))

    def _place(self, spec: VehicleSpec, place: tuple[str, str, float]) -> None:
        """Put a vehicle on the road; `place`: of `Network.place`."""
        route, lane, position = place
        is_ego = spec.id == EGO
        if self.steering:
            mode = ALL_CHECKS_OFF, NO_LANE_CHANGES
            self.sim.add(spec.id, route, TOLD.type, lane, position, spec.speed, *mode, None)
            self.steering.entered.append(lane)
            return
        self.sim.add(
            spec.id, route, spec.driver.type, lane, position, spec.speed,
            ALL_CHECKS_OFF if is_ego else self.rule.speed_mode,
            NO_LANE_CHANGES if is_ego or not spec.changes_lanes else self.rule.lane_change_mode,
            self.limit if is_ego else min(spec.target_speed, self.limit),
        )  # fmt: skip

    def _set_rows(self, specs: list[VehicleSpec], stayed: Sequence[int] = ()) -> None:
        """(Re)build the arrays for these vehicles; the first of them keep the state of the rows that `stayed`."""
        first = len(stayed)
        self.specs = specs
        self.ids = tuple(spec.id for spec in specs)
        self.spec_of = dict(zip(self.ids, specs, strict=True))
        self.row = {name: row for row, name in enumerate(self.ids)}
        if first or len(self.cars) != len(specs):
            cars = Cars(len(specs))
            if first:
                cars.keep(self.cars, stayed)
            self.cars = cars
            self.x, self.y, self.heading, self.speed = cars.x, cars.y, cars.heading, cars.speed
            self.crashed, self.yielding, self.target_speed = cars.crashed, cars.yielding, cars.target_speed
            self.lane = cars.lane
        else:
            cars = self.cars
            cars.clear()
        self._reported: set[tuple[int, int]] = set()  # by SUMO after the last sub-step
        self.fleet: Fleet = self.sim.fleet(self.ids)
        if self.steering:
            self.steering.start(self, first)
        else:
            speed = cars.speed.copy()
            self.fleet.read(cars.state, cars.before, cars.lane, cars.own_speed)
            cars.speed[:] = speed  # SUMO does not know it before the next step
        fresh = specs[first:]
        cars.speed[first:] = [spec.speed for spec in fresh]
        cars.target_speed[first:] = [spec.target_speed for spec in fresh]
        cars.yielding[first:] = [spec.yielding for spec in fresh]
        cars.before[:] = cars.pose
        drivers = driver_rows([spec.driver for spec in fresh])
        self.drivers = np.concatenate((self.drivers[list(stayed)], drivers)) if first else drivers
        self.rule.start(self, first)
        self.motion.aim(self)
        self._traffic: Traffic | None = self.motion.traffic(self)

    # -- a policy step -------------------------------------------------------------------------------------

    def step(self, on_substep: Callable[[Scene], None] | None = None) -> Scene:
        """Drive for one policy step and return the scene at its end.

        `on_substep` is called with the scene after every sub-step but the last (for films).
        Also sets `min_ttc` [s], `distance` [m] and `lane_changes` of this step, and `crash` at the ego's first contact.
        """
        self.sim.check(self)
        self.min_ttc = np.inf
        self.distance = 0.0
        self.motion.aim(self)  # the ego may have been commanded to another lane
        done = 0
        while done < self.substeps:
            if self._events:
                self._start_events()
            undisturbed = 0 if on_substep else self._undisturbed(self.substeps - done)
            done += self._advance(undisturbed) if undisturbed else self._substep()
            if on_substep is not None and done < self.substeps:
                on_substep(self.scene())
        self.policy_step += 1
        return self.scene()

    def _substep(self) -> int:
        """One sub-step; returns 1."""
        self.rule.act(self)
        self._drive_ego()
        self.motion.act(self)
        self.sim.step()
        self.time += self.dt
        self._read()
        self._look_for_contacts(*dangers(self.cars.floats, self.cars.flags, HORIZON))
        return 1

    def _undisturbed(self, most: int) -> int:
        """Sub-steps, up to `most`, driven in one call: until there is a risk event or the rule has to act."""
        if self._traffic is None:
            return 0
        until = self.rule.busy_from(self)
        if self._events:
            until = min(until, self._events[0].time)
        count, time = 0, self.time
        while count < most and until > time + 1e-9:
            count, time = count + 1, time + self.dt
        return count

    def _advance(self, count: int) -> int:
        """`_substep` up to `count` times in one call; returns how many times."""
        assert self._traffic is not None
        if self.motion.ego_near_end:
            self.follow_road()
        progress = Progress(0, loop.GOES_ON, 0, 0.0, self.time, self.distance, self.min_ttc)
        progress = self.rule.drive(self, self._traffic, count, progress)
        direct.raise_error(self._traffic.calls)
        self.time, self.distance, self.min_ttc = progress.time, progress.distance, progress.least_ttc
        if progress.why == loop.LOST:
            self._traffic = None
            self._read()
        self.ego.speed = float(self.speed[0])
        self.motion.ego_near_end = progress.why != loop.GOES_ON
        if progress.done > 1 or progress.why in (loop.GOES_ON, loop.NEAR_END):
            self._reported.clear()
        if progress.why == loop.TOUCHED:
            self._look_for_contacts(progress.touching, progress.ttc)
        elif progress.why == loop.LOST:
            self._look_for_contacts(*dangers(self.cars.floats, self.cars.flags, HORIZON))
        return progress.done

    def come_and_go(self) -> None:
        """Remove vehicles that have left the scene and let new ones in (intersection; after the observation)."""
        if not self._comes_and_goes:
            return
        spawns = [spawn.vehicle for spawn in self.scenario.spawns if spawn.step == self.policy_step]
        staying = [row for row in range(len(self.ids)) if row == 0 or not self._has_left(row)]
        coming = [
            spec
            for spec in spawns
            if fits(spec, [(float(self.x[row]), float(self.y[row])) for row in staying])
        ]
        if not coming and len(staying) == len(self.ids):
            return
        for row in set(range(len(self.ids))).difference(staying):
            self.sim.remove(self.ids[row])
        for spec in coming:
            self._place(spec, self.network.place(spec.lane, spec.s, spec.destination))
        self._set_rows([self.specs[row] for row in staying] + coming, staying)

    def _has_left(self, row: int) -> bool:
        if self.task.name != "intersection":
            return False
        index = self._lane_index[self.lane[row]]
        assert index is not None
        lane = self.road.lane(index)
        s = lane.local_coordinates(float(self.x[row]), float(self.y[row]))[0]
        return index[0].startswith("il") and s >= lane.length - 20.0

    def scene(self) -> Scene:
        """The present state as a value."""
        x, y, heading, speed = self.cars.state.copy()
        return Scene(self.ids, x, y, speed, heading, self.crashed.copy(), round(self.time, 6))

    # -- parts of a sub-step -------------------------------------------------------------------------------

    def _start_events(self) -> None:
        while self._events and self._events[0].time <= self.time + 1e-9:
            event = self._events.pop(0)
            row = self.row.get(event.vehicle)
            if row is None or self.crashed[row]:
                continue
            if event.kind == "cut-in":
                self.rule.cut_in(self, row, event)
            else:
                cars = self.cars
                cars.push[row] = event.accel if event.kind == "surge" else -event.decel
                cars.push_end[row], cars.push_way[row] = self.time + event.duration, event.way

    def has_room(self, row: int, lane: LaneIndex) -> bool:
        """Is nobody in the way of a vehicle that cuts in to this lane beside it?"""
        geometry = self.road.lane(lane)
        s, _ = geometry.local_coordinates(float(self.x[row]), float(self.y[row]))
        there = (*geometry.position(s, 0.0), geometry.heading_at(s))
        return bool(has_room(self.x, self.y, self.heading, row, *map(float, there)))

    def _drive_ego(self) -> None:
        if self.motion.ego_near_end:
            self.follow_road()
        self.cars.distance[0] = moved = self.ego.advance(self.dt)
        self.distance += moved

    def follow_road(self) -> None:
        """Give the ego the next lane of its way, if it is at the end of the one that it steers for."""
        self.ego.follow_road(float(self.x[0]), float(self.y[0]))
        self.motion.aim(self)

    def _read(self) -> None:
        cars = self.cars
        if self.steering:
            self.fleet.read_fronts(cars.front, cars.lane)
        else:
            self.fleet.read(cars.state, cars.before, cars.lane, cars.own_speed)

    def _look_for_contacts(self, touching: int, ttc: float) -> None:
        """Make wrecks of those who touched in the last sub-step, and note the time to collision [s] at its end.

        touching: pairs that did by geometry.
        """
        if touching or self.sumo_sees_contact():
            self._crash(self.sim.collisions())
        else:
            self._reported.clear()
        if not self.crashed[0]:
            self.min_ttc = min(self.min_ttc, ttc)

    def sumo_sees_contact(self) -> bool:
        """Whether SUMO reports a contact that is not of wrecks alone, or may yet see the crash that geometry saw."""
        found = self.sim.collisions()
        if not found:
            return False
        if self.crash is not None and self.crash.detected_by != "both":
            return True
        rows = ((self.row.get(a, 0), self.row.get(b, 0)) for a, b in found)
        return any(not (self.crashed[i] and self.crashed[j]) and self._apart(i, j) <= NEAR for i, j in rows)

    def _crash(self, found: list[tuple[str, str]]) -> None:
        """Find out who touched whom; `found`: pairs that SUMO reports."""
        pairs, moments = meetings(self.cars.before, self.x, self.y, self.heading, ~self.crashed)
        met = dict(zip(map(tuple, pairs.tolist()), moments.tolist(), strict=True))
        reported = {
            (min(pair), max(pair))
            for pair in ((self.row.get(a, -1), self.row.get(b, -1)) for a, b in found)
            if -1 not in pair
        }
        # SUMO may see a contact a step before the geometry does, or a step later, or the other way round
        by_sumo, self._reported = reported | self._reported, reported
        if self.crash is not None and self.crash.detected_by != "both":
            pair = (0, self.row.get(self.crash.other, -1))
            if pair in (reported if self.crash.detected_by == "geometry" else met):
                self.crash = replace(self.crash, detected_by="both")
        # SUMO looks at lanes, not at corners
        happened = met | {p: 1.0 for p in reported if p not in met and self._apart(*p) <= SUMO_TOLERANCE}
        for pair in sorted(happened, key=lambda pair: (happened[pair], pair)):
            if pair[0] == 0 and self.crash is None:
                by: Detector = "sumo" if pair not in met else "both" if pair in by_sumo else "geometry"
                scene = scene_between(self.cars.before, self.scene(), happened[pair], self.dt)
                self.crash = crash_record(scene, pair[1], by)
                self.ego.crashed = True
            for row in pair:
                if row > 0 and not self.crashed[row]:
                    self.sim.set_modes(self.ids[row], ALL_CHECKS_OFF, NO_LANE_CHANGES)
                self.crashed[row] = True

    def _apart(self, i: int, j: int) -> float:
        """Distance of the outlines of two vehicles [m]."""
        x, y, heading = self.x, self.y, self.heading
        return distance(x[i], y[i], heading[i], x[j], y[j], heading[j], LENGTH, WIDTH)
