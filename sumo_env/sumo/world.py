"""An episode in SUMO: a scenario in, then one `Step` after every policy step.

SUMO drives the traffic. In every sub-step only learning cars, crashed vehicles and vehicles in a risk event are
commanded; then SUMO steps, and what is near a learning car is read for contacts and time to collision. All vehicles are
read once per policy step.
"""

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from sumo_env.contacts.crash import CrashRecord, is_confirmed
from sumo_env.contacts.rectangles import State
from sumo_env.scene import NO_LIGHT, Light, Place, Scene
from sumo_env.simulator import Commands, SimulatorError, Step, WindowClosed
from sumo_env.sumo.ego import Ego, coast
from sumo_env.sumo.engine import LIBSUMO, window
from sumo_env.sumo.events import Events
from sumo_env.sumo.learning_car import Car
from sumo_env.sumo.libsumo_calls import plain
from sumo_env.sumo.paths import EpisodeFolders, prefix, written
from sumo_env.sumo.session import Session
from sumo_env.sumo.settings import Settings, leaves_traces, placed_settings
from sumo_env.sumo.user_options import LIVE, OUTPUT_DIR
from sumo_env.sumo.vehicle import OF_SUMO, Vehicle, modes
from sumo_env.traffic.drivers import Calibration, Driver, DriverPool, vehicle_type
from sumo_env.traffic.scenario import EGO, EGO_DISTANCE, EXIT_LENGTH, Scenario, VehicleSpec, fits

MOST_KEPT = 1024  # vehicle types that stay loaded between episodes
GONE = ("arrived", "removed")  # how a car's way may have ended off the road


