"""Named sizes of the experiment. Arguments override what a preset sets; the cells say what was used."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from experiments.support.errors import UserError, unknown
from sumo_env.tasks import TASKS

PAPER_EPISODES = 3072  # training episodes of an agent in the paper
# Mean length of a training episode [steps], to turn the paper's budget into updates. Budgets are counted in
# updates, equal for both arms: the number of target copies sets how far an agent looks ahead, and with it its
# appetite for risk, while equal numbers of episodes would give the arms different numbers of updates.
EPISODE_LENGTH = {"highway": 17, "two-way": 6, "roundabout": 10, "intersection": 9, "u-turn": 9}


# Hyper-parameters of the learner by profile, over the defaults of `agents.dqn.DQNConfig`, which are those of "tuned".
PROFILES: dict[str, dict[str, Any]] = {
    "tuned": {},
    # The paper's numbers; where it is silent, those of the code that it cites, except the target network, which that
    # code copies at every update: at gamma .99 six of six agents diverged (docs/developers/decisions.md).
    "paper": {
        "network": "dueling",
        "gamma": 0.99,
        "steps_per_update": 1,
        "learning_rate_final": 5e-4,
        "target_interval": 500,
        "tau": 1.0,
        "warm_up": 100,
        "standardise": False,
    },
}
# What the profile "tuned" changes about a task, in both arms. finite_horizon: the time limit is terminal and the time
# is observed (see `wrappers`). The roundabout's reward pays for standing at the entry: with values beyond the limit,
# waiting is worth more than driving, and agents learn to wait. On the u-turn nothing is ever learnt of the places where
# the limit ends an episode, so that the values beyond it, guessed there, grow without bound (docs/learner.md).
TASK_PROFILES: dict[str, dict[str, Any]] = {
    "roundabout": {"finite_horizon": True},
    "u-turn": {"finite_horizon": True},
}
# Ends of training episodes [s], from and to, that hide the end of a test: drawn, or longer than the test (11 and 10 s).
# Not later than an ego at the highest speed leaves the road.
CLOCKS = {
    "drawn": {"roundabout": [7, 15], "u-turn": [7, 13]},
    "longer": {"roundabout": [15, 15], "u-turn": [13, 13]},
}


def second_version(
    task: str, steps: int, steps_per_update: int, batch_size: int, clock: str = "drawn"
) -> dict[str, Any]:
    """Hyper-parameters of a task in the second version of "tuned", of which `choice` tries variants.

    Args:
        steps: environment steps of a training.
        clock: of CLOCKS; the time is not observed.
    """
    learner = {
        "updates": steps // steps_per_update,
        "steps_per_update": steps_per_update,
        "batch_size": batch_size,
        "tau": 0.005 * steps_per_update / 4,  # the target moves as far in a step as in the first version
    }
    return {**learner, **({"training_clock": CLOCKS[clock][task]} if task in CLOCKS[clock] else {})}


@dataclass(frozen=True)
class Preset:
    """A size of the experiment.

    levels: traffic levels by number, None for all. seeds: training seeds an arm. episodes: test episodes a
        traffic. gate_episodes: episodes a traffic on which the gates are judged.
    first_seed, first_scenario: numbers at which training seeds and scenarios begin, so that studies share none.
    updates: training budget of each task. profile: of PROFILES. learner: other fields of `agents.dqn.DQNConfig`.
    clock: of CLOCKS; None: that of the profile.
    """

    name: str
    about: str
    levels: tuple[int, ...] | None
    seeds: int
    episodes: int
    gate_episodes: int
    updates: Mapping[str, int]
    profile: str = "tuned"
    learner: Mapping[str, Any] = field(default_factory=dict)
    first_seed: int = 0
    first_scenario: int = 0
    clock: str | None = None

    def profiles(self, crash_reward: float | None = None, **overrides: Any) -> dict[str, dict[str, Any]]:
        """Every hyper-parameter of the learner for each task, as plain values.

        Args:
            crash_reward: added to the reward of a crash in training, in all arms.
            overrides: those that the user asked for; None means not asked for.

        Raises:
            UserError: one makes no sense.
        """
        from agents.dqn import DQNConfig  # here: not every command needs the learner
        from agents.models import network_class

        if crash_reward is not None and not math.isfinite(crash_reward):
            raise UserError(f"the reward of a crash has to be a finite number, not {crash_reward}")
        asked = {name: value for name, value in overrides.items() if value is not None}
        own = TASK_PROFILES if self.profile == "tuned" else {}
        if self.clock is not None:
            own = {task: {"training_clock": ends} for task, ends in CLOCKS[self.clock].items()}
        profiles = {}
        for task in TASKS:
            try:
                config = DQNConfig(
                    **{"updates": self.updates[task], **PROFILES[self.profile], **self.learner, **asked}
                )
                if ":" not in config.network:
                    network_class(config.network)
            except ValueError as error:
                raise UserError(str(error)) from None
            profiles[task] = {**asdict(config), "finite_horizon": False, **own.get(task, {})}
            if crash_reward is not None:
                profiles[task]["crash_reward"] = crash_reward
        return profiles


PRESETS = {
    preset.name: preset
    for preset in (
        Preset(
            name="smoke",
            about="all five tasks, a minute: proves that everything runs, answers nothing",
            levels=(1,),
            seeds=1,
            episodes=4,
            gate_episodes=4,
            updates=dict.fromkeys(TASKS, 200),
            learner={"warm_up": 200},
        ),
        Preset(
            name="quick",
            about="all five tasks in their lightest traffic, three seeds an arm: 20 minutes on two cores",
            levels=(1,),
            seeds=3,
            episodes=50,
            gate_episodes=100,
            updates={
                "highway": 5000,
                "two-way": 8000,
                "roundabout": 4000,
                "intersection": 7000,
                "u-turn": 4000,
            },
        ),
        Preset(
            name="standard",
            about="the paper's 18 settings, ten seeds per arm (the published study has five in most), many hours",
            levels=None,
            seeds=10,
            episodes=100,
            gate_episodes=100,
            # on the two-way road, 10,000 are too few (docs/learner.md)
            updates={**dict.fromkeys(TASKS, 10_000), "two-way": 20_000},
        ),
        Preset(
            name="second",
            about="the second study: learners that go on until they have finished, five seeds, 400 scenarios: days",
            levels=None,
            seeds=5,
            episodes=400,
            gate_episodes=100,
            # one update per step with batch 64, and the clock: docs/developers/learner_choice.md
            updates={**dict.fromkeys(TASKS, 40_000), "two-way": 160_000, "u-turn": 80_000},
            learner={"steps_per_update": 1, "batch_size": 64, "tau": 0.005 / 4},
            clock="longer",
            first_seed=100,
            first_scenario=1000,
        ),
        Preset(
            name="paper",
            about="the paper's 18 settings with its own learner, 3072 episodes' worth of updates: many hours",
            levels=None,
            seeds=10,
            episodes=100,
            gate_episodes=100,
            profile="paper",
            updates={task: PAPER_EPISODES * EPISODE_LENGTH[task] for task in TASKS},
        ),
    )
}


def get_preset(name: str) -> Preset:
    """The preset of this name. Raises UserError with the nearest name if there is none."""
    if name not in PRESETS:
        raise unknown("preset", name, PRESETS)
    return PRESETS[name]
