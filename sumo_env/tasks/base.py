"""What a task is: a road, a spawn law, a reward and an end. Each task is one short file beside this one."""

import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

from sumo_env.config import MEASURED, Config, ConfigError, is_number, pace, plain
from sumo_env.networks.roads import LaneIndex, Road, is_shipped
from sumo_env.scene import OBSTACLE, Place, Scene
from sumo_env.streams import Random, stream
from sumo_env.traffic.drivers import (
    POOL,
    RISK_RANGES,
    SPREAD_PARAMETERS,
    STANDING,
    Calibration,
    CarFollowing,
    Driver,
    DriverPool,
    RiskRanges,
)
from sumo_env.traffic.measured import MeasuredPool
from sumo_env.traffic.risk import EventKind, RiskEvent, RiskRates, draw_events, draw_own_events
from sumo_env.traffic.scenario import Scenario, Spawn, VehicleSpec, car_id, lifetimes

Specs = list[VehicleSpec]
MOST_VARIED = 1000.0  # largest value that `Task.varied` takes
SHARES = ("not_giving_way", "ignores_approaching", "ignores_inside")  # at most 1
TARGET_SPEEDS = (20.0, 25.0, 30.0)  # MDPVehicle.DEFAULT_TARGET_SPEEDS [m/s]


class EgoState(NamedTuple):
    """The ego as rewards and endings see it, after a policy step.

    Attributes:
        lane: lane that the ego is on (the closest one, highway-env's distance).
        s, lateral: its coordinates on that lane [m].
        speed: [m/s]; heading: [rad].
        target_lane: lane that the ego steers for.
        speed_index: index of the target speed.
        speed_count: number of target speeds.
        action: the action of this step, None at a reset; a number or, if it has two axes, a tuple of numbers.
        crashed, on_road: after the step.
        scene: all vehicles, for rewards that depend on the traffic; the ego is row 0.
        acceleration: mean of this step [m/s2]; jerk: its change since the step before, over time [m/s3].
        before: the scene before this step, None at a reset.
        lanes_abreast: lanes of the road that the ego steers for.
        ended: how its way has ended, see `EgoStep`.
    """

    lane: LaneIndex
    s: float
    lateral: float
    speed: float
    heading: float
    target_lane: LaneIndex
    speed_index: int
    speed_count: int
    action: int | float | tuple[float, ...] | None
    crashed: bool
    on_road: bool
    scene: Scene
    acceleration: float = 0.0
    jerk: float = 0.0
    before: Scene | None = None
    lanes_abreast: int = 1
    ended: str = ""

    @property
    def place(self) -> Place:
        """Where SUMO says that it is, on a network of a user's own."""
        assert self.scene.place is not None
        return self.scene.place


