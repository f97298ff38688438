"""How long cells will take: from the stored cells of this kind of machine, else from rates stated here."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Mapping
from contextlib import suppress
from statistics import median
from typing import Any

from experiments.study.grid import Cell
from experiments.support.provenance import cpu

Place = tuple[str, str, int]  # backend, task, level

# Processor seconds of a common server for (a training step, a test episode) in the lightest traffic;
# rough but for SUMO.
DEFAULT_RATES: dict[str, dict[str, tuple[float, float]]] = {
    "sumo": {
        "highway": (0.0025, 0.050),
        "two-way": (0.0010, 0.010),
        "roundabout": (0.0016, 0.017),
        "intersection": (0.0020, 0.017),
        "u-turn": (0.0011, 0.010),
    },
    "replica": {"highway": (0.0008, 0.015)},
    "highway-env": {
        "highway": (0.400, 6.000),
        "two-way": (0.040, 0.300),
        "roundabout": (0.070, 0.600),
        "intersection": (0.090, 0.900),
        "u-turn": (0.030, 0.300),
    },
}
OTHERWISE = (0.0006, 0.005)
UPDATE = 0.005  # [s] of the learner, without the steps
CELL = 0.5  # [s] beside training and test: environment, files
START = 20.0  # [s] of a sweep: starting the processes, and the report
RECENT = 50  # cells of a place that the measured rates are the median of
GROWTH = 0.25  # how much longer each heavier level takes, where it was not measured


class Rates:
    """Seconds for an update with its training steps and for a test episode, by (backend, task, level).

    Args:
        records: cell.json of stored cells; those of other processors are passed over.

    Attributes:
        measured: how many stored cells they come from (0: the default rates alone).
    """

    def __init__(self, records: Iterable[Mapping[str, Any]] = ()) -> None:
        self.measured = 0
        self._updates: dict[Place, deque[float]] = defaultdict(lambda: deque(maxlen=RECENT))
        self._episodes: dict[Place, deque[float]] = defaultdict(lambda: deque(maxlen=RECENT))
        for record in records:
            self.learn(record)

    def seconds(self, cell: Cell) -> float:
        """Expected time of a cell on one core [s], without what a sweep takes once (START)."""
        place = (cell.runs_on, cell.task, cell.level)
        factor = 1.0 + GROWTH * (cell.level - 1)
        step, episode = (factor * rate for rate in DEFAULT_RATES[cell.runs_on].get(cell.task, OTHERWISE))
        update = UPDATE + cell.profile.get("steps_per_update", 1) * step
        if place in self._updates:
            update = median(self._updates[place])
        if place in self._episodes:
            episode = median(self._episodes[place])
        return CELL + cell.updates * update + cell.work * episode

    def learn(self, record: Mapping[str, Any]) -> None:
        """Take in a stored cell. One of other versions is passed over: an estimate is no place to complain."""
        with suppress(KeyError, TypeError, ZeroDivisionError):
            if record["provenance"]["cpu"] != cpu():
                return
            key, timing = record["key"], record["timing"]
            runs_on = key.get("test_on", {}).get("backend", key["backend"])
            place = (runs_on, key["task"], key["level"])
            self._episodes[place].append(timing["test_seconds"] / timing["test_episodes"])
            if timing.get("timed_updates"):
                self._updates[place].append(timing["train_seconds"] / timing["timed_updates"])
            self.measured += 1


def duration(seconds: float) -> str:
    """A time span as a person says it: "40 s", "12 min", "3 h 20 min"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
