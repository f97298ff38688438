"""Named sizes of the experiment. Arguments override what a preset sets; the cells say what was used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from experiments.study.experiment import Experiment
from experiments.study.grid import Cell
from experiments.support.errors import unknown
from sumo_env.tasks import TASKS

PAPER_EPISODES = 3072  # training episodes of an agent in the paper
# Mean length of a training episode [steps], to turn the paper's budget into updates. Budgets are counted in
# updates, equal for both arms: the number of target copies sets how far an agent looks ahead, and with it its
# appetite for risk, while equal numbers of episodes would give the arms different numbers of updates.
EPISODE_LENGTH = {"highway": 17, "two-way": 6, "roundabout": 10, "intersection": 9, "u-turn": 9}

# The paper's numbers, over the defaults of `agents.dqn.DQNConfig`; where it is silent, those of the code that it cites,
# except the target network, which that code copies at every update: at gamma .99 six of six agents diverged
# (docs/developers/decisions.md).
PAPER = {
    "network": "dueling",
    "gamma": 0.99,
    "steps_per_update": 1,
    "learning_rate_final": 5e-4,
    "target_interval": 500,
    "tau": 1.0,
    "warm_up": 100,
    "standardise": False,
}
# Tasks whose time limit is terminal, with the time observed (see `wrappers`), in the first version of "tuned". The
# roundabout's reward pays for standing at the entry: with values beyond the limit, waiting is worth more than driving,
# and agents learn to wait. On the u-turn nothing is ever learnt of the places where the limit ends an episode, so that
# the values beyond it, guessed there, grow without bound (docs/learner.md).
FINITE_HORIZON = ("roundabout", "u-turn")
# Ends of training episodes [s], from and to, that hide the end of a test: drawn, or longer than the test (11 and 10 s).
# Not later than an ego at the highest speed leaves the road.
CLOCKS = {
    "drawn": {"roundabout": [7, 15], "u-turn": [7, 13]},
    "longer": {"roundabout": [15, 15], "u-turn": [13, 13]},
}
# Environment steps of a training in the second study.
SECOND_STEPS = {**dict.fromkeys(TASKS, 40_000), "two-way": 160_000, "u-turn": 80_000}
# Where the second version observes the time, as a share of the training's longer clock, in the test as well.
TIME_OBSERVED = {"roundabout": {"time_observed": 15}, "u-turn": {"time_observed": 13}}


def tuned(updates: Mapping[str, int], **settings: Any) -> dict[str, dict[str, Any]]:
    """The learner of each task in the first version of "tuned": the defaults of `agents.dqn.DQNConfig`, but for these.

    updates: budget of an agent by task.
    """
    return {
        task: {"updates": budget, "finite_horizon": task in FINITE_HORIZON, **settings}
        for task, budget in updates.items()
    }


def second_version(
    task: str, steps: int, steps_per_update: int, batch_size: int, clock: str = "drawn"
) -> dict[str, Any]:
    """The learner of a task in the second version of "tuned", of which `choice` tries variants.

    Args:
        steps: environment steps of a training.
        clock: of CLOCKS, the time not observed; or "first", the first version's end (see FINITE_HORIZON).
    """
    learner = {
        "updates": steps // steps_per_update,
        "steps_per_update": steps_per_update,
        "batch_size": batch_size,
        "tau": 0.005 * steps_per_update / 4,  # the target moves as far in a step as in the first version
    }
    if clock == "first":
        return {**learner, "finite_horizon": task in FINITE_HORIZON}
    return {**learner, **({"training_clock": CLOCKS[clock][task]} if task in CLOCKS[clock] else {})}


SECOND = Experiment(
    preset="second",
    about="the second study: learners that go on until they have finished, five seeds, 400 scenarios: days",
    seeds=5,
    episodes=400,
    gate_episodes=100,
    # one update per step with batch 64, and the clocks: docs/developers/learner_choice.md
    learners={
        task: second_version(task, steps, 1, 64, clock="longer") | TIME_OBSERVED.get(task, {})
        for task, steps in SECOND_STEPS.items()
    },
    first_seed=100,
    first_scenario=1000,
)
PRESETS = {
    experiment.preset: experiment
    for experiment in (
        Experiment(
            preset="smoke",
            about="all five tasks, a minute: proves that everything runs, answers nothing",
            levels=(1,),
            seeds=1,
            episodes=4,
            gate_episodes=4,
            learners=tuned(dict.fromkeys(TASKS, 200), warm_up=200),
        ),
        Experiment(
            preset="quick",
            about="all five tasks in their lightest traffic, three seeds an arm: 20 minutes on two cores",
            levels=(1,),
            seeds=3,
            episodes=50,
            gate_episodes=100,
            learners=tuned(
                {"highway": 5000, "two-way": 8000, "roundabout": 4000, "intersection": 7000, "u-turn": 4000}
            ),
        ),
        Experiment(
            preset="standard",
            about="the paper's 18 settings, ten seeds per arm (the published study has five in most), many hours",
            seeds=10,
            episodes=100,
            gate_episodes=100,
            # on the two-way road, 10,000 are too few (docs/learner.md)
            learners=tuned({**dict.fromkeys(TASKS, 10_000), "two-way": 20_000}),
        ),
        SECOND,
        replace(
            SECOND,
            preset="first-clock",
            about="the second study's u-turn and roundabout, where agents see when the test ends: hours",
            tasks=FINITE_HORIZON,
            levels=(1,),
            learners={
                task: second_version(task, steps, 1, 64, clock="first")
                for task, steps in SECOND_STEPS.items()
            },
        ),
        Experiment(
            preset="paper",
            about="the paper's 18 settings with its own learner, 3072 episodes' worth of updates: many hours",
            seeds=10,
            episodes=100,
            gate_episodes=100,
            learners={task: {"updates": PAPER_EPISODES * EPISODE_LENGTH[task], **PAPER} for task in TASKS},
        ),
    )
}


def complete(asked: Experiment) -> Experiment:
    """What is asked for, and for the rest what its preset says.

    Raises:
        UserError: there is no such preset.
    """
    if asked.preset not in PRESETS:
        raise unknown("preset", asked.preset, PRESETS)
    given = {
        field.name: value
        for field in fields(Experiment)
        if (value := getattr(asked, field.name)) != field.default
    }
    return replace(PRESETS[asked.preset], **given)


def cells_of(asked: Experiment) -> list[Cell]:
    """All cells of what is asked for. Raises UserError where something does not exist or makes no sense."""
    return complete(asked).cells()
