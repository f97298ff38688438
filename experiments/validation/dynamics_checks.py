"""From the motions of the deterministic scenes to checks."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from experiments.validation.compare import Difference
from experiments.validation.dynamics import common
from experiments.validation.margins import DYNAMICS
from experiments.validation.scorecard import Check, check
from experiments.validation.stage import Motion

Numbers = dict[str, tuple[float, float, float, str]]  # metric -> (SUMO, highway-env, difference, unit)


def following(sumo: Motion, reference: Motion) -> Numbers:
    """Followers behind the ego: root mean square of the differences of speed and of distance to the leader."""
    times = common(sumo, reference)
    speeds, gaps, rest = [], [], []
    means: list[list[float]] = [[], []]
    for vehicle in range(1, sumo.x.shape[1]):
        v = [m.at(times, "speed", vehicle) for m in (sumo, reference)]
        d = [_distance(m, times, vehicle) for m in (sumo, reference)]
        speeds.append(v[0] - v[1])
        gaps.append(d[0] - d[1])
        rest.append((d[0][-1], d[1][-1]))
        for side in (0, 1):
            means[side] += [float(v[side].mean()), float(d[side].mean())]
    mean = [(float(np.mean(side[0::2])), float(np.mean(side[1::2]))) for side in means]
    numbers: Numbers = {
        "follow_speed": (mean[0][0], mean[1][0], _rms(speeds), "m/s"),
        "follow_gap": (mean[0][1], mean[1][1], _rms(gaps), "m"),
    }
    if reference.speed[-1].max() < 0.3:
        own, other = (float(np.mean([pair[side] for pair in rest])) for side in (0, 1))
        numbers["stop_gap"] = (own, other, own - other, "m")
    return numbers


def _distance(motion: Motion, times: NDArray[np.float64], vehicle: int) -> NDArray[np.float64]:
    return np.hypot(
        motion.at(times, "x", vehicle) - motion.at(times, "x", vehicle - 1),
        motion.at(times, "y", vehicle) - motion.at(times, "y", vehicle - 1),
    )


def _rms(differences: list[NDArray[np.float64]]) -> float:
    return float(np.sqrt(np.mean(np.square(np.concatenate(differences)))))


def ladder(sumo: Motion, reference: Motion) -> Numbers:
    """The ego's speed 1, 2 and 3 s after FASTER or SLOWER; the largest difference decides."""
    times = np.array([1.0, 2.0, 3.0])
    own, other = sumo.at(times, "speed"), reference.at(times, "speed")
    worst = int(np.argmax(np.abs(own - other)))
    return {"ladder_speed": (float(own[worst]), float(other[worst]), float((own - other)[worst]), "m/s")}


def lane_change(sumo: Motion, reference: Motion) -> Numbers:
    """When the ego's centre crosses the line, how far it has moved after 1 s, when it is within 0.1 m."""
    values = [
        (crossing(m, 2.0), float(np.abs(m.at(np.array([1.0]), "y") - m.y[0, 0])[0]), crossing(m, 3.9))
        for m in (sumo, reference)
    ]
    units = {"flip_time": "s", "moved_after_1s": "m", "settled_time": "s"}
    return {
        name: (values[0][k], values[1][k], values[0][k] - values[1][k], unit)
        for k, (name, unit) in enumerate(units.items())
    }


def crossing(motion: Motion, moved: float) -> float:
    """Time at which the ego has moved so far to the side for the first time [s]; inf if it never has."""
    lateral = np.abs(motion.y[:, 0] - motion.y[0, 0])
    after = np.flatnonzero(lateral >= moved)
    if not len(after):
        return float("inf")
    k = int(after[0])
    return float(np.interp(moved, lateral[k - 1 : k + 1], motion.time[k - 1 : k + 1])) if k else 0.0


def turn(sumo: Motion, reference: Motion) -> Numbers:
    """The ego alone through a bend: its least speed, and how far apart the two egos are on average."""
    times = common(sumo, reference)
    apart = np.hypot(*(sumo.at(times, name) - reference.at(times, name) for name in ("x", "y")))
    lowest = float(sumo.speed[:, 0].min()), float(reference.speed[:, 0].min())
    return {
        "turn_speed": (*lowest, lowest[0] - lowest[1], "m/s"),
        "turn_position": (0.0, 0.0, float(apart.mean()), "m"),
    }


def bend(sumo: Motion, reference: Motion) -> Numbers:
    """Ground covered by the other vehicle [m]."""
    end = min(sumo.time[-1], reference.time[-1])
    own, other = (_way(m, 1, end) for m in (sumo, reference))
    return {"bend_progress": (own, other, own - other, "m")}


def _way(motion: Motion, vehicle: int, end: float) -> float:
    times = motion.time[motion.time <= end + 1e-9]
    return float(np.hypot(*(np.diff(motion.at(times, name, vehicle)) for name in ("x", "y"))).sum())


MEASURES: Mapping[str, Callable[[Motion, Motion], Numbers]] = {
    "following": following,
    "ladder": ladder,
    "lane change": lane_change,
    "turn": turn,
    "bend": bend,
}


def checks(
    sumo: Mapping[str, Motion],
    reference: Mapping[str, Motion],
    coarse: Mapping[str, Motion],
    placement: Mapping[str, float],
) -> list[Check]:
    """The checks of one task.

    Args:
        sumo, reference, coarse: motions by name of the scene, of SUMO, of highway-env at 15 Hz and at 10 Hz.
        placement: largest error of placing a vehicle on each lane [m].
    """
    found = []
    for name, motion in sumo.items():
        kind = name.split(" | ")[0]
        noise = MEASURES[kind](coarse[name], reference[name]) if name in coarse else {}
        for metric, (own, other, difference, unit) in MEASURES[kind](motion, reference[name]).items():
            margin = DYNAMICS[metric]
            found.append(
                check(
                    f"{kind}: {name.split(' | ')[2]}",
                    metric,
                    Difference(own, other, difference, difference, difference, 1),
                    level="few vehicles",
                    unit=unit,
                    margin=margin,
                    bound=margin.value * abs(other) if margin.relative else margin.value,
                    noise=noise[metric][2] if metric in noise else None,
                )
            )
    worst = max(placement.values())
    found.append(
        check(f"placing on each of {len(placement)} lanes, the worst", "placement",
              Difference(worst, 0.0, worst, worst, worst, len(placement)),
              level="few vehicles", unit="m", margin=DYNAMICS["placement"])
    )  # fmt: skip
    return found
