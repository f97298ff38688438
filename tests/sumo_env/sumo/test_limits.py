"""What vehicles do in random episodes with many events is possible: they brake, accelerate and move sideways so far.

Whoever takes a vehicle's speed or lanes from SUMO gives them back: nothing commanded is left on other vehicles.
"""

import re
from collections.abc import Callable
from contextlib import closing
from functools import cache
from math import cos, dist, inf, sin
from pathlib import Path
from typing import Any, NamedTuple

import libsumo
import numpy as np
import pytest

import sumo_env
from sumo_env.contacts.measures import HORIZON, TTC_RADIUS, ego_ttc
from sumo_env.contacts.rectangles import state_of
from sumo_env.env import DrivingEnv
from sumo_env.networks.meeting import edge_of
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scenarios.risky import RISKY_CLASSES, deviation
from sumo_env.scenarios.simulator import FileSimulator
from sumo_env.scene import Scene
from sumo_env.sumo.session import ALL_CHECKS_OFF, COMMANDED_LANE_CHANGES, NO_RULES
from sumo_env.sumo.vehicle import MOVING, OF_SUMO, modes
from sumo_env.tasks import TASKS
from sumo_env.traffic.risk import RiskEvent
from sumo_env.traffic.scenario import Scenario
from tests.sumo_env.plans import needs_sumo
from tests.sumo_env.rollout import drive
from tests.sumo_env.scenarios import files
from tests.tasks import every_task

HZ = 10  # of policy steps too, so that every sub-step is looked at
ENOUGH = pytest.param(range(2, 40), marks=pytest.mark.long)
OFTEN = {"risk_rates": {"cut_in": 0.2, "brake": 0.2, "surge": 0.1}}
TAKES = 0.8  # [s] that a lane change takes
ROUNDING, RESIDUE = 1e-3, 0.01  # [m/s2]; [m] with which SUMO may end a lane change
PERCEIVED = (
    0.5  # [m/s2] SUMO's EIDM misjudges what it sees: without events, too, it accelerates 0.4 beyond its limit
)
FURTHER = 1e-6  # [m/s] that a speed may differ from SUMO's own
WRECKED = ALL_CHECKS_OFF, COMMANDED_LANE_CHANGES


class Seen(NamedTuple):
    """A vehicle after a sub-step; lateral: beside the middle of its lane [m]."""

    lane: str
    lateral: float
    speed: float
    event: RiskEvent | None


def look(env: Any) -> dict[str, Seen]:
    """The vehicles that have not crashed."""
    of, scene, events = libsumo.vehicle, env.scene, env._car.episode.simulator._events
    there = {name for name in of.getIDList() if of.getLaneID(name)}
    rows = {name: row for row, name in enumerate(scene.ids) if name in there and not scene.crashed[row]}
    acts = {name: one.event for name, one in events._running.items() if one.acts}
    return {
        name: Seen(
            *(of.getLaneID(name), of.getLateralLanePosition(name)), float(scene.speed[row]), acts.get(name)
        )
        for name, row in rows.items()
    }


def aside(before: Seen, after: Seen) -> float:
    """How far a vehicle has moved sideways [m]; SUMO counts from the lane on which its middle is."""
    moved = after.lateral - before.lateral
    width = libsumo.lane.getWidth(after.lane)
    lanes = (0,) if before.lane == after.lane else (-1, 0, 1)
    return min(abs(moved + width * number) for number in lanes)


def own_modes(scenario: Scenario) -> Callable[[str], tuple[int, int]]:
    """The speed mode and the lane-change mode in which SUMO drives a vehicle, by its name."""
    specs = {spec.id: spec for spec in scenario.everybody}

    @cache
    def of(name: str) -> tuple[int, int]:
        if (traffic := scenario.traffic) is None:
            return WRECKED if specs[name].is_obstacle else modes(specs[name], scenario.calibration)
        model = dict(traffic.models).get(libsumo.vehicle.getTypeID(name).partition("@")[0], "")
        factors = deviation(traffic.ranges, scenario.risk, scenario.seed, name, model)
        obeys = factors["gives_way"] or libsumo.vehicle.getVehicleClass(name) not in RISKY_CLASSES
        return OF_SUMO if obeys else (NO_RULES, OF_SUMO[1])

    return of


