"""Lane changes of the highway's traffic, held against MOBIL's two criteria (Kesting et al. 2007; ``IDMVehicle.mobil``).

A change is *safe* if the follower on the new lane would not have to brake harder than the driver's limit (2 m/s2),
and *worth it* if the driver gains at least its threshold (0.2 m/s2; politeness is 0). All accelerations are
highway-env's IDM with the deciding driver's parameters. A change begins in the last sample in which the vehicle is
still in the middle of its lane, and is valid if it was safe and worth it at a moment of the 0.3 s before.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from experiments.study.seeds import scenario_seed
from experiments.validation.episodes import LANE_WIDTH
from experiments.validation.parts import SLOWNESS, Engine, open_env
from sumo_env.scene import PERCEPTION_DISTANCE, VEHICLE_LENGTH, Scene
from sumo_env.traffic.scenario import VehicleSpec

TASK, LANES, LIMIT = "highway", 4, 30.0  # [m/s]
CENTRED = 0.06  # [m] from the middle of the lane
LOOK_BACK = 0.3  # [s] from the decision until the vehicle has visibly left the middle of the lane
MARGIN = 1.0  # [m] beyond the border of a lane, within which a vehicle counts as being on it
SECONDS = 12


@dataclass(frozen=True)
class Changes:
    """The lane changes of some scenarios of a level of the highway, to be counted in a process (`parts.Work`)."""

    engine: Engine
    level: int
    scenarios: int
    task: str = TASK

    @property
    def file(self) -> str:
        """Path within the folder of all parts."""
        return f"{self.engine.folder(TASK)}/changes-{self.level}-{self.scenarios}.json"

    @property
    def cost(self) -> float:
        """Rough time, in the unit of `parts.Part`."""
        return 40.0 * (1 + self.level) * self.scenarios * SLOWNESS.get(self.engine.backend, 1.0)

    def compute(self) -> bytes:
        """The counts of each scenario as JSON."""
        return json.dumps([count_changes(self.engine, self.level, k) for k in range(self.scenarios)]).encode()


def count_changes(engine: Engine, level: int, scenario: int) -> dict[str, float]:
    """Changes of the traffic near an ego that keeps to the left lane, in one scenario.

    Returns:
        changes; of them valid, safe and worth (it); and vehicle_minutes in which they were made.
    """
    env = open_env(engine, TASK, level)
    frequency = env.unwrapped.config["simulation_frequency"]
    env.close()
    config = {**engine.config, "policy_frequency": frequency, "initial_lane_id": 0, "duration": SECONDS}
    env = open_env(replace(engine, config=config), TASK, level)
    inner: Any = env.unwrapped
    try:
        env.reset(seed=scenario_seed(TASK, level, scenario))
        frames = [inner.scene]
        numbers = {name: number for number, name in inner.actions.items()}
        ended = False
        while not ended:  # slower than its start, so that it stays in the traffic for a while
            _, _, terminated, truncated, _ = env.step(numbers["SLOWER" if len(frames) == 1 else "IDLE"])
            frames.append(inner.scene)
            ended = terminated or truncated
        specs = {spec.id: spec for spec in inner.scenario.specs}
    finally:
        env.close()
    return judge(frames, specs, frequency)


def judge(frames: Sequence[Scene], specs: dict[str, VehicleSpec], frequency: float) -> dict[str, float]:
    """Count the changes in the scenes of an episode, sampled at `frequency` [Hz]."""
    tally = {"changes": 0.0, "valid": 0.0, "safe": 0.0, "worth": 0.0, "vehicle_minutes": 0.0}
    back = round(LOOK_BACK * frequency)
    centred: dict[str, tuple[int, int]] = {}  # vehicle -> last frame in the middle of a lane, and that lane
    for number, frame in enumerate(frames):
        near = np.abs(frame.x - frame.x[0]) <= PERCEPTION_DISTANCE
        lanes = np.clip(np.round(frame.y / LANE_WIDTH), 0, LANES - 1).astype(int)
        tally["vehicle_minutes"] += float(near[1:].sum()) / frequency / 60.0
        for row in range(1, len(frame)):
            name, lane = frame.ids[row], int(lanes[row])
            if frame.crashed[row]:
                centred.pop(name, None)
                continue
            begin, before = centred.get(name, (-1, lane))
            if (
                lane != before
            ):  # who turns back, or goes on to a third lane, was not in the middle of this one
                del centred[name]
                if near[row]:
                    moments = [m for m in frames[max(begin - back, 0) : begin + 1] if name in m.ids]
                    verdicts = [criteria(moment, name, lane, specs) for moment in moments]
                    tally["changes"] += 1
                    tally["valid"] += any(safe and worth for safe, worth in verdicts)
                    tally["safe"] += any(safe for safe, _ in verdicts)
                    tally["worth"] += any(worth for _, worth in verdicts)
            if abs(frame.y[row] - LANE_WIDTH * lane) <= CENTRED:
                centred[name] = (number, lane)
    return tally


def criteria(scene: Scene, name: str, lane: int, specs: dict[str, VehicleSpec]) -> tuple[bool, bool]:
    """Whether a change of a vehicle to `lane` is safe, and whether it is worth it."""
    row = scene.ids.index(name)
    driver = specs[name].driver
    old = round(scene.y.item(row) / LANE_WIDTH)
    preceding, following = neighbours(scene, row, lane)
    imposed = _acceleration(scene, specs, following, row, row) if following is not None else 0.0
    after = _acceleration(scene, specs, row, preceding, row)
    before = _acceleration(scene, specs, row, neighbours(scene, row, old)[0], row)
    return imposed >= -driver.safe_braking, after - before >= driver.min_gain


def neighbours(scene: Scene, row: int, lane: int) -> tuple[int | None, int | None]:
    """The next vehicle ahead and behind on a lane (``Road.neighbour_vehicles`` of a straight road)."""
    there = np.abs(scene.y - LANE_WIDTH * lane) <= LANE_WIDTH / 2 + MARGIN
    there[row] = False
    ahead = np.where(there & (scene.x >= scene.x[row]), scene.x, math.inf)
    behind = np.where(there & (scene.x < scene.x[row]), scene.x, -math.inf)
    front, rear = int(ahead.argmin()), int(behind.argmax())
    return (front if ahead[front] < math.inf else None), (rear if behind[rear] > -math.inf else None)


def _acceleration(
    scene: Scene, specs: dict[str, VehicleSpec], row: int, leader: int | None, decides: int
) -> float:
    """IDM acceleration [m/s2] of vehicle `row` behind `leader`, with the parameters of the driver that decides."""
    driver = specs[scene.ids[decides]].driver
    speed = scene.speed.item(row)
    target = min(max(specs[scene.ids[row]].target_speed, 0.0), LIMIT)
    acceleration = driver.accel * (1.0 - (max(speed, 0.0) / max(target, 1e-2)) ** driver.delta)
    if leader is None:
        return acceleration
    approach = speed - scene.speed.item(leader) * math.cos(
        scene.heading.item(leader) - scene.heading.item(row)
    )
    wanted = driver.min_gap + VEHICLE_LENGTH + speed * driver.tau
    wanted += speed * approach / (2.0 * math.sqrt(driver.accel * driver.decel))
    distance = scene.x.item(leader) - scene.x.item(row)
    return acceleration - driver.accel * (wanted / max(distance, 1e-2)) ** 2


def shares(counts: Sequence[dict[str, float]]) -> dict[str, float | None]:
    """The counts of several scenarios as shares of the changes, and their rate per vehicle-minute."""
    total = {name: sum(count[name] for count in counts) for name in counts[0]}
    changes = total["changes"]
    return {
        "changes": changes,
        **{name: total[name] / changes if changes else None for name in ("valid", "safe", "worth")},
        "rate": changes / total["vehicle_minutes"] if total["vehicle_minutes"] else None,
    }
