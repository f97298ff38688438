"""The arms of the experiment, in one table, and which scenarios agents meet in training and test.

A scenario is a seed given to ``env.reset``. Training scenarios have seeds below 2**32 (`training_seed`,
`agents.streams.episode_seed`), test scenarios have seeds of 2**32 and above: no seed is in both sets. (A reset draws
31 bits from its seed, so that two seeds give one scenario with a chance of 1 in 2**31.) A test scenario depends on the
task, the level and its number alone, so all arms, training seeds, policies and both simulators are tested on the same
ones. Regular and risky tests share their seeds: the same cars stand in the same places, with other drivers.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from experiments.study.design.sheet import task_of
from experiments.study.design.traffic import ALL, BETWEEN, TRAFFICS, WITHOUT, Traffic

TEST = 2**32  # where the seeds of the test scenarios begin
NUMBERED = range(10**9)  # of trainings and of scenarios


@dataclass(frozen=True)
class Arm:
    """A way of training.

    traffic: of the training. judged_in: traffics that the gates look at; exploratory arms are judged in regular
    traffic, or in both where their doses are drawn. rules: what differs in `training_rules.TrainingRules`.
    """

    name: str
    traffic: Traffic
    judged_in: tuple[str, ...] = ("regular",)
    rules: Mapping[str, Any] = field(default_factory=dict)


EVERY_ARM: dict[str, Arm] = {
    arm.name: arm
    for arm in (
        Arm("control", ALL["regular"]),
        Arm("treatment", ALL["risky"], judged_in=("risky",)),
        *(Arm(name, ALL[name]) for name in BETWEEN),
        Arm("mixed", ALL["mixed"], judged_in=TRAFFICS),
        *(Arm(name, traffic, judged_in=("risky",)) for name, traffic in WITHOUT.items()),
        Arm("told", ALL["mixed"], judged_in=TRAFFICS, rules={"dose_observed": True}),
    )
}


ARMS = ("control", "treatment")  # of the primary comparison; the others are exploratory
EXTRA_ARMS = tuple(name for name in EVERY_ARM if name not in ARMS)
DOSE_ARMS = ("control", *BETWEEN, "treatment")


def gate_traffics(arm: str | None) -> tuple[str, ...]:
    """Traffics that the gates of an arm look at; for the policies it is held against (None) both."""
    return EVERY_ARM[arm].judged_in if arm else TRAFFICS


def scenario_seed(task: str, level: int, scenario: int, purpose: str = "test") -> int:
    """Seed of a scenario of a task and level, in [2**32, 2**33); the gates ("gate") have others than the test.

    A variant of a task has the task's.
    """
    return TEST + stream_seed(f"{purpose} scenario", task_of(task), level, scenario)


def training_seed(task: str, level: int, seed: int) -> int:
    """The learner's seed of a training in [0, 2**32): one for both arms, others for each task, level and number.

    Agents of two settings that bear the same number therefore share no initial weights and no scenarios, and count
    as independent wherever settings are pooled.
    """
    return stream_seed("training", task, level, seed)


def stream_seed(purpose: str, *key: str | int) -> int:
    """Seed in [0, 2**32) that belongs to a purpose, for example a random policy's draws in one episode."""
    words = [zlib.crc32(word.encode()) if isinstance(word, str) else word for word in (purpose, *key)]
    return int(np.random.SeedSequence(words).generate_state(1)[0])
