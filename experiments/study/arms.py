"""The arms of the experiment: the traffic that agents are trained in and tested in, and which scenarios they meet.

A scenario is a seed given to ``env.reset``. Training scenarios have seeds below 2**32 (`training_seed`,
`agents.streams.episode_seed`), test scenarios have seeds of 2**32 and above: the two sets are disjoint by
construction. A test scenario depends on the task, the level and its number alone, so all arms, training
seeds, policies and both simulators are tested on the same ones. Regular and risky tests share their seeds:
the same cars stand in the same places, with other drivers.
"""

from __future__ import annotations

import zlib

import numpy as np

from agents.streams import stream
from sumo_env.config import Config
from sumo_env.tasks import TASKS

ARMS: dict[str, float] = {"control": 0.0, "treatment": 1.0}  # dose of risk in training
TRAFFICS: dict[str, float] = {"regular": 0.0, "risky": 1.0}  # dose of risk in the test
# Arms beside the two, and the dose of risk in their training. They are exploratory: none of them enters the primary
# comparison. "dense" learns in regular traffic of the next higher level, so that risk can be told from more
# interaction; "penalty" in regular traffic with a doubled penalty for crashes: a positive control, whose effect has
# to be found.
# The arms of DRAWN have another dose in every training episode, and here its mean.
DOSE_TRAFFICS: dict[str, float] = {"dose25": 0.25, "dose50": 0.5, "dose75": 0.75}
DRAWN = ("mixed", "drawn", "mixed-seen")
EXTRA_ARMS: dict[str, float] = {**DOSE_TRAFFICS, "dense": 0.0, "penalty": 0.0, **dict.fromkeys(DRAWN, 0.5)}
# What an arm changes about the learner: "mixed-seen" observes the dose, also in the test.
ARM_PROFILES = {"mixed-seen": {"dose_observed": True}}
DOSES: dict[str, float] = {**ARMS, **EXTRA_ARMS}
DOSE_ARMS = ("control", "dose25", "dose50", "dose75", "treatment")
ALL_TRAFFICS: dict[str, float] = {**TRAFFICS, **DOSE_TRAFFICS}
TEST = 2**32  # where the seeds of the test scenarios begin


def drawn_dose(arm: str, seed: int) -> float:
    """Dose of risk in the training episode with this seed: at any dose for "drawn", 0 or 1 for the other arms of DRAWN.

    It depends on the seed alone, so that a training that is resumed meets the same traffic.
    """
    share = float(stream(seed, "dose").random())
    return share if arm == "drawn" else float(share < 0.5)


def gate_traffics(arm: str | None) -> tuple[str, ...]:
    """Traffics that the gates of an arm look at: its own; for the policies it is held against (None) both.

    The arms of DRAWN are judged in both traffics, the other exploratory arms in regular traffic.
    """
    if arm is None or arm in DRAWN:
        return tuple(TRAFFICS)
    own = ARMS.get(arm, 0.0)
    return tuple(traffic for traffic, risk in TRAFFICS.items() if risk == own)


def trained_with(arm: str, task: str, level: int) -> Config | None:
    """What differs in the environment that an arm is trained in; None where there is no such arm.

    "dense": the traffic of the next higher level (the highest has none). "penalty": twice the reward for a crash (the
    two-way road's reward has no such term).
    """
    levels = list(TASKS[task].levels.values())
    if arm == "dense":
        if level == len(levels):
            return None
        return {k: v for k, v in levels[level].items() if levels[level - 1].get(k) != v}
    if arm == "penalty":
        penalty = TASKS[task].defaults.get("collision_reward", 0)
        return {"collision_reward": 2 * penalty} if penalty else None
    return {}


def scenario_seed(task: str, level: int, scenario: int, purpose: str = "test") -> int:
    """Seed of a scenario of a task and level, in [2**32, 2**33); the gates ("gate") have others than the test."""
    return TEST + stream_seed(f"{purpose} scenario", task, level, scenario)


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