def left_commanded(env: Any, own: Callable[[str], tuple[int, int]]) -> list[str]:
    """Vehicles that are commanded, though no event does it, and crashed ones that are not.

    SUMO's EIDM that gets its speed back within limits (`events.SETTLING`) brakes less than it would by itself.
    """
    scene, returning, of, found = (
        env.scene,
        env._car.episode.simulator._events._returning,
        libsumo.vehicle,
        [],
    )
    for row, name in enumerate(scene.ids):
        if row < scene.cars or name in scene.in_event or not of.getLaneID(name):
            continue
        wanted = WRECKED if scene.crashed[row] else own(name)
        if (now := (of.getSpeedMode(name), of.getLaneChangeMode(name))) != wanted:
            found.append(f"{scene.time} s, {name}: modes {now}, not {wanted}")
        # SUMO itself stops a vehicle at once at a red light that a surge has brought it to; modes tell then
        speed, by_itself = of.getSpeed(name), of.getSpeedWithoutTraCI(name)
        is_free = not (scene.crashed[row] or speed == 0.0 or name in returning)
        if is_free and abs(speed - by_itself) > FURTHER:
            found.append(f"{scene.time} s, {name}: {speed} m/s, by itself {by_itself}")
    return found


def least_ttc(scene: Scene) -> float:
    """Time to collision by the speeds of the scene [s]."""
    states = [state_of(scene, row) for row in range(len(scene))]
    halves = [(length / 2.0, width / 2.0) for length, width in map(scene.size, scene.ids)]
    fronts = [
        (x + half * cos(h), y + half * sin(h)) for (x, y, _, h), (half, _) in zip(states, halves, strict=True)
    ]
    near = [row for row in range(1, len(scene)) if dist(fronts[0], fronts[row]) <= TTC_RADIUS]
    return min(
        (ego_ttc(states[0], (states[row],), HORIZON, halves[row], halves[0]) for row in near), default=inf
    )


class Watch:
    """Drives episodes of random actions, and looks for what no vehicle can have done.

    Attributes:
        faults: of vehicles that events command, or the agent, and movements sideways of all; commands that are left.
        excess: of all others, what is beyond the limits of their types: braking and acceleration [m/s2].
    """

    def __init__(self, takes: float, egos_have_limits: bool) -> None:
        """takes: that a lane change takes [s]."""
        self.takes, self.egos_have_limits = takes, egos_have_limits
        self.faults: list[str] = []
        self.excess = np.zeros(2)

    def drive(self, env: Any) -> None:
        """One episode, which has begun."""
        rng, before, action, over = np.random.default_rng(env.scenario.seed), look(env), 0, False
        own = own_modes(env.scenario)
        while not over:
            if env.scene.time % 1.0 < 0.05:
                action = int(rng.integers(env.action_space.n))
            *_, crashed, late, info = env.step(action)
            over, after = crashed or late, look(env)
            self.faults += left_commanded(env, own) if env.scenario.risk else []
            if not info["crashed"] and info["min_ttc"] != pytest.approx(least_ttc(env.scene), abs=1e-6):
                self.faults.append(f"{env.scene.time} s: time to collision {info['min_ttc']}")
            acting = {env.ego_id, *env._car.episode.simulator._events._changes}
            for name in before.keys() & after.keys():
                where = f"{env.scene.time} s, {name}: {before[name]} {after[name]}"
                self._lengthwise(name, before[name], after[name], env.ego_id, where)
                self._sideways(before[name], after[name], name in acting, where)
            before = after

    def _lengthwise(self, name: str, one: Seen, other: Seen, ego: str, where: str) -> None:
        of, accel = libsumo.vehicle, (other.speed - one.speed) * HZ
        beyond = -accel - max(of.getEmergencyDecel(name), of.getDecel(name)), accel - of.getAccel(name)
        if other.event is not None:
            events = -accel + other.event.accel, accel - other.event.accel
            if np.minimum(beyond, events).max() > ROUNDING:
                self.faults.append(f"{where} {accel} m/s2")
        elif name == ego:
            if self.egos_have_limits and max(beyond) > ROUNDING:
                self.faults.append(f"{where} {accel} m/s2")
        else:
            errors = PERCEIVED if of.getTypeID(name).startswith("eidm") else 0.0
            self.excess = np.maximum(self.excess, np.array(beyond) - errors)

    def _sideways(self, one: Seen, other: Seen, is_commanded: bool, where: str) -> None:
        moved = aside(one, other)
        if self.takes and moved > libsumo.lane.getWidth(other.lane) / self.takes / HZ + RESIDUE:
            self.faults.append(f"{where} {moved} m sideways")
        begins = abs(one.lateral) < ROUNDING < moved and edge_of(one.lane) == edge_of(other.lane)
        if begins and is_commanded and one.speed < MOVING:
            self.faults.append(f"{where} changes lanes where it stands")


