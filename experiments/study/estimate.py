"""How long cells will take: from the stored cells of this kind of machine, else from rates stated here."""

from __future__ import annotations

import json
from collections import defaultdict, deque
from pathlib import Path
from statistics import median

from experiments.study.grid import Cell
from experiments.support.provenance import cpu

Place = tuple[str, str, int]  # backend, task, level

# Processor seconds of a common server for (a training step, a test episode) in the lightest traffic. SUMO's are those
# of the published study and a quarter; the others are rough.
DEFAULT_RATES: dict[tuple[str, str], tuple[float, float]] = {
    ("sumo", "highway"): (0.0025, 0.050),
    ("sumo", "two-way"): (0.0010, 0.010),
    ("sumo", "roundabout"): (0.0016, 0.017),
    ("sumo", "intersection"): (0.0020, 0.017),
    ("sumo", "u-turn"): (0.0011, 0.010),
    ("highway-env", "highway"): (0.400, 6.000),
    ("highway-env", "two-way"): (0.040, 0.300),
    ("highway-env", "roundabout"): (0.070, 0.600),
    ("highway-env", "intersection"): (0.090, 0.900),
    ("highway-env", "u-turn"): (0.030, 0.300),
    **{
        ("replica", task): (step, episode)
        for task, step, episode in (
            ("highway", 0.0008, 0.015),
            ("two-way", 0.0006, 0.005),
            ("roundabout", 0.0006, 0.005),
            ("intersection", 0.0006, 0.005),
            ("u-turn", 0.0006, 0.005),
        )
    },
}
UPDATE = 0.005  # [s] of the learner, without the steps
CELL = 0.5  # [s] beside training and test: environment, files
START = 20.0  # [s] of a sweep: starting the processes, and the report
RECENT = 50  # cells of a place that the measured rates are the median of
GROWTH = 0.25  # how much longer each heavier level takes, where it was not measured


class Rates:
    """Seconds for an update with its training steps and for a test episode, by (backend, task, level).

    Attributes:
        measured: how many stored cells they come from (0: the default rates alone).
    """

    def __init__(self) -> None:
        self.measured = 0
        self._updates: dict[Place, deque[float]] = defaultdict(lambda: deque(maxlen=RECENT))
        self._episodes: dict[Place, deque[float]] = defaultdict(lambda: deque(maxlen=RECENT))

    def seconds(self, cell: Cell) -> float:
        """Expected time of a cell on one core [s], without what a sweep takes once (START)."""
        place = (cell.runs_on, cell.task, cell.level)
        step, episode = self._default(place)
        update = UPDATE + cell.profile.get("steps_per_update", 1) * step
        if place in self._updates:
            update = median(self._updates[place])
        if place in self._episodes:
            episode = median(self._episodes[place])
        return CELL + cell.updates * update + cell.work * episode

    @staticmethod
    def _default(place: Place) -> tuple[float, float]:
        backend, task, level = place
        factor = 1.0 + GROWTH * (level - 1)
        step, episode = DEFAULT_RATES[backend, task]
        return factor * step, factor * episode

    def learn(self, file: Path) -> None:
        """Take in a stored cell of this kind of processor.

        One that cannot be read is passed over: an estimate is no place to complain about it.
        """
        try:
            record = json.loads(file.read_text())
            if record["provenance"]["cpu"] != cpu():
                return
            key, timing = record["key"], record["timing"]
            runs_on = key.get("test_on", {}).get("backend", key["backend"])
            place = (runs_on, key["task"], key["level"])
            self._episodes[place].append(timing["test_seconds"] / timing["test_episodes"])
            if timing.get("timed_updates"):
                self._updates[place].append(timing["train_seconds"] / timing["timed_updates"])
            self.measured += 1
        except (OSError, ValueError, KeyError, TypeError, ZeroDivisionError):
            return


def rates(directory: Path) -> Rates:
    """The rates measured on this kind of processor in a result directory (which need not exist)."""
    found = Rates()
    for file in sorted(directory.glob("cells/*/cell.json")):
        found.learn(file)
    return found


def duration(seconds: float) -> str:
    """A time span as a person says it: "40 s", "12 min", "3 h 20 min"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
