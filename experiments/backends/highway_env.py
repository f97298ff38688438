"""The reference: highway-env itself, with the traffic of a `Scenario` in place of its own draws.

Roads, vehicles, collisions, observations, rewards and endings are highway-env's code. Replaced are only the vehicles'
places and drivers (those of `sumo_env` for this seed), the risk events, and, so that both simulators are measured
alike, the time limit and ``info``.

The configuration is that of `sumo_env`, with ``simulation_frequency`` 15 as in highway-env and two keys more.
``risk_law`` says who is risky: "standard", as in `sumo_env`, or "linear", see `sumo_env.replica.linear`. ``variant``
says how far drivers see beyond the end of their lane (the highway and the two-way road have no joins):

    "v0"         not at all (roundabout-v0, intersection-v0, u-turn-v0);
    "connected"  onto the next lanes, distances projected (roundabout-v1, intersection-v2, u-turn-v1);
    "path"       onto the next lanes, distances along the path (the default).
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from highway_env import envs
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.regulation import RegulatedRoad
from highway_env.vehicle.kinematics import Vehicle

from experiments.backends.highway_env_table import told
from experiments.backends.highway_env_vehicle import (
    LinearScenarioVehicle,
    PathLinearVehicle,
    PathVehicle,
    ScenarioVehicle,
)
from sumo_env.config import Config, ConfigError, one_of, resolve
from sumo_env.contacts import measures
from sumo_env.contacts.crash import CrashRecord, crash_record
from sumo_env.contacts.rectangles import State, separation, state_of, states
from sumo_env.networks.roads import LaneIndex
from sumo_env.replica.linear import LAWS, LinearDriver, draw, linear_drivers
from sumo_env.scene import OBSTACLE_SIZE, Scene
from sumo_env.simulator import EgoStep
from sumo_env.spaces.factory import interface
from sumo_env.spaces.info import information
from sumo_env.sumo import export
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import Task
from sumo_env.traffic.risk import RiskEvent, free_way, has_room
from sumo_env.traffic.scenario import EGO, EGO_DISTANCE, Scenario, VehicleSpec, fits

VARIANTS = ("v0", "connected", "path")
# Keys of highway-env that `sumo_env` does not have, as they have to be here.
FIXED: Config = {
    "controlled_vehicles": 1,
    "manual_control": False,
    "offscreen_rendering": True,
    "real_time_rendering": False,
    "render_agent": True,
    "show_trajectories": False,
}


class ScenarioEnv(AbstractEnv):
    """What all have in common; always mixed into highway-env's environment of a task.

    Attributes as `sumo_env.env.DrivingEnv`; observation_type is highway-env's, with `ranges` added.
    """

    task: ClassVar[Task]
    config: Config
    _motion: tuple[float, float]  # speed [m/s] and acceleration [m/s2] at the end of the last step

    # -- configuration -------------------------------------------------------------------------------------

    @classmethod
    def default_config(cls) -> Config:
        """Every key with its default."""
        own = {"simulation_frequency": 15, **cls.task.defaults, "variant": "path", "risk_law": LAWS[0]}
        return resolve(cls.task.name, own)

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Lay `config` over the present configuration; takes effect at the next reset.

        Raises:
            ConfigError: unknown key, wrong value.
        """
        chosen = resolve(self.task.name, self.default_config(), self.config, config)
        variant = one_of("'variant'", chosen["variant"], VARIANTS)
        one_of("risk_law", chosen["risk_law"], LAWS)
        self._offered = interface(self.task, chosen, steers=True)
        kind = self._offered.action_type
        if not kind.names:
            raise ConfigError(
                f"action type {chosen['action']['type']!r}: it can only be 'DiscreteMetaAction'"
            )
        self.actions, self.target_speeds = kind.names, kind.target_speeds
        # target speeds that are not given are the task's, as in `sumo_env`; in highway-env it would be the highway's
        chosen["action"] = {**chosen["action"], "target_speeds": list(self.target_speeds)}
        connected = self.task.road(chosen).joined and variant != "v0"
        self.config = {**chosen, **FIXED, "neighbour_vehicles_connected_lanes": connected}

    def define_spaces(self) -> None:
        """highway-env's observation and action types; see `highway_env_table.told`."""
        super().define_spaces()
        self.observation_type = told(self, self._offered.observation_type)

    # -- gymnasium -----------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; the same seed and config give the same scenario as in `sumo_env`.

        Args:
            seed: of the environment's generator.
            options: ``config``, ``risk_rates`` and ``risk_ranges``, as of `sumo_env.env.DrivingEnv.reset`.

        Raises:
            ConfigError: another option, an unknown name.
        """
        varied = dict(options or {})
        # also when no options are given: users of highway-env write to env.unwrapped.config directly
        config = varied.pop("config", None) or {}
        if varied.keys() - {"risk_rates", "risk_ranges"}:
            raise ConfigError(
                f"reset's options on highway-env are 'config', 'risk_rates' and 'risk_ranges', not {options!r}"
            )
        self._drawn_by = self.task.varied(varied)
        return super().reset(seed=seed, options={"config": config})

    def step(self, action: int) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """highway-env's step, with the ``info`` of `sumo_env.env.DrivingEnv.step`."""
        if int(action) not in self.actions:
            raise ValueError(f"action must be one of {self.actions}, not {action!r}")
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, float(reward), bool(terminated), bool(truncated), info

    def _is_truncated(self) -> bool:
        # counted in steps: highway-env adds up times, and its two-way road leaves the limit to a wrapper
        return bool(self.steps >= self.config["duration"] * self.config["simulation_frequency"])

    def _info(self, obs: np.ndarray, action: Any = None) -> dict[str, Any]:
        action = int(action) if self.steps else None  # at a reset highway-env passes a random one
        speed, frequency = float(self.scene.speed[0]), self.config["policy_frequency"]
        before, last = self._motion if self.steps else (speed, 0.0)
        acceleration = (speed - before) * frequency
        self._motion = speed, acceleration
        met = self.scene, EgoStep(self.vehicle.lane_index, self.crash, self.min_ttc, self.distance)
        return {"acceleration": acceleration, "jerk": (acceleration - last) * frequency} | information(
            *met,
            arrived=self._arrived(),
            on_road=self.vehicle.on_road,
            rewards=self._rewards(action),
            action=self._offered.action_type.no_action if action is None else action,
            ending=self._ending(),
        )

    def _ending(self) -> str:
        """As `sumo_env.spaces.info.ending`."""
        if self.vehicle.crashed or (self._arrived() and self._is_terminated()):
            return "crash" if self.vehicle.crashed else "arrived"
        return "time" if self.steps and self._is_truncated() else ""

    def _arrived(self) -> bool:
        return False

    # -- an episode ----------------------------------------------------------------------------------------

    def _reset(self) -> None:
        seed, self._linear = int(self.np_random.integers(2**31)), dict[str, LinearDriver]()
        if self.config["risk_law"] == "linear":
            self.scenario: Scenario = draw(self._drawn_by, self.config, seed)
            self._linear = linear_drivers(self.scenario)
        else:
            self.scenario = self._drawn_by.scenario(self.config, seed)
        self._events = list(self.scenario.events)
        self._pushes: dict[str, tuple[float, RiskEvent]] = {}  # vehicle -> end [s] and event
        self.crash: CrashRecord | None = None
        self.min_ttc, self.distance = math.inf, 0.0
        super()._reset()
        self.scene = self._scene()
        self._scenes = [self.scene]

    def export(self, folder: str | Path) -> list[Path]:
        """Write the present episode for ``sumo`` and ``sumo-gui``; see `sumo_env.sumo.export`."""
        return export.write(Path(folder), self.scenario, self._scenes)

    def _make_vehicles(self, *_: Any) -> None:
        """Place the scenario, in place of highway-env's draws, and drive its warm-up (`Simulator.reset`)."""
        scenario, spec = self.scenario, self.scenario.ego
        place = [spec.x, spec.y]
        standing = [other for other in scenario.vehicles if other.is_obstacle]
        for box, known in zip(self.road.objects, standing, strict=True):
            box.id = known.id
        vehicles = [self._vehicle_of(other) for other in scenario.vehicles if not other.is_obstacle]
        self.road.vehicles = vehicles
        if scenario.warm_up:
            for _frame in range(round(scenario.warm_up * self.config["simulation_frequency"])):
                self.road.act()
                self.road.step(1 / self.config["simulation_frequency"])
            self._let_in(0)
            vehicles = [v for v in self.road.vehicles if np.linalg.norm(v.position - place) >= EGO_DISTANCE]
        ego = self.action_type.vehicle_class(self.road, place, heading=spec.heading, speed=spec.speed)
        ego.id = EGO
        if spec.destination is not None:
            ego.plan_route_to(spec.destination)
        self.vehicle = ego
        self.road.vehicles = [ego, *vehicles]

    _create_vehicles = _make_vehicles  # its name on the highway

    def _let_in(self, step: int) -> None:
        """Add the vehicles that the scenario sends after this policy step, unless another one is within 15 m."""
        for spawn in self.scenario.spawns:
            if spawn.step == step and fits(spawn.vehicle, [tuple(v.position) for v in self.road.vehicles]):
                self.road.vehicles.append(self._vehicle_of(spawn.vehicle))

    def _vehicle_of(self, spec: VehicleSpec) -> ScenarioVehicle:
        """A vehicle of the scenario, with its driver."""
        far = self.config["neighbour_vehicles_connected_lanes"] and self.config["variant"] == "path"
        if spec.id not in self._linear:
            return (PathVehicle if far else ScenarioVehicle).place(self.road, spec)
        kind = PathLinearVehicle if far else LinearScenarioVehicle
        vehicle = kind.place(self.road, spec)
        vehicle.drive_as(self._linear[spec.id])
        return vehicle

    def _simulate(self, action: int | None = None) -> None:
        """``AbstractEnv._simulate``, with the risk events before and the measurements after every sub-step."""
        self.min_ttc, self.distance = math.inf, 0.0
        frequency = self.config["simulation_frequency"]
        frames = int(frequency // self.config["policy_frequency"])
        for frame in range(frames):
            self._start_events(self.steps / frequency)
            if frame == 0:
                self.action_type.act(action)
            self.distance += max(float(self.vehicle.speed), 0.0) / frequency
            self.road.act()
            self._push(self.steps / frequency)
            self.road.step(1 / frequency)
            self.steps += 1
            self.scene = self._scene()
            self._scenes.append(self.scene)
            self._measure()
            if frame < frames - 1:
                self._automatic_rendering()
        self.enable_auto_render = False

    def _start_events(self, time: float) -> None:
        """Risk events that are due; those of vehicles that are gone or crashed are dropped."""
        while self._events and self._events[0].time <= time + 1e-9:
            event = self._events.pop(0)
            for vehicle in [v for v in self.road.vehicles if v.id == event.vehicle and not v.crashed]:
                if event.kind_on("highway-env") == "cut-in":
                    self._cut_in(vehicle, event.direction)
                else:
                    self._pushes[event.vehicle] = (time + event.duration, event)

    def _cut_in(self, vehicle: ScenarioVehicle, direction: int) -> None:
        for lane in vehicle.lanes_beside(direction):
            if self._has_room(vehicle, lane):
                vehicle.cut_in(lane)
                return

    def _has_room(self, vehicle: ScenarioVehicle, index: LaneIndex) -> bool:
        lane = self.road.network.get_lane(index)
        s = lane.local_coordinates(vehicle.position)[0]
        x, y = map(float, lane.position(s, 0.0))
        there = (x, y, float(vehicle.speed), float(lane.heading_at(s)))
        return has_room(there, self._others(vehicle)[1])

    def _others(self, vehicle: Vehicle) -> tuple[State, list[State]]:
        """The state of a vehicle and those of all others."""
        scene = self._scene()
        others, row = states(scene), scene.ids.index(vehicle.id)
        return others.pop(row), others

    def _push(self, time: float) -> None:
        """Sudden braking and surges, over what the drivers have decided."""
        self._pushes = {name: push for name, push in self._pushes.items() if time < push[0] - 1e-9}
        if not self._pushes:
            return
        for vehicle in self.road.vehicles:
            if vehicle.id not in self._pushes or vehicle.crashed:
                continue
            event = self._pushes[vehicle.id][1]
            wanted = vehicle.action["acceleration"]
            if event.accel < 0.0:  # to a standstill, never backwards
                hardest = max(float(vehicle.speed), 0.0) * self.config["simulation_frequency"]
                vehicle.action["acceleration"] = min(wanted, -min(-event.accel, hardest))
            elif free_way(*self._others(vehicle), event.way):
                vehicle.action["acceleration"] = max(wanted, event.accel)

    def _measure(self) -> None:
        scene = self.scene
        if not scene.crashed[0]:
            ego, *others = states(scene)
            near = [o for o in others if math.hypot(o[0] - ego[0], o[1] - ego[1]) <= measures.TTC_RADIUS]
            self.min_ttc = min(self.min_ttc, measures.ego_ttc(ego, near))
        elif self.crash is None:
            # highway-env says that the ego crashed, not with whom: with the nearest of the wrecks
            gaps = [separation(state_of(scene, 0), state_of(scene, row)) for row in range(len(scene))]
            other = min(range(1, len(scene)), key=lambda row: (not scene.crashed[row], gaps[row]))
            self.crash = crash_record(scene, other, "highway-env")

    def _scene(self) -> Scene:
        ego = self.vehicle
        vehicles: list[Any] = [ego, *(v for v in self.road.vehicles if v is not ego), *self.road.objects]
        x, y = np.array([vehicle.position for vehicle in vehicles]).T.copy()
        speed = np.array([float(vehicle.speed) for vehicle in vehicles])
        heading = np.array([float(vehicle.heading) for vehicle in vehicles])
        crashed = np.array([bool(vehicle.crashed) for vehicle in vehicles])
        time = round(self.steps / self.config["simulation_frequency"], 6)
        sizes = {box.id: OBSTACLE_SIZE for box in self.road.objects}
        return Scene(tuple(v.id for v in vehicles), x, y, speed, heading, crashed, time, sizes=sizes)


class HighwayScenario(ScenarioEnv, envs.HighwayEnv):
    """highway-v0."""

    task = TASKS["highway"]


class TwoWayScenario(ScenarioEnv, envs.TwoWayEnv):
    """two-way-v0, of any length."""

    task = TASKS["two-way"]

    def _make_road(self, *_: Any) -> None:
        super()._make_road(length=float(self.config["road_length"]))

    def _cut_in(self, vehicle: ScenarioVehicle, direction: int) -> None:
        """A swerve into the lane of the oncoming traffic, of those who drive beside it."""
        own, oncoming = ("a", "b", 1), ("a", "b", 0)
        if vehicle.lane_index == vehicle.target_lane_index == own and self._has_room(vehicle, oncoming):
            vehicle.swerve(oncoming)


class RoundaboutScenario(ScenarioEnv, envs.RoundaboutEnv):
    """roundabout-v0 and -v1."""

    task = TASKS["roundabout"]


class UTurnScenario(ScenarioEnv, envs.UTurnEnv):
    """u-turn-v0 and -v1."""

    task = TASKS["u-turn"]


class MergeScenario(ScenarioEnv, envs.MergeEnv):
    """merge-v0 and -v1."""

    task = TASKS["merge"]

    def _arrived(self) -> bool:
        return bool(self.vehicle.position[0] > 370)


class ExitScenario(ScenarioEnv, envs.ExitEnv):
    """exit-v0 and -v1."""

    task = TASKS["exit"]
    _arrived = envs.ExitEnv._is_success


class IntersectionScenario(ScenarioEnv, envs.IntersectionEnv):
    """intersection-v0 and -v2."""

    task = TASKS["intersection"]

    def _make_road(self) -> None:
        super()._make_road()
        self.road.respect_priorities = _yields

    def _spawn_vehicle(self, *_: Any, **__: Any) -> None:
        """After every policy step: the scenario's vehicles, in place of highway-env's draws."""
        self._let_in(self.steps * self.config["policy_frequency"] // self.config["simulation_frequency"])

    def _arrived(self) -> bool:
        return bool(self.has_arrived(self.vehicle))


def _yields(first: Vehicle, second: Vehicle) -> Vehicle | None:
    """Who gives way: nobody, where it would be up to a driver who does not."""
    loser = RegulatedRoad.respect_priorities(first, second)
    return loser if getattr(loser, "gives_way", True) else None


ENVIRONMENTS: dict[str, type[ScenarioEnv]] = {env.task.name: env for env in ScenarioEnv.__subclasses__()}
for _name, _env in ENVIRONMENTS.items():
    gym.register(f"highway-env/{_name}", entry_point=f"{__name__}:{_env.__name__}")