class Task:
    """Base of all tasks, and of your own; highway-env's `AbstractEnv` split into its physics-free parts."""

    name: str
    defaults: Config
    ego_road: tuple[str, str]  # where the ego starts
    levels: ClassVar[dict[str, Config]] = {}  # traffic that is studied, the lightest first
    reference: ClassVar[str] = ""  # the class of highway_env.envs that has this road
    versions: ClassVar[tuple[int, ...]] = ()  # of that class, which the replica has
    car_following: ClassVar[CarFollowing] = CarFollowing()
    calibration: ClassVar[Calibration] = Calibration()
    warm_up: ClassVar[float] = 0.0  # [s] that the traffic drives before the ego is placed
    risk_ranges: ClassVar[RiskRanges] = RISK_RANGES
    risk_rates: ClassVar[RiskRates] = RiskRates()
    own_kinds: ClassVar[tuple[EventKind, ...]] = ()  # of events, beside those of `risk_rates`
    measured: ClassVar[MeasuredPool] = MeasuredPool()  # the drivers of config["drivers"] = "measured"
    fixed_delta: ClassVar[bool] = False  # IDM exponent 4 for all (no randomize_behavior in highway-env)
    target_speeds: tuple[float, ...] = TARGET_SPEEDS
    # where further learning cars start, each with the ego's speed and destination: lane, s [m]
    start_places: ClassVar[tuple[tuple[LaneIndex, float], ...]] = ()
    # whether highway-env looks at all learning cars, not at the first alone
    shares_reward: ClassVar[bool] = False
    of_files: ClassVar[bool] = False  # whether SUMO loads and drives a user's own files
    net = ""  # the network among them
    outputs: tuple[tuple[str, str], ...] = ()  # options and values of what those files would have SUMO write
    table: Config = {}  # what a Kinematics observation has where it is not said

    def __deepcopy__(self, memo: dict[int, object]) -> "Task":
        return self  # immutable

    def road(self, config: Config) -> Road:
        """The road of this task in highway-env's geometry."""
        raise NotImplementedError

    def frequency(self, config: Config) -> int:
        """Steps that are simulated per second [Hz]: ``simulation_frequency``, or its first multiple of at least 5.

        With longer steps, cars would pass through each other.
        """
        return int(config["simulation_frequency"]) * math.ceil(5 / config["simulation_frequency"])

    def ego(self, config: Config, road: Road, rng: Random) -> VehicleSpec:
        """The ego at the start."""
        raise NotImplementedError

    def vehicles(
        self, config: Config, road: Road, ego: VehicleSpec, rng: Random, drivers: "Drivers"
    ) -> Specs:
        """The other vehicles at the start."""
        raise NotImplementedError

    def with_cars(
        self, config: Config, road: Road, ego: VehicleSpec, vehicles: Specs, count: int, rng: Random
    ) -> Specs:
        """The other vehicles, with all but the first of `count` learning cars among them (`car_id`)."""
        if count > 1 + len(self.start_places):
            raise ConfigError(
                f"'controlled_vehicles' of {self.name!r} is at most {1 + len(self.start_places)}, not {count}: "
                "the task has no further places where learning cars start (start_places)"
            )
        cars = [
            make_on_lane(
                *(road, car_id(number), lane, s, ego.speed, ego.driver),
                destination=ego.destination,
                target_speed=ego.target_speed,
            )
            for number, (lane, s) in enumerate(self.start_places[: count - 1], 1)
        ]
        return [*vehicles, *cars]

    def spawns(self, config: Config, road: Road, seed: int, drivers: "Drivers") -> list[Spawn]:
        """Vehicles that are added later, or at the end of the warm-up (intersection only)."""
        return []

    def pools(self, dose: float) -> tuple[DriverPool, ...]:
        """Every driver that may occur in a scenario of this dose, the ego's included."""
        chosen = {(0.0, True), (dose, True), (dose, False)}
        return tuple(
            DriverPool(self.car_following, risk, fixed, self.risk_ranges) for risk, fixed in sorted(chosen)
        )

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        """The raw terms of the reward, by highway-env's names."""
        raise NotImplementedError

    def reward(self, rewards: dict[str, float], config: Config) -> float:
        """The scalar reward of a step: its weighted terms, normalized if asked for, and nothing off the road."""
        return self.normalized(weighted(rewards, config), config) * rewards.get("on_road_reward", 1.0)

    def reward_limits(self, config: Config) -> tuple[float, float] | None:
        """Rewards that ``normalize_reward`` maps to 0 and 1, which must differ; None where there is no such key."""
        return None

    def scale(self, config: Config) -> tuple[float, float] | None:
        """`reward_limits`, where ``normalize_reward`` asks for them."""
        is_asked = "normalize_reward" not in self.defaults or config["normalize_reward"]
        return self.reward_limits(config) if is_asked else None

    def normalized(self, reward: float, config: Config) -> float:
        """A reward mapped from `scale` to [0, 1]."""
        limits = self.scale(config)
        return lmap(reward, limits, (0.0, 1.0)) if limits else reward

    def arrived(self, ego: EgoState) -> bool:
        """Whether the ego has reached a goal, which ends the episode unless `terminated` says else; most have none."""
        return False

    def terminated(self, ego: EgoState, config: Config) -> bool:
        """Whether the episode is over, apart from its time."""
        ends_off_road = "offroad_terminal" in self.defaults and bool(config["offroad_terminal"])
        return ego.crashed or (ends_off_road and not ego.on_road) or self.arrived(ego)

    def events(
        self, config: Config, vehicles: Iterable[VehicleSpec], spawns: Iterable[Spawn], seed: int
    ) -> tuple[RiskEvent, ...]:
        """What risky drivers among these vehicles do."""
        policy_steps = pace(self.frequency(config), int(config["policy_frequency"]))
        drawn = config["risk"], lifetimes(vehicles, spawns, policy_steps), seed, config["duration"]
        events = (*draw_events(self.risk_rates, *drawn), *draw_own_events(self.own_kinds, *drawn))
        return tuple(sorted(events, key=lambda event: event.time))

    def imagined(self, scenario: Scenario, config: Config, now: float, seed: int) -> Scenario:
        """The scenario with the events that have begun `now` [s] after its start, and others from then on."""
        others = [spec for spec in scenario.vehicles if not (spec.id in scenario.further or spec.is_obstacle)]
        drawn = self.events({**config, "risk": scenario.risk}, others, scenario.spawns, seed)
        begun = [event for event in scenario.events if event.time <= now]
        events = (*begun, *(event for event in drawn if event.time > now))
        return replace(scenario, events=events, tilt=None)  # nobody expects them to come more often

    def varied(self, changes: Mapping[str, Mapping[str, Any]]) -> "Task":
        """This task with other values in its `risk_rates`, `risk_ranges` or `calibration`.

        >>> env.reset(seed=0, options={"risk_rates": {"cut_in": 0.2}})

        Raises:
            ConfigError: a name that there is not, a wrong value.
        """
        task = copy.copy(self)
        for part, values in changes.items():
            present = getattr(self, part)
            if not isinstance(values, Mapping) or values.keys() - present.__dataclass_fields__.keys():
                known = ", ".join(present.__dataclass_fields__)
                raise ConfigError(f"options[{part!r}] must map some of {known} to values, not {values!r}")
            checked = {
                key: _alike(f"options[{part!r}][{key!r}]", getattr(present, key), value, key)
                for key, value in values.items()
            }
            setattr(task, part, replace(present, **checked))
        return task

    def refuse_foreign(self, scenario: Any, config: Config) -> None:
        """A ConfigError about what is no scenario, or one of another task, on another road or with another clock."""
        if not isinstance(scenario, Scenario):
            raise ConfigError(f"options['scenario'] must be a Scenario, not {scenario!r}")
        policy, simulated = int(config["policy_frequency"]), int(config["simulation_frequency"])
        is_ours = (scenario.task, scenario.policy_frequency) == (self.name, policy)
        if not is_ours or scenario.simulation_frequency not in (simulated, self.frequency(config)):
            raise ConfigError(
                f"options['scenario'] must be of the task {self.name!r} at {simulated} and {policy} Hz, not of "
                f"{scenario.task!r} at {scenario.simulation_frequency} and {scenario.policy_frequency} Hz "
                "('simulation_frequency' and 'policy_frequency')"
            )
        if scenario.road != (road := self.road(config)):
            raise ConfigError(f"options['scenario'] must be on {road!r}, not on {scenario.road!r}")

    def scenario(self, config: Config, seed: int) -> Scenario:
        """Draw the scenario number `seed`: a pure function of its arguments."""
        road = self.road(config)
        rng = stream(seed, "scenario")
        drivers = Drivers(self, config, seed)
        ego = self.ego(config, road, rng)
        vehicles = self.vehicles(config, road, ego, rng, drivers)
        spawns = tuple(self.spawns(config, road, seed, drivers))
        events = tuple(sorted(self.events(config, vehicles, spawns, seed), key=lambda event: event.time))
        cars = cars_count(config)
        if cars > 1:
            vehicles = self.with_cars(config, road, ego, vehicles, cars, rng)
        vehicles = [*vehicles, *obstacles(road)]
        ids = [ego.id, *(spec.id for spec in vehicles), *(spawn.vehicle.id for spawn in spawns)]
        if len(set(ids)) < len(ids):
            twice = next(id for id in ids if ids.count(id) > 1)
            raise ConfigError(f"two vehicles of the task {self.name!r} are called {twice!r}")
        scenario = Scenario(
            task=self.name,
            seed=seed,
            risk=config["risk"],
            ego=ego,
            vehicles=tuple(vehicles),
            spawns=spawns,
            events=events,
            simulation_frequency=self.frequency(config),
            policy_frequency=int(config["policy_frequency"]),
            warm_up=self.warm_up,
            net=road.name if is_shipped(road) else road,
            road_arguments=road.arguments,
            pools=self.pools(config["risk"]),
            calibration=self.calibration,
            further=tuple(car_id(number) for number in range(1, cars)),
        )
        return self.measured.driving(scenario) if config.get("drivers") == MEASURED else scenario


