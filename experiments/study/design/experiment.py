"""What an experiment consists of, and the cells that it asks for."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Annotated, Any

import tyro

from agents.plugins import foreign
from agents.rules import CAUTIONS, POLICIES
from experiments.backends import BACKENDS
from experiments.study.design.arms import ARMS, DOSE_ARMS, EVERY_ARM, NUMBERED, PAIRS
from experiments.study.design.estimators import RULE, digest
from experiments.study.design.fingerprint import dynamics, learner_name
from experiments.study.design.grid import (
    LEARNER,
    Cell,
    choose_levels,
    choose_tasks,
    env_config,
    level_names,
)
from experiments.study.design.rules import RULES, TrainingRules
from experiments.study.design.sheet import GRID
from experiments.study.design.traffic import BETWEEN, TRAFFICS, UNSEEN, traffic_named, unseen_traffics
from experiments.support.errors import UserError, in_words, unknown
from sumo_env.tasks import TASKS

TRANSFER_EPISODES = {"highway-env": 20}  # in each traffic on another simulator at most: it is slow
ELSEWHERE = 200  # test episodes of a pair in each other traffic, at most
Dynamics = Callable[[str, str], str]
PLACEBO_SEEDS = 4  # control agents at least, to be dealt into two arms


def argument(metavar: str, default: str = "the preset's", help: str | None = None) -> Any:
    """How an option is shown in the help text."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})", help=help)


TaskNames = Annotated[
    tuple[str, ...], argument("TASK ...", f"the {len(GRID)} of the study", f"Some of {', '.join(TASKS)}.")
]


Flag = Annotated[bool, tyro.conf.arg(help_behavior_hint="")]
PRESETS_ALONE = (tyro.conf.Suppress, tyro.conf.Fixed)  # no option of a command


