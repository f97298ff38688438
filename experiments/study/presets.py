"""Named sizes of the experiment. Arguments override what a preset sets; the cells say what was used."""

from __future__ import annotations

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


@dataclass(frozen=True)
class Preset:
    """A size of the experiment.

    levels: traffic levels by number, None for all. seeds: training seeds an arm. episodes: test episodes a
        traffic.
    updates: training budget of each task. learner: other settings of `agents.dqn.DQNConfig`.
    """

    name: str
    about: str
    levels: tuple[int, ...] | None
    seeds: int
    episodes: int
    updates: Mapping[str, int]
    learner: Mapping[str, Any] = field(default_factory=dict)

    def profiles(self, **overrides: Any) -> dict[str, dict[str, Any]]:
        """Every setting of the learner for each task, as plain values.

        Args:
            overrides: settings that the user asked for; None means not asked for.

        Raises:
            UserError: a setting that makes no sense.
        """
        from agents.dqn import DQNConfig  # here: not every command needs the learner

        asked = {name: value for name, value in overrides.items() if value is not None}
        profiles = {}
        for task in TASKS:
            try:
                config = DQNConfig(**{"updates": self.updates[task], **self.learner, **asked})
            except ValueError as error:
                raise UserError(str(error)) from None
            profiles[task] = {
                name: list(value) if isinstance(value, tuple) else value
                for name, value in asdict(config).items()
            }
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
            updates=dict.fromkeys(TASKS, 200),
            learner={"gamma": 0.95, "target_lag": 50},
        ),
        Preset(
            name="quick",
            about="all five tasks in their lightest traffic, three seeds an arm: 15 minutes on two cores",
            levels=(1,),
            seeds=3,
            episodes=50,
            updates={
                "highway": 8000,
                "two-way": 8000,
                "roundabout": 10_000,
                "intersection": 10_000,
                "u-turn": 10_000,
            },
            # gamma .95 is a horizon of 20 steps, the length of the longest episode, and the default lag of 500
            # makes as many target copies. Lag 200 let Q grow beyond its bound (docs/decisions.md).
            learner={"gamma": 0.95},
        ),
        Preset(
            name="paper",
            about="the paper's 18 cells, ten seeds an arm, 3072 episodes' worth of updates: many hours",
            levels=None,
            seeds=10,
            episodes=100,
            updates={task: PAPER_EPISODES * EPISODE_LENGTH[task] for task in TASKS},
        ),
    )
}


def get_preset(name: str) -> Preset:
    """The preset of this name. Raises UserError with the nearest name if there is none."""
    if name not in PRESETS:
        raise unknown("preset", name, PRESETS)
    return PRESETS[name]