class Drivers:
    """Draws the drivers of one scenario, in the order in which the vehicles are created."""

    def __init__(self, task: Task, config: Config, seed: int) -> None:
        self._rng = stream(seed, "drivers")
        self._fixed_delta = task.fixed_delta
        self._pool = {
            fixed: DriverPool(task.car_following, float(config["risk"]), fixed, task.risk_ranges).drivers
            for fixed in (True, False)
        }

    def next(self, fixed_delta: bool | None = None) -> Driver:
        """The driver of the next vehicle; `fixed_delta` overrides the task's own choice."""
        pool = self._pool[self._fixed_delta if fixed_delta is None else fixed_delta]
        return pool[self._rng.integers(POOL)]


def cars_count(config: Config) -> int:
    """Number of learning cars."""
    return int(config.get("controlled_vehicles", 1))


def ego_driver(task: Task) -> Driver:
    """The agent drives the ego; simulators need a driver for it all the same."""
    return DriverPool(task.car_following, 0.0, True).drivers[0]


def make_on_lane(
    road: Road,
    id: str,
    lane: LaneIndex,
    s: float,
    speed: float,
    driver: Driver,
    *,
    destination: str | None = None,
    target_speed: float | None = None,
    changes_lanes: bool = True,
    concerns_ego: bool = True,
) -> VehicleSpec:
    """A vehicle in the middle of a lane, aligned with it (highway-env's ``Vehicle.make_on_lane``)."""
    if lane not in road.lanes:
        raise ConfigError(f"{id!r} cannot be placed: the road {road.name!r} has no lane {lane!r}")
    geometry = road.lane(lane)
    x, y = geometry.position(s, 0.0)
    heading = geometry.heading_at(s)
    if not 0.0 <= s <= geometry.length:  # it is on another lane, as in highway-env
        lane = road.closest_lane(x, y, heading)
        s = road.lane(lane).local_coordinates(x, y)[0]
    wanted = speed if target_speed is None else target_speed
    timer = ((x + y) * math.pi) % 1.0  # IDMVehicle.timer: spreads MOBIL's decisions over time
    pose = lane, s, x, y, heading
    return VehicleSpec(id, *pose, speed, wanted, destination, driver, changes_lanes, timer, concerns_ego)


