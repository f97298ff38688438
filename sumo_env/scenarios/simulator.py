"""Episodes among the traffic of SUMO's own files, which SUMO loads, routes, inserts and removes as ``sumo`` does.

Every reset loads SUMO with the seed of the episode, so that nothing of earlier episodes is left. Then SUMO drives until
the ego has departed. What risk does, it does to vehicles as they come; at dose 0 nobody but the ego is touched.
"""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import inf
from pathlib import Path

from sumo_env.scenarios.risky import RISKY_CLASSES, deviate, deviation
from sumo_env.scenarios.route_ego import RouteEgo
from sumo_env.scene import NO_LIGHT, Light, Place, Scene
from sumo_env.simulator import Commands, SimulatorError
from sumo_env.sumo.learning_car import Car
from sumo_env.sumo.paths import own_folder
from sumo_env.sumo.settings import file_settings
from sumo_env.sumo.vehicle import OF_SUMO, Vehicle
from sumo_env.sumo.world import GONE, SumoSimulator
from sumo_env.traffic.risk import RiskEvent, draw_events, draw_own_events
from sumo_env.traffic.scenario import Scenario


class FileSimulator(SumoSimulator):
    """SUMO as a `Simulator` of scenarios with `SumoTraffic`."""

    _unwanted: Path | None = None  # folder of outputs that nobody wants

    def _begin(self, scenario: Scenario) -> Scene:
        traffic = scenario.traffic
        assert traffic is not None
        self._prepare(scenario)
        self._traffic, self._name = traffic, scenario.ego.id
        self._departed: list[Vehicle] = []  # learning cars that the agents have not taken yet
        self._free = traffic.max_cars  # learning cars of a type that may still come
        self._models = dict(traffic.models)
        self._session.load(file_settings(scenario, self._options, self._episode_folder()))
        self._time = -inf  # no episode yet
        self._insert_ego()
        self._time = 0.0
        for name in self._road:
            self._plan(name, 0.0)
        self._take_wheels()
        return self._read()

    def _take_wheels(self) -> None:
        """Learning cars that have departed are the agents' from now on."""
        for vehicle in self._departed:
            if vehicle.name in self._road:
                self._take(RouteEgo(self._session, self._network, vehicle, self._scenario))
        self._departed = []

    def _episode_folder(self) -> Path:
        """Where SUMO writes: a new folder of the user's; without one, a folder that is deleted by `close`."""
        if self._folders is not None:
            return self._folders.new()
        self._unwanted = own_folder() / "outputs"
        self._unwanted.mkdir(exist_ok=True)
        return self._unwanted

    def close(self) -> None:
        """See `Simulator.close`."""
        super().close()
        if self._unwanted is not None:
            shutil.rmtree(self._unwanted, ignore_errors=True)

    def _insert_ego(self) -> None:
        """Drive until the ego has departed, at the end of the warm-up or later."""
        session, scenario, traffic = self._session, self._scenario, self._traffic
        name, origin = self._name, traffic.origin
        for _ in range(round(scenario.warm_up / self._dt)):
            self._advance()
        if origin.edges and not session.send(name, origin.edges, origin.is_trip, origin.type, origin.speed):
            first, last = origin.edges[0], origin.edges[-1]
            raise SimulatorError(f"no route leads from edge {first!r} to {last!r} for type {origin.type!r}")
        steps = 0
        while not any(vehicle.name in self._road for vehicle in self._departed):
            if self._departed and not (scenario.further or traffic.car_type):
                raise SimulatorError(f"the ego {name!r} has left the road before 'warm_up' was over")
            if steps * self._dt >= traffic.wait:
                raise SimulatorError(self._why_not_here())
            self._advance()
            steps += 1

    def _is_learning(self, name: str) -> bool:
        """Whether a vehicle that departs is a learning car."""
        if self._traffic.car_type:
            is_one = self._session.type_of(name) == self._traffic.car_type
            self._free -= is_one
            return is_one and self._free >= 0
        return name == self._name or name in self._scenario.further

    def _why_not_here(self) -> str:
        cars = self._traffic.car_type or ", ".join((self._name, *self._scenario.further))
        why = "it departs later ('wait', 'begin'), SUMO has left it out ('scale'), or there is none"
        if self._name in self._session.simulation.getPendingVehicles():
            kind = self._session.vehicle.getVehicleClass(self._name)
            why = f"there is no room where it departs, or no lane for vehicles of class {kind!r}"
        now = self._session.simulation.getTime()
        return f"the learning car ({cars}) has not departed within {self._traffic.wait:g} s, at SUMO's {now:g} s: {why}"

    # -- a policy step -------------------------------------------------------------------------------------

    def _come_and_go(self, commands: Commands) -> None:
        """Cars that are at their end, and have no command, are SUMO's from now on."""
        for name in [name for name, car in self._cars.items() if car.ego.ended and name not in commands]:
            ego = self._cars.pop(name).ego
            if name in self._road:
                ego.vehicle.command(False, False)
                ego.vehicle.coasting = ego.speed

    def _note(self, reported: Sequence[tuple[str, str]]) -> None:
        """Crashes of others change nothing, as with ``sumo``; learning cars may have departed."""
        self._take_wheels()

    def _advance(self) -> Sequence[tuple[str, str]]:
        """One step of SUMO; returns the pairs of vehicles that it reports in collision."""
        session = self._session
        reported = self._step_sumo()
        for name in session.simulation.getDepartedIDList():
            self._road[name] = vehicle = Vehicle(session, name, OF_SUMO, self._is_learning(name))
            if vehicle.is_learning:
                self._departed.append(vehicle)
            elif self._scenario.risk > 0.0:
                self._make_risky(vehicle)
        for name in session.arrived:
            self._road.pop(name, None)
        teleporting = session.simulation.getStartingTeleportIDList()
        for name, car in self._cars.items():
            if car.ego.ended:
                continue
            if name in teleporting:  # one that would get beyond its route leaves in the same step
                car.ego.ended = "removed"
            elif name not in self._road:
                car.distance += car.ego.leave()
        return reported

    # -- risk ----------------------------------------------------------------------------------------------

    def _make_risky(self, vehicle: Vehicle) -> None:
        """What the dose does to a vehicle that has come: its parameters, and its events once the episode has begun."""
        name = vehicle.name
        if not self._may_be_risky(name):
            return
        model = self._models.get(self._session.type_of(name), "")
        drawn = self._traffic.ranges, self._scenario.risk, self._scenario.seed, name, model
        deviate(self._session, vehicle, deviation(*drawn))
        if self._time >= 0.0:
            self._plan(name, self._time)

    def _plan(self, name: str, start: float) -> None:
        if self._may_be_risky(name):
            self._events.plan(name, self._drawn(name, start))

    def _may_be_risky(self, name: str) -> bool:
        kind = self._session.vehicle.getVehicleClass(name)
        return kind in RISKY_CLASSES and not self._road[name].is_learning

    def _drawn(self, name: str, start: float) -> tuple[RiskEvent, ...]:
        """The events of a vehicle from `start` [s] on; its random streams have its own name."""
        scenario, traffic = self._scenario, self._traffic
        laws, lifetime = ((-inf, scenario.seed), *traffic.imagined, (inf, 0)), ((name, start),)
        events: list[RiskEvent] = []
        for (after, seed), (until, _) in pairwise(laws):
            given, purpose = (scenario.risk, lifetime, seed, traffic.duration), f"risk events of {name}"
            drawn = draw_events(traffic.rates, *given, purpose)
            drawn += draw_own_events(traffic.own_kinds, *given, f"own {purpose}")
            events += [event for event in drawn if after < event.time <= until]
        if scenario.tilt is not None:
            events += scenario.tilt.further(lifetime, scenario.seed, f"further risk events of {name}")
        return tuple(events)

    def imagine(self, scenario: Scenario) -> None:
        """See `Simulator.imagine`."""
        assert scenario.traffic is not None
        self._scenario, self._traffic = scenario, scenario.traffic
        now, _ = scenario.traffic.imagined[-1]
        risky = filter(self._may_be_risky, self._road)
        self._events.replace([event for name in risky for event in self._drawn(name, now)], now)

    # -- reading -------------------------------------------------------------------------------------------

    def _read(self) -> Scene:
        return replace(super()._read(), signals=self._session.signals())

    def _others(self) -> list[str]:
        return [name for name in self._session.vehicles() if name not in self._cars]

    def _seen(self, name: str, car: Car) -> tuple[Light, Place | None]:
        light = NO_LIGHT if car.ego.ended in GONE else self._session.next_light(name)
        return light, car.ego.place(len(self._session.simulation.getPendingVehicles()))
