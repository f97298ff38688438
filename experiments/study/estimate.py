"""How long cells will take: from the stored cells of this kind of machine, else from rates stated here."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from experiments.study.grid import Cell
from experiments.support.provenance import cpu

# Processor seconds of a common server for (a training step, a test episode) in the lightest traffic.
DEFAULT_RATES: dict[tuple[str, str], tuple[float, float]] = {
    ("sumo", "highway"): (0.0055, 0.050),
    ("sumo", "two-way"): (0.0040, 0.012),
    ("sumo", "roundabout"): (0.0040, 0.012),
    ("sumo", "intersection"): (0.0045, 0.020),
    ("sumo", "u-turn"): (0.0035, 0.010),
    ("highway-env", "highway"): (0.400, 6.000),
    ("highway-env", "two-way"): (0.040, 0.300),
    ("highway-env", "roundabout"): (0.070, 0.600),
    ("highway-env", "intersection"): (0.090, 0.900),
    ("highway-env", "u-turn"): (0.030, 0.300),
}
UPDATE = 0.006  # [s] of the learner, without the steps
CELL = 0.5  # [s] beside training and test: environment, files
START = 20.0  # [s] of a sweep: starting the processes, and the report
GROWTH = 0.25  # how much longer each heavier level takes, where it was not measured


@dataclass(frozen=True)
class Rates:
    """Seconds for an update with its training steps and for a test episode, by (backend, task, level).

    measured: how many stored cells they come from (0: the default rates alone).
    """

    by_level: Mapping[tuple[str, str, int], tuple[float, float]]
    measured: int

    def seconds(self, cell: Cell) -> float:
        """Expected time of a cell on one core [s], without what a sweep takes once (START)."""
        factor = 1.0 + GROWTH * (cell.level - 1)
        step, episode = (factor * rate for rate in DEFAULT_RATES[cell.backend, cell.task])
        default = (UPDATE + cell.profile.get("steps_per_update", 1) * step, episode)
        update, episode = self.by_level.get((cell.backend, cell.task, cell.level), default)
        return CELL + cell.updates * update + cell.work * episode


def rates(directory: Path) -> Rates:
    """The rates measured on this kind of processor in a result directory (which need not exist).

    Cells that cannot be read are passed over: an estimate is no place to complain about them.
    """
    steps, episodes = defaultdict(list), defaultdict(list)
    count = 0
    for key, timing in _timings(directory.glob("cells/*/cell.json")):
        count += 1
        where = (key["backend"], key["task"], key["level"])
        if timing.get("timed_updates"):
            steps[where].append(timing["train_seconds"] / timing["timed_updates"])
        episodes[where].append(timing["test_seconds"] / timing["test_episodes"])
    by_level = {}
    for where, values in episodes.items():
        step, _ = DEFAULT_RATES[where[:2]]
        by_level[where] = (median(steps[where]) if steps[where] else UPDATE + 4 * step, median(values))
    return Rates(by_level, count)


def _timings(files: Iterable[Path]) -> Iterable[tuple[dict, dict]]:
    for file in files:
        try:
            record = json.loads(file.read_text())
            if record["provenance"]["cpu"] == cpu():
                yield record["key"], record["timing"]
        except (OSError, ValueError, KeyError):
            continue


def duration(seconds: float) -> str:
    """A time span as a person says it: "40 s", "12 min", "3 h 20 min"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
