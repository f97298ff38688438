"""From what a user asks for to cells: options (None where one is left to the preset) -> an experiment -> its cells."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

import tyro

from experiments.backends import MakeEnv, make_env
from experiments.study.design.cell import Cell
from experiments.study.design.experiment import Dynamics, Experiment
from experiments.study.design.fingerprint import dynamics
from experiments.study.design.presets import PRESETS
from experiments.study.design.sheet import GRID
from experiments.study.design.traffic import UNSEEN
from experiments.support.errors import UserError, check_known
from sumo_env.tasks import TASKS


def argument(metavar: str, default: str = "the preset's", help: str | None = None) -> Any:
    """How an option is shown in the help text."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})", help=help)


TASK = argument("TASK ...", f"the {len(GRID)} of the study", f"Some of {', '.join(TASKS)}.")
TaskNames = Annotated[tuple[str, ...], TASK]
Names = tuple[str, ...] | None
Flag = Annotated[bool | None, tyro.conf.arg(metavar="", help_behavior_hint="")]  # see `support.arguments`


@dataclass(frozen=True)
class Asked:
    """The options of a sweep as they are given; the text below one is its help."""

    backend: Annotated[str | None, argument("NAME", "sumo")] = None
    """Simulator: sumo, replica (highway-env's physics, compiled) or highway-env."""
    preset: Annotated[str, argument("NAME", "quick")] = "quick"
    """Size: smoke (a minute), quick (10 minutes), study, paper (hours)."""
    tasks: Annotated[Names, TASK] = None
    levels: Annotated[tuple[int, ...] | None, argument("LEVEL ...")] = None
    """Traffic levels by number; 1 is the lightest, none are all."""
    seeds: Annotated[int | None, argument("N")] = None
    """Training seeds in each arm."""
    episodes: Annotated[int | None, argument("N")] = None
    """Test episodes in each of the two traffics."""
    updates: Annotated[int | None, argument("N")] = None
    """Training budget of an agent in updates, the same for all tasks."""
    arms: Annotated[Names, argument("ARM ...", "control treatment")] = None
    """control, treatment, dose25, dose50, dose75 (tested at these too), mixed, told (mixed, the dose is observed),
    no-brake, no-cut-in (treatment without these events)."""
    placebo: Flag = None
    """Train control agents alone, twice as many, and compare them with each other: no effect should be found."""
    test_on: Annotated[Names, argument("NAME ...", "none")] = None
    """Other simulators on which the trained agents are tested as well."""
    unseen: Flag = None
    """Also test in unseen risky traffic: each kind of event alone, none, and SUMO's driver models Krauss and EIDM."""
    traffics: Annotated[Names, argument("NAME ...", "none")] = None
    """Further traffics to test in: measured (drivers as published), or any other one by its name."""
    frontier: Flag = None
    """Test the careful driver at five cautions: with the constant policies, the crashes of a speed without learning."""
    drivers: Annotated[Names, argument("NAME ...", "none")] = None
    """Drivers to test as well, in the lightest traffic: planner, clairvoyant, and on SUMO sumo (its own driver)."""
    config: Annotated[Names, argument("KEY=VALUE ...", "none")] = None
    """Keys of the environments' configuration to set, for training and test (values as in JSON, or plain words)."""
    crash_reward: Annotated[float | None, argument("X", "none")] = None
    """Added to the reward of a crash in training, in all arms (the two-way road's own has no term for crashes)."""
    learner: Annotated[str | None, argument("NAME", "dqn")] = None
    """Who learns: dqn, sb3-dqn, sb3-ppo, or FILE:NAME for a learner of your own; for as many steps as dqn would."""
    settings: Annotated[Names, argument("KEY=VALUE ...")] = None
    """Settings of the learner, for example gamma=0.9 or device=cuda (all: agents/dqn.py, agents/sb3.py)."""
    network: Annotated[str | None, argument("NAME")] = None
    """Network of the agents: attention, dueling, or FILE:CLASS for a class of your own."""
    policy: Annotated[Names, argument("FILE:MAKE ...", "none")] = None
    """Policies of your own to test as well: FILE:MAKE, or a model.zip of Stable-Baselines3."""

    @property
    def experiment(self) -> Experiment:
        """All of it: for what is not asked what the preset says; arms that are asked for are all.

        Raises:
            UserError: there is no such preset, or two options contradict each other.
        """
        check_known("preset", [self.preset], PRESETS)
        if self.placebo and self.arms:
            raise UserError("--placebo trains control agents alone: leave out --arms")
        given = {field.name: getattr(self, field.name) for field in fields(Asked)}
        found = replace(PRESETS[self.preset], **{name: v for name, v in given.items() if v is not None})
        return replace(found, at_ends={}) if self.arms or self.placebo else found

    def cells(self, dynamics: Dynamics = dynamics, make_env: MakeEnv = make_env) -> list[Cell]:
        """All cells of the experiment. Raises UserError where something does not exist, or asks for nothing."""
        cells = self.experiment.cells(dynamics, make_env)
        for option, is_answered in self._answers(cells):
            if not is_answered:
                raise UserError(f"{option} asks for nothing here: leave it out")
        return cells

    def _answers(self, cells: Sequence[Cell]) -> Iterator[tuple[str, bool]]:
        """What is asked for by name, and not by the preset alone, and whether there is a cell of it."""
        tests = [cell for cell in cells if cell.kind == "test"]
        for task in self.tasks or ():
            yield f"--tasks {task}", any(cell.task == task for cell in cells)
        for name in self.test_on or ():
            yield f"--test-on {name}", any(cell.runs_on == name != cell.backend for cell in tests)
        for name in self.drivers or ():
            yield f"--drivers {name}", any(cell.policy == name for cell in cells)
        for name in self.traffics or ():
            of_agents = (cell for cell in tests if cell.runs_on == cell.backend)
            yield f"--traffics {name}", any(name in cell.tested["traffics"] for cell in of_agents)
        if self.unseen:
            yield "--unseen", any(set(cell.tested["traffics"]) <= set(UNSEEN) for cell in tests)