def obstacles(road: Road) -> list[VehicleSpec]:
    """The obstacles of a road, as vehicles that stand."""
    found = []
    for number, (x, y) in enumerate(road.obstacles):
        lane = road.closest_lane(x, y, 0.0)
        s, _ = road.lane(lane).local_coordinates(x, y)
        pose = lane, s, x, y, 0.0
        found.append(VehicleSpec(f"{OBSTACLE}{number}", *pose, 0.0, 0.0, None, STANDING, changes_lanes=False))
    return found


# The replica compiles the first two functions and `speed_term`: plain floats and sequences only.


def nearest_index(speed: float, speeds: Sequence[float]) -> int:
    """Index of the evenly spaced target speed nearest to a speed [m/s] (``MDPVehicle.speed_to_index``)."""
    last = len(speeds) - 1
    if last == 0:
        return 0
    position = (speed - speeds[0]) / (speeds[last] - speeds[0])
    return min(max(round(position * last), 0), last)


def lmap(value: float, source: tuple[float, float] | list[float], target: tuple[float, float]) -> float:
    """Linear map of an interval onto another (``highway_env.utils.lmap``)."""
    return target[0] + (value - source[0]) * (target[1] - target[0]) / (source[1] - source[0])


def weighted(rewards: dict[str, float], config: Config) -> float:
    """Sum of the terms times their weights in the config; a term without a weight has no effect."""
    total = 0.0
    for name, value in rewards.items():  # from Python 3.12 on `sum` rounds otherwise
        total += config.get(name, 0) * value
    return total


def speed_term(speed: float, limits: tuple[float, float] | list[float]) -> float:
    """Speed mapped from these limits, ``reward_speed_range`` [m/s], to [0, 1] and clipped."""
    return min(max(lmap(speed, limits, (0.0, 1.0)), 0.0), 1.0)


def _alike(name: str, present: Any, value: Any, key: str) -> Any:
    """A value of the kind of the present one: True or False, a number, or a range of two numbers.

    Raises:
        ConfigError: another one, or numbers beyond what there can be of this key.
    """
    value = plain(value)
    if isinstance(present, bool):
        if not isinstance(value, bool):
            raise ConfigError(f"{name} must be True or False, not {value!r}")
        return value
    is_range, positive = isinstance(present, tuple), key in SPREAD_PARAMETERS
    most = 1.0 if key in SHARES else MOST_VARIED
    many = value if is_range and isinstance(value, list) else [value]
    numbers = [float(one) for one in many if is_number(one) and 0.0 <= one <= most and (one or not positive)]
    if len(numbers) < len(many) or len(numbers) != 1 + is_range or numbers != sorted(numbers):
        what, least = "two rising numbers" if is_range else "a number", "(0" if positive else "[0"
        raise ConfigError(f"{name} must be {what} in {least}, {most:g}], not {value!r}")
    return tuple(numbers) if is_range else numbers[0]