class SumoSimulator:
    """SUMO as a `Simulator`; a process may hold one of them (`SumoProcess` cares for that).

    Args:
        options: further options of SUMO, as of `check_options`; `LIVE` for its own window.
    """

    def __init__(self, options: Mapping[str, str] = {}) -> None:
        self._session = Session(window() if LIVE in options else LIBSUMO)
        self._options = {name: value for name, value in options.items() if name != LIVE}
        self._folders = EpisodeFolders(options[OUTPUT_DIR]) if OUTPUT_DIR in options else None
        self._drivers: dict[str, Driver] = {}  # whose vehicle types are loaded
        self._kept: dict[str, Driver] = {}  # those of them that stay loaded
        self._pools: tuple[DriverPool, ...] = ()  # of the episode before
        self._loaded: Settings | None = None
        self._is_whole = True  # whether the last reset or step has come to its end
        self._base: tuple[Path, float, Calibration]  # of what is loaded: network, step length, calibration

    # -- Simulator -----------------------------------------------------------------------------------------

    def reset(self, scenario: Scenario) -> Scene:
        """Place a scenario, drive its warm-up, and return the first scene."""
        if not self._is_whole:
            self._session.close()
        self._is_whole = False
        for _ in range(2):  # SUMO may have been closed, or loaded with something else, behind our back
            try:
                scene = self._begin(scenario)
                self._is_whole = True
                return self._events.counted(scene)
            except self._session.errors as error:
                self._session.forget()
                self._check_window(error)
                refusal = error
        loaded = dict(scenario.traffic.options) if scenario.traffic else {}
        named = ", ".join(filter(None, map(loaded.get, ("net-file", "route-files", "additional-files"))))
        files = f" of {named}" if named else ""
        options = " ".join(f"--{name}={value}" for name, value in self._options.items())
        raise SimulatorError(
            f"SUMO cannot begin this episode{files} ({scenario.task}): {_words(refusal)} What it says is above"
            f"{f'; its options are {options}' if options else ''}"
        ) from refusal

    def step(self, commands: Commands, trace: bool = False) -> Step:
        """Drive one policy step; after an error, or Ctrl-C, the episode is over."""
        if not self._is_whole:
            raise SimulatorError("this episode ended in the midst of a step: call reset()")
        self._is_whole = False
        try:
            step = self._step(commands, trace)
            self._is_whole = True
            return step
        except self._session.errors as error:
            self._session.forget()
            self._check_window(error)
            raise SimulatorError(
                f"SUMO cannot go on with this episode ({self._scenario.task}, seed {self._scenario.seed}, "
                f"{self._time:.1f} s): {_words(error)} Are files wrong, or was libsumo called elsewhere? Call reset()."
            ) from error

    def _check_window(self, error: Exception) -> None:
        """An error if SUMO's window is gone."""
        if isinstance(error, self._session.gone):
            raise WindowClosed("SUMO's window was closed: this episode ends") from error

    def imagine(self, scenario: Scenario) -> None:
        """Go on with the risk events of this scenario that have not begun."""
        self._scenario = scenario
        self._events.replace(scenario.events, round(self._time, 6))

    def call(self, path: str, arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
        """A function of libsumo, such as ``vehicle.getSpeed``; objects of SUMO become plain ones."""
        return plain(operator.attrgetter(path)(self._session.sumo)(*arguments, **named))

    def __reduce__(self) -> NoReturn:  # neither by pickle nor by copy.deepcopy, see `SumoProcess`
        raise TypeError("a SumoSimulator by itself cannot be copied: leave `simulator` out")

    def close(self) -> None:
        """End the simulation."""
        self._loaded = None
        self._session.close()

    # -- start of an episode -------------------------------------------------------------------------------

    def _prepare(self, scenario: Scenario) -> None:
        """Nobody is on the road yet."""
        self._scenario, self._network = scenario, scenario.network
        self._dt = 1.0 / scenario.simulation_frequency
        self._substeps = scenario.simulation_frequency // scenario.policy_frequency
        self._road: dict[str, Vehicle] = {}  # the vehicles on the road, learning cars among them
        # the learning cars of the scene; of files, some may have left the road
        self._cars: dict[str, Car] = {}
        self._events = Events(self._session, scenario, self._network, self._road)

    def _begin(self, scenario: Scenario) -> Scene:
        self._prepare(scenario)
        settings = self._settings(scenario)
        if leaves_traces(scenario) or written(self._options):
            where = prefix(self._folders.new()) if self._folders is not None else {}
            options = {**settings.options, "seed": str(scenario.seed), **where}
            self._session.load(replace(settings, options=options))
        elif not self._session.clear(settings):
            self._session.load(settings)
        self._steps_done = 0
        self._drive_warm_up()
        for spec in scenario.cars:
            self._place(spec)
        for spec in scenario.cars:
            self._take(Ego(self._session, scenario, self._network, spec, self._road[spec.id]))
        return self._read()

    def _take(self, ego: Any) -> None:
        """A learning car is on the road."""
        name = ego.vehicle.name
        self._session.follow(name, is_first=not self._cars)
        self._cars[name] = Car(self._session, name, ego, self._network.meeting)

    def _settings(self, scenario: Scenario) -> Settings:
        """What has to be loaded: the network, and every driver that may come.

        The drivers of a dose stay loaded once it has come twice in succession; where every episode has another dose,
        each loads no more than its own drivers.
        """
        base = self._network.net_file, self._dt, scenario.calibration
        if self._loaded is None or base != self._base:
            self._loaded, self._base, self._pools, self._kept, self._drivers = None, base, (), {}, {}
        again, self._pools = scenario.pools == self._pools, scenario.pools
        wanted = {spec.driver.type: spec.driver for spec in scenario.everybody}
        if self._loaded is not None and wanted.items() <= self._drivers.items():
            return self._loaded
        pooled = {driver.type: driver for pool in scenario.pools for driver in pool.drivers}
        # a scenario may hold drivers of its own
        self._kept |= {name: driver for name, driver in wanted.items() if name not in pooled}
        self._kept |= pooled if again else {}
        if len(self._kept) > MOST_KEPT:
            self._kept = {}
        self._drivers = self._kept | wanted
        types = {name: vehicle_type(driver, scenario.calibration) for name, driver in self._drivers.items()}
        self._loaded = placed_settings(self._network, self._dt, types, self._options)
        return self._loaded

    def _place(self, spec: VehicleSpec) -> None:
        """Put a vehicle on the road; SUMO drives all but learning cars."""
        size = spec.driver.size
        route, lane, position = self._network.place(spec.lane, spec.s, spec.destination, size[0] / 2.0)
        limit = self._network.road.lane(spec.lane).speed_limit
        learns = spec.id == EGO or spec.id in self._scenario.further
        desired = limit if learns else min(spec.target_speed, limit)
        base = modes(spec, self._scenario.calibration)
        vehicle = Vehicle(self._session, spec.id, base, is_learning=learns, held=learns or spec.is_obstacle)
        self._session.add(
            spec.id, route, spec.driver.type, lane, position, spec.speed, desired, vehicle.now, size
        )
        if spec.is_obstacle:
            vehicle.drive(0.0)
        self._road[spec.id] = vehicle

    def _drive_warm_up(self) -> None:
        """Let the traffic drive before learning cars come, then make room (IntersectionEnv._make_vehicles)."""
        scenario = self._scenario
        for spec in scenario.vehicles:
            if spec.concerns_ego and spec.id not in scenario.further:
                self._place(spec)
        self._time = 0.0 - scenario.warm_up
        if not scenario.warm_up:
            return
        for _ in range(round(scenario.warm_up / self._dt)):
            self._note(self._advance())
        self._time = 0.0
        self._let_in()
        for name, state in self._session.read(self._road).items():
            if any(math.hypot(state[0] - car.x, state[1] - car.y) < EGO_DISTANCE for car in scenario.cars):
                self._remove(name)

    # -- a policy step -------------------------------------------------------------------------------------

    def _step(self, commands: Commands, trace: bool) -> Step:
        self._session.check()
        self._come_and_go(commands)
        self._obey(commands)
        scenes: list[Scene] = []
        for _ in range(self._substeps):
            driving = [car for car in self._cars.values() if not car.ego.ended]
            if not driving:
                break
            self._events.act(self._time, self._dt)
            for car in driving:
                car.ego.drive(car.around.ego, self._dt)
            reported = self._advance()
            there = [car for car in driving if car.name in self._cars and car.ego.ended not in GONE]
            for car in there:
                car.distance += car.ego.settle(self._dt)
            self._commanded |= {car.name: car.ego.speed for car in there if len(there) > 1}
            for car in there:
                if (crash := car.update(self._time, self._dt, reported, self._commanded)) is not None:
                    self._hit(car, crash)
            self._note(reported)
            if trace:
                scenes.append(self._read())
        scenes = scenes or [self._read()]
        scenes[-1] = self._events.counted(scenes[-1])
        met = {name: car.met() for name, car in self._cars.items()}
        return Step(scenes[-1], met, tuple(scenes) if trace else ())

    def _come_and_go(self, commands: Commands) -> None:
        """What happens to vehicles between two policy steps."""
        if self._steps_done:
            self._let_out(commands)
            self._let_in()
        self._steps_done += 1

    def _obey(self, commands: Commands) -> None:
        """Begin a policy step of the learning cars whose way has not ended: who has no command is SUMO's."""
        for name, command in commands.items():
            if command is None:
                self._remove(name)
            elif name not in self._cars:
                raise SimulatorError(f"the car {name!r} is gone: did libsumo remove it? Call reset().")
        for name, car in self._cars.items():
            if not car.ego.ended:
                car.obey(commands.get(name))

    def _advance(self) -> Sequence[tuple[str, str]]:
        """One step of SUMO; returns the pairs of vehicles of the scenario that it reports in collision."""
        reported = self._step_sumo()
        for name in self._session.arrived:
            if name in self._cars and self._cars[name].is_commanded:
                where = f"the end of the road ({self._scenario.task}, {self._time:.1f} s)"
                raise SimulatorError(f"the car {name!r} has driven off {where}: choose a shorter 'duration'")
            self._forget(name)
        return [pair for pair in reported if all(name in self._road for name in pair)] if reported else ()

    def _step_sumo(self) -> Sequence[tuple[str, str]]:
        """One step in which the crashed vehicles coast; returns the pairs that SUMO reports in collision."""
        self._commanded: dict[str, float] = {}  # speeds by which vehicles that are not SUMO's drive [m/s]
        for name, vehicle in self._road.items():
            if not vehicle.crashed or name in self._cars:
                continue
            vehicle.coasting, distance = coast(vehicle.coasting, self._dt)
            self._commanded[name] = vehicle.coasting
            if lane := self._session.vehicle.getLaneID(name):  # else SUMO is teleporting it
                vehicle.drive(distance / self._session.step_length * self._network.stretch(lane))
        self._time += self._dt
        return self._session.step()

    def _hit(self, car: Car, crash: CrashRecord) -> None:
        """A learning car has crashed, and the other vehicle too."""
        if crash.other in self._cars:
            self._cars[crash.other].be_hit(car, crash)
        else:
            self._crash(crash.other)

    def _note(self, reported: Sequence[tuple[str, str]]) -> None:
        """Crashes of the other traffic are those that SUMO reports; the first one of a learning car is its own."""
        cars = self._cars
        for pair in reported:
            if not all(self._road[name].crashed for name in pair if name in cars):
                continue
            if all(name in cars or self._road[name].crashed for name in pair):
                continue
            states = self._session.read(pair)
            if is_confirmed(states[pair[0]], states[pair[1]], *self._session.halves(pair)):
                for name in pair:
                    if name not in cars:
                        self._crash(name)

    def _crash(self, name: str) -> None:
        """A vehicle that is no learning car has crashed."""
        if name not in self._road:  # somebody else has added it
            self._road[name] = Vehicle(self._session, name, OF_SUMO)
        self._road[name].crash(self._session.vehicle.getSpeed(name))

    # -- vehicles that come and go (intersection) ----------------------------------------------------------

    def _let_out(self, commands: Commands) -> None:
        """Remove vehicles without a command near the end of an exit, and those that a user of libsumo has removed."""
        present = self._session.vehicles()
        if len(present) != len(self._road):
            for name in set(self._road).difference(present):
                self._forget(name)
        road = self._network.road
        if not road.clears_exits:
            return
        for name, (x, y, _, _) in self._session.read(n for n in self._road if n not in commands).items():
            index = self._network.indices[self._session.vehicle.getLaneID(name)]
            lane = road.lane(index)
            if index[1] in road.ends and lane.local_coordinates(x, y)[0] >= lane.length - EXIT_LENGTH:
                self._remove(name)

    def _let_in(self) -> None:
        """Try to add the vehicles that the scenario sends now."""
        coming = [spawn.vehicle for spawn in self._scenario.spawns if spawn.step == self._steps_done]
        if coming:
            centres = [state[:2] for state in self._session.read(self._road).values()]
            for spec in coming:
                if fits(spec, centres):
                    self._place(spec)
                    centres.append((spec.x, spec.y))

    def _remove(self, name: str) -> None:
        """Take a vehicle off the road, if it has not left it by itself."""
        if name in self._road:
            self._session.vehicle.remove(name)
        self._forget(name)

    def _forget(self, name: str) -> None:
        self._road.pop(name, None)
        self._cars.pop(name, None)

    # -- reading -------------------------------------------------------------------------------------------

    def _read(self) -> Scene:
        """The scene by SUMO's vehicles, the learning cars first."""
        cars = self._cars
        ids, seen = (*cars, *self._others()), [self._seen(name, car) for name, car in cars.items()]
        states: dict[str, State] = {}
        for car in cars.values():
            states |= car.around.near if not car.ego.ended else {}
        states |= {name: car.around.ego for name, car in cars.items()}
        states |= self._session.read([name for name in ids if name not in states])
        x, y, speed, heading = map(np.array, zip(*[states[name] for name in ids], strict=True))
        crashed = np.zeros(len(ids), np.bool_)
        crashed[: len(cars)] = [car.ego.vehicle.crashed for car in cars.values()]
        for row, name in enumerate(ids[len(cars) :], len(cars)):
            vehicle = self._road.get(name)
            if vehicle is not None and vehicle.crashed:  # a commanded speed, as the ego's
                crashed[row], speed[row] = True, vehicle.coasting
        present = set(ids) if self._session.sizes else ()
        sizes = {name: size for name, size in self._session.sizes.items() if name in present}
        return Scene(
            *(ids, x, y, speed, heading, crashed, round(self._time, 6), self._events.acting, sizes),
            *(seen[0] if seen else (NO_LIGHT, None)),
            cars=len(cars),
            further=dict(zip(ids[1:], seen[1:], strict=False)),
        )

    def _others(self) -> list[str]:
        """The vehicles but learning cars: first those of the scenario, then those that somebody else has added."""
        known = [name for name in self._road if name not in self._cars]
        present = self._session.vehicles()
        if len(present) > len(known) + len(self._cars):
            known += [name for name in present if name not in self._road]
        return known

    def _seen(self, name: str, car: Car) -> tuple[Light, Place | None]:
        """What a learning car has ahead of it."""
        return NO_LIGHT, None


def _words(error: Exception) -> str:
    """What SUMO says, as a sentence."""
    return str(error).strip().rstrip(".") + "."
