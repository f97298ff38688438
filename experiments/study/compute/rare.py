"""Episodes in which risk events come more often than at the rates that are asked about, in batches."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from agents.policies import Policy
from experiments.backends import make_env
from experiments.study.compute import batches
from experiments.study.compute.entrants import Entrant
from experiments.study.design.arms import stream_seed
from experiments.study.design.levels import level_config
from experiments.study.design.sheet import task_of
from sumo_env.tasks import TASKS
from sumo_env.traffic.risk import RATES

# Columns of an episode, with their types.
COLUMNS: dict[str, str] = {
    "base": "float64",  # rate of events
    "level": "float64",  # rate of those near the ego
    "seed": "int64",
    "crashed": "bool",
    "steps": "int64",  # policy steps
    "km": "float64",
    "near": "int64",  # events near the ego
    "near_expected": "float64",  # at the rate 1
    "other": "int64",  # events elsewhere
    "other_expected": "float64",
}


@dataclass(frozen=True)
class Question:
    """Who drives, in what.

    driver: is resolved. task: may be a variant. dose: of the other drivers' parameters. reach: within which events are
    near [m]. dynamics: what the simulator does, see `fingerprint.dynamics`.
    """

    driver: Entrant
    task: str
    level: str
    dose: float
    reach: float
    seed: int
    dynamics: str

    @property
    def key(self) -> dict[str, Any]:
        """All that decides the result, as plain values."""
        values = {name: value for name, value in vars(self).items() if name != "driver"}
        return {"policy": self.driver.name, "digest": self.driver.digest, **values}

    @property
    def config(self) -> dict[str, Any]:
        """Of the environment."""
        return {**level_config(self.task, self.level), **self.driver.config, "risk": self.dose}

    @property
    def rates(self) -> dict[str, float]:
        """Events of a vehicle at the rate 1, by their kind [1/s]."""
        return {kind: getattr(TASKS[task_of(self.task)].risk_rates, kind) for kind in RATES}

    def play(self, env: Any, policy: Policy, base: float, level: float, seed: int) -> dict[str, Any]:
        """One episode with events at the rate `base`, and at the rate `level` near the ego."""
        rates = {kind: rate * base / self.dose for kind, rate in self.rates.items()}
        options = {"risk_rates": rates, "event_factor": max(level / base, 1.0), "event_reach": self.reach}
        policy.reset(seed)
        seen, info = env.reset(seed=seed, options=options)
        over, steps, distance = False, 0, 0.0
        while not over:
            seen, _, terminated, truncated, info = env.step(policy.act(seen))
            over, steps, distance = terminated or truncated, steps + 1, distance + info["distance"]
        inner = env.unwrapped
        end = min(inner.scene.time, inner.config["duration"])
        lived = sum(max(end - start, 0.0) for _, start in inner.scenario.lifetimes)
        near = info["expected_events"] / base
        return {
            "base": base,
            "level": level,
            "seed": seed,
            "crashed": bool(info["crashed"]),
            "steps": steps,
            "km": distance / 1000.0,
            "near": info["events"],
            "near_expected": near,
            "other": info["other_events"],
            "other_expected": sum(self.rates.values()) * lived - near,
        }


@dataclass(frozen=True)
class Batch(batches.Batch):
    """Some episodes of each component.

    part: "pilot" or "curve". rounds: episodes of each component. number: of the batch.
    """

    question: Question
    part: str
    components: tuple[tuple[float, float], ...]
    rounds: int
    number: int
    columns = COLUMNS

    @cached_property
    def name(self) -> str:
        """By part and number."""
        key = {**self.question.key, "components": self.components, "rounds": self.rounds}
        return batches.named(f"{self.part}-{self.number:04d}", key)

    @cached_property
    def each(self) -> list[tuple[float, float, int]]:
        """Base, level and seed of each episode."""
        asked, found = self.question, []
        for k in range(self.number * self.rounds, (self.number + 1) * self.rounds):
            for base, level in self.components:
                words = f"rare {self.part}", asked.task, asked.level, asked.seed, f"{base:g} {level:g}", k
                found.append((base, level, stream_seed(*words)))
        return found

    @property
    def episodes(self) -> dict[str, tuple[Any, ...]]:
        """Their base, level and seed."""
        return dict(zip(("base", "level", "seed"), zip(*self.each, strict=True), strict=True))

    def drive(self) -> Iterator[dict[str, Any]]:
        """Drive them."""
        asked = self.question
        with closing(make_env("sumo", task_of(asked.task), asked.config)) as env:
            seen, policy = asked.driver.make(env)
            for episode in self.each:
                yield asked.play(seen, policy, *episode)