@dataclass(frozen=True)
class Experiment:
    """What an experiment consists of; what has its default is left to the preset (`presets.complete`).

    The sweep's options are one, so that the text below a field is the help of an option. Presets alone set about;
    learners: by task what differs from the defaults of `agents.dqn.DQNConfig` and of `rules.TrainingRules`;
    gate_episodes: episodes in each traffic for the gates, by default as many as test episodes;
    first_seed, first_scenario: where training seeds and test scenarios begin, so that studies share none.
    """

    backend: Annotated[str, argument("NAME", "sumo")] = "sumo"
    """Simulator: sumo, replica (highway-env's physics, compiled) or highway-env."""
    preset: Annotated[str, argument("NAME", "quick")] = "quick"
    """Size: smoke (a minute), quick (10 minutes), choice, study, paper (hours)."""
    tasks: TaskNames = ()
    levels: Annotated[tuple[int, ...], argument("LEVEL ...")] = ()
    """Traffic levels by number; 1 is the lightest."""
    seeds: Annotated[int | None, argument("N")] = None
    """Training seeds in each arm."""
    episodes: Annotated[int | None, argument("N")] = None
    """Test episodes in each of the two traffics."""
    updates: Annotated[int | None, argument("N")] = None
    """Training budget of an agent in updates, the same for all tasks."""
    arms: Annotated[tuple[str, ...], argument("ARM ...", "control treatment")] = ()
    """control, treatment, dose25, dose50, dose75 (tested at these too), mixed, told (mixed, the dose is observed)."""
    placebo: Flag = False
    """Train control agents alone, twice as many, and compare them with each other: no effect should be found."""
    test_on: Annotated[tuple[str, ...], argument("NAME ...", "none")] = ()
    """Other simulators on which the trained agents are tested as well."""
    unseen: Flag = False
    """Also test in unseen risky traffic: each kind of event alone, none, and SUMO's driver models Krauss and EIDM."""
    traffics: Annotated[tuple[str, ...], argument("NAME ...", "none")] = ()
    """Further traffics to test in: measured (drivers as published), or any other one by its name."""
    frontier: Flag = False
    """Test the careful driver at five cautions: with the constant policies, the crashes of a speed without learning."""
    pairs: Flag = False
    """Also test two agents together, of seeds k and k + half of the seeds: their Q-values averaged, by a belief too."""
    config: Annotated[tuple[str, ...], argument("KEY=VALUE ...", "none")] = ()
    """Keys of the environments' configuration to set, for training and test (values as in JSON, or plain words)."""
    crash_reward: Annotated[float | None, argument("X", "none")] = None
    """Added to the reward of a crash in training, in all arms (the two-way road's own has no term for crashes)."""
    learner: Annotated[str, argument("NAME", "dqn")] = LEARNER
    """Who learns: dqn, sb3-dqn, sb3-ppo, or FILE:NAME for a learner of your own; for as many steps as dqn would."""
    settings: Annotated[tuple[str, ...], argument("KEY=VALUE ...")] = ()
    """Settings of the learner, for example gamma=0.9 or device=cuda (all: agents/dqn.py, agents/stable.py)."""
    network: Annotated[str | None, argument("NAME")] = None
    """Network of the agents: attention, dueling, or FILE:CLASS for a class of your own."""
    policy: Annotated[tuple[str, ...], argument("FILE:MAKE ...", "none")] = ()
    """Policies of your own to test as well: FILE:MAKE, or a model.zip of Stable-Baselines3."""
    about: Annotated[str, *PRESETS_ALONE] = ""
    learners: Annotated[Mapping[str, Mapping[str, Any]] | None, *PRESETS_ALONE] = None
    gate_episodes: Annotated[int | None, *PRESETS_ALONE] = None
    first_seed: Annotated[int, *PRESETS_ALONE] = 0
    first_scenario: Annotated[int, *PRESETS_ALONE] = 0

    @in_words()
    def cells(self, dynamics: Dynamics = dynamics) -> list[Cell]:
        """All of its cells: on each task and level the agents, their further tests, and the baselines.

        Args:
            dynamics: what a cell's key says of a simulator's behaviour, from (backend, task). By default a simulator
                drives a task that `fingerprints.json` does not know.

        Raises:
            UserError: something does not exist or makes no sense.
        """
        for name in (self.backend, *self.test_on):
            if name not in BACKENDS:
                raise unknown("backend", name, BACKENDS)
        tasks = choose_tasks(self.tasks or tuple(GRID))
        levels = choose_levels(tasks, self.levels or None)
        policies = {label: (source, digits) for source in self.policy for label, digits in [foreign(source)]}
        drivers = dict.fromkeys((*POLICIES, *(CAUTIONS if self.frontier else ())))
        cells: list[Cell] = []
        for task, level in ((task, level) for task, numbers in levels.items() for level in numbers):
            common = self._common(task, level, dynamics)
            agents = list(self._agents(common))
            cells += agents
            cells += [test for agent in agents for test in self._further_tests(agent, dynamics)]
            cells += self._pairs(agents) if self.pairs else []
            cells += [replace(common, policy=name) for name in drivers]
            for label, (source, digits) in policies.items():
                profile = {**common.profile, "policy_sha256": digits}
                cells.append(replace(common, policy=label, source=source, profile=profile))
        for option, is_answered in self._answers(cells):
            if not is_answered:
                raise UserError(f"{option} asks for nothing here: leave it out")
        return cells

    def _answers(self, cells: Sequence[Cell]) -> Iterator[tuple[str, bool]]:
        """What is asked for by name, and whether there is a cell of it."""
        tests = [cell for cell in cells if cell.kind == "test"]
        for task in self.tasks:
            yield f"--tasks {task}", any(cell.task == task for cell in cells)
        for name in self.test_on:
            yield f"--test-on {name}", any(cell.runs_on == name != self.backend for cell in tests)
        if self.unseen:
            yield "--unseen", any(set(cell.tested["traffics"]) <= set(UNSEEN) for cell in tests)
        if self.pairs:
            yield "--pairs", any(cell.pair for cell in tests)

    def _common(self, task: str, level: int, dynamics: Dynamics) -> Cell:
        """What the cells of a task and level have in common, as a baseline without a policy."""
        episodes = self.episodes or 0
        if episodes < 1:
            raise UserError(f"at least one test episode is needed, not {episodes}")
        gates = episodes if self.gate_episodes is None else self.gate_episodes
        # Not in the names of cells that begin at 0, which are older than the choice.
        first = {"first_scenario": self.first_scenario} if self.first_scenario else {}
        return Cell(
            kind="baseline",
            backend=self.backend,
            task=task,
            level=level,
            level_name=level_names(task)[level - 1],
            arm=None,
            seed=None,
            policy="",
            profile={"preset": self.preset},
            env_config=env_config(self.backend, task, level, self._changes),
            eval={"episodes": episodes, "gate_episodes": gates, **first},
            dynamics=dynamics(self.backend, task),
        )

    def _agents(self, common: Cell) -> Iterator[Cell]:
        """The agents of a task and level: every arm of each training seed."""
        seeds, arms = self.seeds or 0, dict.fromkeys(self.arms or ARMS)
        if seeds < 1:
            raise UserError(f"at least one seed is needed, not {seeds}")
        if self.placebo:
            if self.arms:
                raise UserError("--placebo trains control agents alone: leave out --arms")
            seeds, arms = max(2 * seeds, PLACEBO_SEEDS), {"control": None}
        for arm in arms:
            if arm not in EVERY_ARM:
                raise unknown("arm", arm, EVERY_ARM)
        for seed in (self.first_seed, self.first_seed + seeds - 1):
            if seed not in NUMBERED:
                raise UserError(f"the number of a training is from 0 to {NUMBERED[-1]}, not {seed}")
        profile = self.profile(common.task)
        for seed in range(self.first_seed, self.first_seed + seeds):
            for arm in arms:
                yield replace(
                    common,
                    kind="agent",
                    arm=arm,
                    seed=seed,
                    policy=self._own_learner[0] if self._own_learner else self.learner,
                    profile={**common.profile, **profile, **EVERY_ARM[arm].rules},
                    source=self.learner if self._own_learner else self._own_network,
                )

    def _further_tests(self, agent: Cell, dynamics: Dynamics) -> Iterator[Cell]:
        """Further tests of an agent: at doses between 0 and 1, in unseen risk, on other simulators."""
        if set(self.arms) & set(BETWEEN) and agent.arm in DOSE_ARMS:
            yield _tested(agent, BETWEEN)
        if self.unseen and (unseen := unseen_traffics(agent.task, self.backend)):
            yield _tested(agent, unseen)
        if self.traffics:
            further = {name: traffic_named(name) for name in self.traffics}
            if self.backend != "sumo" and any(traffic.is_of_sumo for traffic in further.values()):
                raise UserError(f"--traffics {' '.join(further)} has drivers that {self.backend} has not")
            yield _tested(agent, further)
        for other in dict.fromkeys(self.test_on):
            if other != self.backend:
                config = env_config(other, agent.task, agent.level, self._changes)
                where = {"backend": other, "env_config": config, "dynamics": dynamics(other, agent.task)}
                yield _tested(agent, TRAFFICS, TRANSFER_EPISODES.get(other), **where)

    def _pairs(self, agents: Sequence[Cell]) -> Iterator[Cell]:
        """The tests of two agents together; those that are told nothing also elsewhere."""
        by_place = {(agent.arm, agent.seed): agent for agent in agents}
        half = (self.seeds or 0) // 2
        for first, (name, pair) in product(range(self.first_seed, self.first_seed + half), PAIRS.items()):
            one, other = (by_place.get(place) for place in zip(pair.arms, (first, first + half), strict=True))
            if one is None or other is None:
                continue
            made: dict[str, Any] = {"agents": [one.name, other.name], "weight": pair.weight}
            if pair.weight in ("belief", "shuffled"):
                made |= {"rule": list(RULE), "estimator_sha256": digest(one)}
            both = replace(one, arm=name, pair=made)
            yield _tested(both, TRAFFICS)
            if pair.weight in ("half", "belief"):
                yield _tested(both, BETWEEN, ELSEWHERE)
                yield _tested(both, unseen_traffics(one.task, one.backend), ELSEWHERE)

    def profile(self, task: str) -> dict[str, Any]:
        """Every setting of the learner on a task and the rules of its training, as plain values.

        Raises ValueError for a name that there is not, or a value that makes no sense.
        """
        from agents.dqn import DQNConfig  # here: not every command needs the learner
        from agents.learner import settings_of
        from agents.learners import learner
        from agents.models import network_class

        said = {**(self.learners or {})[task]}
        rules = TrainingRules(**{name: said.pop(name) for name in RULES if name in said})
        if self.crash_reward is not None:
            if not math.isfinite(self.crash_reward):
                raise UserError(f"the reward of a crash has to be a finite number, not {self.crash_reward}")
            rules = replace(rules, crash_reward=self.crash_reward)
        asked = {"updates": self.updates, "network": self.network}
        files = {}
        if self.learner != LEARNER:  # of the preset's settings, the number of steps is everybody's
            said = {"steps": settings_of(DQNConfig, said, f"the learner {LEARNER}").steps}
        said |= {name: value for name, value in asked.items() if value is not None}
        said |= _assignments(self.settings, "--settings", "gamma=0.9")
        if self._own_network:
            said["network"], files["network_sha256"] = foreign(self._own_network)
        if self._own_learner:
            files["learner_sha256"] = self._own_learner[1]
        chosen = learner(self.learner)
        settings = settings_of(chosen.Settings, said, f"the learner {self.learner}")
        if not self._own_network and hasattr(settings, "network"):
            network_class(settings.network)
        found = asdict(settings)
        if name := learner_name(self.learner, found):
            files["learner_dynamics"] = name
        return {**found, **rules.entries(), **files}

    @property
    def _own_network(self) -> str | None:
        """FILE:CLASS of a network of the user's own."""
        return self.network if ":" in (self.network or "") else None

    @property
    def _own_learner(self) -> tuple[str, str] | None:
        """Label and fingerprint of a learner of the user's own."""
        return foreign(self.learner) if ":" in self.learner else None

    @property
    def _changes(self) -> dict[str, Any]:
        """Of config=("collision_reward=-2", "risk_law=linear")."""
        return _assignments(self.config, "--config", "collision_reward=-2")


