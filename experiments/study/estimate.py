"""How long cells will take: from the stored cells of this kind of machine, else from rates stated here."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import Any

from experiments.study.grid import Cell
from experiments.study.store import DamagedCell, Store
from experiments.support.provenance import cpu

# Processor seconds of a common server for (a training step, a test episode) in the lightest traffic;
# rough except for SUMO.
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
RECENT = 50  # cells that a measured rate is the median of
GROWTH = 0.25  # how much longer each heavier level takes, where it was not measured


class Rates:
    """Seconds for an update with its training steps and for a test episode, by simulator, task and level.

    Attributes:
        measured: how many stored cells they come from (0: the default rates alone).
    """

    def __init__(self) -> None:
        self.measured = 0
        self._seen: dict[tuple[Any, ...], list[float]] = {}
        self._rates: dict[tuple[Any, ...], float] = {}

    def seconds(self, cell: Cell) -> float:
        """Expected time of a cell on one core [s], without what a sweep takes once (START)."""
        factor = 1.0 + GROWTH * (cell.level - 1)
        step, episode = (factor * rate for rate in DEFAULT_RATES[cell.runs_on].get(cell.task, OTHERWISE))
        update = UPDATE + cell.profile.get("steps_per_update", 1) * step
        update = self._rates.get(("update", cell.runs_on, cell.task, cell.level), update)
        episode = self._rates.get(("episode", cell.runs_on, cell.task, cell.level), episode)
        return CELL + cell.updates * update + cell.work * episode

    def learn(self, record: Mapping[str, Any]) -> None:
        """Take in cell.json of a stored cell, unless it was computed by another processor."""
        if record["provenance"]["cpu"] != cpu():
            return
        key, timing = record["key"], record["timing"]
        where = (key.get("test_on", key)["backend"], key["task"], key["level"])
        self._note(("episode", *where), timing["test_seconds"] / timing["test_episodes"])
        if timing.get("timed_updates"):
            self._note(("update", *where), timing["train_seconds"] / timing["timed_updates"])
        self.measured += 1

    def _note(self, place: tuple[Any, ...], seconds: float) -> None:
        seen = self._seen.setdefault(place, [])
        seen.append(seconds)
        self._rates[place] = median(seen[-RECENT:])


def rates_of(directory: Path) -> Rates:
    """The rates measured on this kind of processor in a result directory, which need not exist."""
    rates, store = Rates(), Store(directory)
    for name in store.finished():
        with suppress(DamagedCell):
            rates.learn(store.record(name))
    return rates


def duration(seconds: float) -> str:
    """A time span as a person says it: "40 s", "12 min", "3 h 20 min"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