def check(watches: list[Watch]) -> None:
    """Among risky drivers, who is not commanded is within what SUMO shows without risk."""
    regular, risky = watches
    assert regular.faults == risky.faults == []
    assert (risky.excess <= regular.excess + ROUNDING).all()


def test_one_module_commands_vehicles() -> None:
    """The session sets the first modes of what it adds."""
    setters, package = re.compile(r"set(SpeedMode|LaneChangeMode|Speed)\("), Path(sumo_env.__file__).parent
    found = {file.name for file in package.rglob("*.py") if setters.search(file.read_text(encoding="utf-8"))}
    assert found == {"vehicle.py", "session.py"}


def test_who_stands_changes_no_lane_but_goes_on_wanting_to() -> None:
    action = {"type": "DiscreteMetaAction", "target_speeds": [0, 10, 20]}
    with closing(DrivingEnv("highway", {"vehicles_count": 0, "initial_lane_id": 1, "action": action})) as env:
        env.reset(seed=0)
        left, _, right, faster, slower = range(5)
        list(drive(env, [slower] * 8))
        assert left in env.get_available_actions() and env.scene.speed[0] < 0.1
        list(drive(env, [left] * 3))
        assert env.scene.y[0] == 4.0 and env.ego_state.target_lane[2] == 0
        assert left not in env.get_available_actions() and right in env.get_available_actions()
        list(drive(env, [faster] * 3))
        assert env.scene.y[0] == pytest.approx(0.0, abs=0.1)


@every_task
@pytest.mark.parametrize("seeds", [range(2), ENOUGH])
def test_in_a_task(simulator: Any, task: str, seeds: range) -> None:
    """The ego drives as in highway-env, whose accelerations have no limits."""
    watches = [Watch(TAKES, egos_have_limits=False) for _ in range(2)]
    for level in TASKS[task].levels.values():
        for risk, watch in enumerate(watches):
            config = {**level, "simulation_frequency": HZ, "policy_frequency": HZ, "risk": float(risk)}
            with closing(DrivingEnv(task, config, simulator=simulator)) as env:
                for seed in seeds:
                    env.reset(seed=seed, options=OFTEN if risk else None)
                    watch.drive(env)
    check(watches)


@needs_sumo
@pytest.mark.parametrize("name", files.SCENARIOS)
@pytest.mark.parametrize("takes", [0.0, TAKES])
@pytest.mark.parametrize("seeds", [range(2), ENOUGH])
def test_on_a_network_of_one_s_own(tmp_path: Path, name: str, takes: float, seeds: range) -> None:
    net, watches = files.written(tmp_path, name), [Watch(takes, egos_have_limits=True) for _ in range(2)]
    for risk, watch in enumerate(watches):
        config = {"policy_frequency": HZ, "duration": 60, "risk": float(risk)}
        simulator = FileSimulator({"lanechange.duration": f"{takes:g}"})
        with closing(SumoDrivingEnv(net, ego_vehicle="ego", config=config, simulator=simulator)) as env:
            for seed in seeds:
                env.reset(seed=seed, options=OFTEN if risk else None)
                watch.drive(env)
    check(watches)