def _tested(agent: Cell, traffics: Iterable[str], most: int | None = None, **where: Any) -> Cell:
    """A further test of an agent in some traffics, with its own number of episodes or so many at most."""
    episodes = agent.episodes if most is None else min(agent.episodes, most)
    here = {"backend": agent.backend, "env_config": agent.env_config, **where}
    return replace(agent, kind="test", test_on={**here, "traffics": list(traffics), "episodes": episodes})


def _assignments(texts: Sequence[str], option: str, example: str) -> dict[str, Any]:
    """The values of an option that takes KEY=VALUE, as in JSON or plain words. Raises UserError for another form."""
    found: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise UserError(f"{option} takes KEY=VALUE, for example {example}, not {text!r}")
        try:
            found[name] = json.loads(value)
        except ValueError:
            found[name] = value
    return found


def shard(cells: Sequence[Cell], text: str) -> list[Cell]:
    """The part "i/n" of the cells (i from 1 to n), dealt out by task and level so that cohorts stay together.

    Raises:
        UserError: not of that form.
    """
    index, slash, count = text.partition("/")
    if not (slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
        raise UserError(f"--shard takes i/n with 1 <= i <= n, for example 1/4, not {text!r}")
    units = [(cell.task, cell.level, cell.seed) for cell in cells]
    order = {unit: number for number, unit in enumerate(dict.fromkeys(units))}
    return [
        cell for cell, unit in zip(cells, units, strict=True) if order[unit] % int(count) == int(index) - 1
    ]
