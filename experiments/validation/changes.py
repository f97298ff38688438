"""Lane-change decisions on the highway, held against MOBIL's two criteria by one ruler for every driver.

A change begins in the last sample in which the vehicle is still in the middle of its lane; it is *valid* if it
was safe and worth it (`sumo_env.models.mobil.criteria`) at a moment of the 0.3 s before. A *chance* is a change
that stays safe and worth it for the 1.1 s in which MOBIL decides at least once, or until it begins; that one is
*made*.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.study.grid import level_names
from experiments.study.seeds import scenario_seed
from experiments.validation.stage import FREQUENCY, open_env
from sumo_env.models.idm import driver_row
from sumo_env.models.mobil import MIN_GAIN, SAFE_BRAKING, closest_lanes, criteria
from sumo_env.scenario import Scenario
from sumo_env.scene import PERCEPTION_DISTANCE, Scene
from sumo_env.tasks import TASKS

LANES, WIDTH = 4, 4.0
CENTRED = 0.06  # [m] from the middle of the lane
LOOK_BACK = 0.3  # [s] from the decision until the vehicle has visibly left the middle of the lane
REACTION = 1.1  # [s] MOBIL decides at least once in it
SECONDS = 12.0


def count(backend: str, level: int, scenario: int, **config: Any) -> dict[str, float]:
    """Changes and chances of the traffic near an ego that idles in the left lane, in one scenario.

    Returns counts: changes, valid (of them, by both criteria), unsafe, idle (without incentive), chances,
    made (of them), vehicle_minutes.
    """
    frequency = config.pop("simulation_frequency", FREQUENCY[backend])
    setting = TASKS["highway"].levels[level_names("highway")[level - 1]]
    env = open_env(
        backend,
        "highway",
        {
            **setting,
            **config,
            "simulation_frequency": frequency,
            "policy_frequency": frequency,
            "initial_lane_id": 0,
        },
    )
    inner: Any = env.unwrapped
    env.reset(seed=scenario_seed("highway", level, scenario))
    frames = [inner.scene]
    numbers = {name: number for number, name in inner.actions.items()}
    for step in range(round(SECONDS * frequency)):
        _, _, terminated, _, _ = inner.step(numbers["SLOWER" if step == 0 else "IDLE"])
        frames.append(inner.scene)
        if terminated:
            break
    drawn = inner.scenario
    env.close()
    return judge(frames, drawn, frequency)


def judge(frames: Sequence[Scene], scenario: Scenario, frequency: float) -> dict[str, float]:
    """Count changes and chances in the scenes of an episode, sampled at `frequency` [Hz]."""
    names = [name for name in frames[0].ids if all(name in frame.ids for frame in frames)]
    specs = {spec.id: spec for spec in scenario.specs}
    drivers = np.array([driver_row(specs[name].driver) for name in names])
    target = np.array([specs[name].target_speed for name in names])
    rows = [np.array([frame.ids.index(name) for name in names]) for frame in frames]
    x, y, speed, heading = (
        np.array([getattr(frame, field)[row] for frame, row in zip(frames, rows, strict=True)])
        for field in ("x", "y", "speed", "heading")
    )
    wrecks = np.array([frame.crashed[row] for frame, row in zip(frames, rows, strict=True)])
    crashed: NDArray[np.bool_] = np.logical_or.reduce(wrecks, axis=0)
    lane = np.array([closest_lanes(row, LANES, WIDTH) for row in y])
    centred = np.abs(y - WIDTH * lane) <= CENTRED
    tally = dict.fromkeys(("changes", "valid", "unsafe", "idle", "chances", "made"), 0)
    near: NDArray[np.bool_] = np.asarray(np.abs(x - x[:, :1]) <= PERCEPTION_DISTANCE)

    def verdict(t: int, i: int, to: int) -> tuple[bool, bool]:
        imposed, gain = criteria(
            i, to, x[t], y[t], speed[t], heading[t], lane[t], target, drivers, WIDTH, 10_000.0, 30.0
        )
        return bool(imposed >= -SAFE_BRAKING), bool(gain >= MIN_GAIN)

    back, window = round(LOOK_BACK * frequency), round(REACTION * frequency)
    for i in range(1, len(names)):
        if crashed[i]:
            continue
        starts = beginnings(lane[:, i], centred[:, i])
        for t, to in starts.items():
            if near[t, i]:
                verdicts = [verdict(k, i, to) for k in range(max(t - back, 0), t + 1)]
                tally["changes"] += 1
                tally["valid"] += any(safe and worth for safe, worth in verdicts)
                tally["unsafe"] += not any(safe for safe, _ in verdicts)
                tally["idle"] += not any(worth for _, worth in verdicts)
        t = 0
        while t + window < len(frames):
            if not (near[t, i] and centred[t, i]):
                t += 1
                continue
            begin = next((k for k in range(t, t + window) if k in starts), None)
            last = t + window if begin is None else max(begin - back, t)
            good = [
                to
                for to in (int(lane[t, i]) - 1, int(lane[t, i]) + 1)
                if 0 <= to < LANES and all(all(verdict(k, i, to)) for k in range(t, last + 1))
            ]
            tally["chances"] += bool(good)
            tally["made"] += bool(good) and begin is not None and starts[begin] in good
            t += window if begin is None else begin - t + window
    return {**tally, "vehicle_minutes": float(near[:, 1:].sum()) / frequency / 60.0}


def beginnings(lane: NDArray[np.int64], centred: NDArray[np.bool_]) -> dict[int, int]:
    """Sample in which each change of a vehicle begins -> the new lane; arrays of shape (samples,)."""
    starts: dict[int, int] = {}
    for flip in np.flatnonzero(np.diff(lane)) + 1:
        before = np.flatnonzero(centred[:flip] & (lane[:flip] == lane[flip - 1]))
        if len(before):
            starts[int(before[-1])] = int(lane[flip])
    return starts


def shares(counts: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The counts of several scenarios as shares and a rate [changes per vehicle-minute]."""
    total = {name: sum(count[name] for count in counts) for name in counts[0]}
    changes, chances = max(total["changes"], 1), max(total["chances"], 1)
    return {
        "changes": total["changes"],
        "changes_valid": total["valid"] / changes,
        "changes_safe": 1 - total["unsafe"] / changes,
        "valid_made": total["made"] / chances,
        "change_rate": total["changes"] / max(total["vehicle_minutes"], 1e-9),
    }
