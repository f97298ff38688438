"""What the project has promised itself, beside what a benchmark measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Record = Mapping[str, Any]
Results = Mapping[str, Any]

# Times as fast as highway-env: (task, level, traffic model, at highway-env's frequency) -> ratio. A level of
# None stands for the lowest one.
RATIOS: dict[tuple[str, str | None, str, bool], float] = {
    ("highway", "50", "sumo", True): 200,
    ("highway", "100", "sumo", True): 300,
    ("highway", "150", "sumo", True): 400,
    ("highway", "50", "matched", True): 150,
    ("highway", "100", "matched", True): 250,
    ("highway", "150", "matched", True): 350,
    ("highway", "50", "matched", False): 250,
    ("highway", "100", "matched", False): 450,
    ("highway", "150", "matched", False): 1000,
    ("two-way", None, "matched", False): 30,
    ("roundabout", None, "matched", False): 90,
    ("intersection", None, "matched", False): 70,
    ("u-turn", None, "matched", False): 60,
}
ENGINE_SHARES = {"sumo": 0.85, "matched": 0.65}  # on the highway with 50 vehicles
LEARNER_RATIO = 1.0  # an update on the same network, times as fast as Stable-Baselines3
AGENTS_PER_HOUR = 40  # over the 18 settings with the budget of `standard`, on two cores


def number(value: float | None) -> str:
    """Three significant digits, without an exponent."""
    if value is None:
        return "not measured"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


@dataclass(frozen=True)
class Target:
    """One promise. `at_most`: smaller is better. `measured`: None where it was not measured."""

    name: str
    wanted: float
    measured: float | None
    at_most: bool = False

    @property
    def met(self) -> bool | None:
        """Whether it is kept; None where it was not measured."""
        if self.measured is None:
            return None
        return self.measured <= self.wanted if self.at_most else self.measured >= self.wanted

    def as_dict(self) -> dict[str, Any]:
        """As plain values, for benchmark.json."""
        return {
            "name": self.name, "target": self.wanted, "at_most": self.at_most,
            "measured": self.measured, "met": self.met,
        }  # fmt: skip


def compare(results: Results) -> list[Target]:
    """Every promise beside its measurement in `results` (the content of benchmark.json)."""
    env: Sequence[Record] = results.get("env", ())
    targets = []
    for (task, level, model, equal), wanted in RATIOS.items():
        record = _find(env, task, level, model, equal)
        work = "equal work" if equal else "default"
        place = f"{task} {level}" if level else task
        name = f"times highway-env, {place}, {model}, {work}"
        targets.append(Target(name, wanted, None if record is None else record["ratio"]))
    for model, wanted in ENGINE_SHARES.items():
        record = _find(env, "highway", "50", model, False)
        name = f"engine's share of the loop, highway 50, {model}"
        targets.append(Target(name, wanted, None if record is None else record["engine_share"]))
    for network in ("dueling", "attention"):
        ratios = [record["ratio"] for record in results.get("learner", ()) if record["network"] == network]
        name = f"times Stable-Baselines3, an update of {network}"
        targets.append(Target(name, LEARNER_RATIO, min(ratios, default=None)))
    rates = [record["agents_per_hour_on_free_cores"] for record in results.get("sweep", ())]
    targets.append(Target("agents an hour, standard, free cores", AGENTS_PER_HOUR, max(rates, default=None)))
    return targets


def _find(env: Sequence[Record], task: str, level: str | None, model: str, equal: bool) -> Record | None:
    for record in env:  # the lowest level of a task comes first
        here = record["task"] == task and level in (None, record["level"])
        if here and record["traffic_model"] == model and record["equal_work"] == equal:
            return record
    return None
