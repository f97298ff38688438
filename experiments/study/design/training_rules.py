"""The rules of a training that are the environment's and not the learner's, the same in all arms."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self


@dataclass(frozen=True)
class TrainingRules:
    """How training episodes end, what a crash costs in them, and what is observed in addition to the vehicles.

    training_clock: episodes of so many seconds (the second number; the first is the same), whose end is terminal.
    time_observed: the share of so many seconds that is over is observed, in the test as well [s]. crash_reward: added
    to the reward of a crash. dose_observed: the dose of risk is observed, in the test as well. ValueError for a value
    that makes no sense.
    """

    training_clock: Sequence[int] | None = None
    time_observed: int | None = None
    crash_reward: float = 0.0
    dose_observed: bool = False

    def __post_init__(self) -> None:
        clock, seen = self.training_clock, self.time_observed
        if clock is not None and not (
            isinstance(clock, Sequence) and len({*clock}) == 1 and _is_time(clock[0])
        ):
            raise ValueError(f"training_clock must be twice the same whole number of seconds, not {clock!r}")
        if seen is not None and not _is_time(seen):
            raise ValueError(f"time_observed must be a whole number of seconds, not {seen!r}")
        if not math.isfinite(self.crash_reward):
            raise ValueError(f"the reward of a crash has to be a finite number, not {self.crash_reward}")

    @classmethod
    def of(cls, profile: Mapping[str, Any]) -> Self:
        """Those in the profile of a cell."""
        return cls(**{name: profile[name] for name in RULES if name in profile})

    def entries(self) -> dict[str, Any]:
        """What a cell's profile has of them: those that are set."""
        defaults = {field.name: field.default for field in fields(self)}
        return {name: value for name, value in vars(self).items() if value != defaults[name]}

    @property
    def duration(self) -> dict[str, int]:
        """What differs in the configuration of a training's environment."""
        return {"duration": self.training_clock[1]} if self.training_clock else {}


def _is_time(value: Any) -> bool:
    return type(value) is int and value > 0


RULES = tuple(field.name for field in fields(TrainingRules))
