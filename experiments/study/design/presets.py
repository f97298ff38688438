"""Named sizes of the experiment. Arguments override what a preset sets; the cells say what was used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from experiments.study.design.experiment import Dynamics, Experiment
from experiments.study.design.fingerprint import dynamics
from experiments.study.design.grid import Cell
from experiments.study.design.sheet import SHEETS
from experiments.support.errors import unknown

# Training episodes of an agent in the paper. Budgets are counted in updates, equal for both arms: the number of
# target copies sets how far an agent looks ahead, and with it its appetite for risk, while equal numbers of episodes
# would give the arms different numbers of updates.
PAPER_EPISODES = 3072
# The paper's numbers, over the defaults of `agents.dqn.DQNConfig`; where it is silent, those of the code that it cites,
# except the target network, which that code copies at every update: at gamma .99 six of six agents diverged
# (docs/developers/decisions.md).
PAPER = {
    "network": "dueling",
    "gamma": 0.99,
    "learning_rate_final": 5e-4,
    "batch_size": 100,
    "clip_goals": False,
    "target_interval": 500,
    "tau": 1.0,
    "warm_up": 100,
    "standardise": False,
    "by_hand": False,
}
# How training episodes end, by task (see `wrappers`): with a longer clock than the test's, of which the share that is
# over is observed in both; in earlier studies with the test's time limit, which was terminal.
LONGER = {
    task: {"training_clock": [own.clock, own.clock], "time_observed": own.clock}
    for task, own in SHEETS.items()
    if own.clock
}
FIRST_CLOCK = {task: {"finite_horizon": True} for task, own in SHEETS.items() if own.first_clock}


def tuned(
    updates: Mapping[str, int], clock: Mapping[str, Mapping[str, Any]] = LONGER, **settings: Any
) -> dict[str, dict[str, Any]]:
    """The profile "tuned" by task: the defaults of `agents.dqn.DQNConfig`, but for these.

    updates: budget of an agent by task. clock: by task how its training episodes end, see `rules.TrainingRules`.
    """
    return {task: {"updates": budget, **clock.get(task, {}), **settings} for task, budget in updates.items()}


SECOND_STEPS = {task: own.second_steps for task, own in SHEETS.items()}
SECOND = Experiment(
    preset="second",
    about="the second study: learners that go on until they have finished, five seeds, 400 scenarios: days",
    seeds=5,
    episodes=400,
    gate_episodes=100,
    learners=tuned(SECOND_STEPS),
    first_seed=100,
    first_scenario=1000,
)
# Settings of rl-agents' HighwayEnv/agents/DQNAgent/dueling_ddqn.json and IntersectionEnv/agents/DQNAgent/
# ego_attention_2h.json; the networks, the clip of the gradient's norm and the random steps are this project's.
RL_AGENTS = {
    "learning_rate_final": 5e-4,
    "clip_goals": False,
    "tau": 1.0,
    "replay_capacity": 15_000,
    "warm_up": 200,
    "standardise": False,
    "epsilon_final": 0.05,
    "by_hand": False,
}


def rl_agents(network: str, exploration: int, **settings: Any) -> Experiment:
    """A preset with rl-agents' settings, for as many environment steps as in the second study.

    exploration: time constant of the decay of random actions [steps].
    """
    learners = {}
    for task, own in SHEETS.items():
        updates = own.second_steps + 800  # as many steps as after 1000 random ones
        given = {"network": network, "updates": updates, "epsilon_decay": exploration / updates, **settings}
        learners[task] = {**RL_AGENTS, **given}
    name = f"rl-agents-{network}"
    about = f"rl-agents' settings on the network {network}, in regular traffic: hours"
    return replace(
        SECOND, preset=name, about=about, levels=(1,), seeds=3, arms=("control",), learners=learners
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
            learners=tuned(dict.fromkeys(SHEETS, 400), warm_up=200),
        ),
        Experiment(
            preset="quick",
            about="all five tasks in their lightest traffic, three seeds an arm: 10 to 15 minutes on two cores",
            levels=(1,),
            seeds=3,
            episodes=50,
            gate_episodes=100,
            learners=tuned({task: own.quick_updates for task, own in SHEETS.items()}),
        ),
        Experiment(
            preset="standard",
            about="the paper's 18 settings, ten seeds per arm (the published study has five in most), many hours",
            seeds=10,
            episodes=100,
            gate_episodes=100,
            learners=tuned(
                {task: own.standard_updates for task, own in SHEETS.items()},
                FIRST_CLOCK,
                steps_per_update=4,
                batch_size=100,
                tau=0.005,
            ),
        ),
        SECOND,
        replace(
            SECOND,
            preset="first-clock",
            about="the second study's u-turn and roundabout, where agents see when the test ends: hours",
            tasks=tuple(FIRST_CLOCK),
            levels=(1,),
            learners=tuned(SECOND_STEPS, FIRST_CLOCK),
        ),
        replace(
            SECOND,
            preset="pairs",
            about="two agents together, and what a belief about the traffic adds: ten seeds, 800 scenarios, a day",
            levels=(1,),
            seeds=10,
            episodes=800,
            arms=("control", "treatment", "mixed"),
            pairs=True,
            first_seed=200,
            first_scenario=2000,
        ),
        replace(
            SECOND,
            preset="choice",
            about="the choice of the learner (experiments/choose.py), by agents that no report uses: hours",
            seeds=3,
            episodes=200,
            first_seed=7000,
            first_scenario=70_000,
        ),
        rl_agents("dueling", 6000, gamma=0.8, batch_size=32, target_interval=50),
        rl_agents("attention", 15_000, gamma=0.95, batch_size=64, target_interval=512),
        Experiment(
            preset="paper",
            about="the paper's 18 settings with its own learner, 3072 episodes' worth of updates: many hours",
            seeds=10,
            episodes=100,
            gate_episodes=100,
            learners={
                task: {"updates": PAPER_EPISODES * own.episode_length, **PAPER}
                for task, own in SHEETS.items()
            },
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


def cells_of(asked: Experiment, dynamics: Dynamics = dynamics) -> list[Cell]:
    """All cells of what is asked for. Raises UserError where something does not exist or makes no sense."""
    return complete(asked).cells(dynamics)
