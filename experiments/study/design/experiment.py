"""What an experiment consists of, and the cells that it asks for."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any, TypeVar

import tyro

from agents.learner import settings_of
from agents.plugins import foreign
from agents.policies import foreign_policy
from agents.rules import CAUTIONS, DRIVERS, POLICIES
from experiments.backends import BACKENDS, MakeEnv, make_env
from experiments.study.design.arms import ARMS, DOSE_ARMS, EVERY_ARM, NUMBERED
from experiments.study.design.cell import LEARNER, Cell, tested_on
from experiments.study.design.fingerprint import dynamics, learner_name
from experiments.study.design.levels import (
    StudyTasks,
    choose_levels,
    choose_tasks,
    env_config,
    level_names,
    with_features,
)
from experiments.study.design.sheet import Sheet, sheet, task_of
from experiments.study.design.traffic import BETWEEN, TRAFFICS, traffic_named, unseen_traffics
from experiments.study.design.training_rules import RULES, TrainingRules
from experiments.support.arguments import Flag, argument
from experiments.support.errors import UserError, check_known, in_words

TRANSFER_EPISODES = {"highway-env": 20}  # in each traffic on another simulator at most: it is slow
MOST = {"planner": 40, "clairvoyant": 40}  # test episodes in each traffic at most, of drivers that take long
Dynamics = Callable[[str, str], str]
MOST_SEEDS = 1000  # in an arm: beyond, only listing the cells takes minutes
PLACEBO_SEEDS = 4  # control agents at least, to be dealt into two arms


T = TypeVar("T")
Hidden = Annotated[T, tyro.conf.Suppress, tyro.conf.Fixed]  # a preset's alone, no option
Names = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """All that an experiment consists of, and the options of a sweep: a preset (`presets`), and what is changed of it.
    The text below a field is its help.

    learners: by sheet what differs from the defaults of `agents.dqn.DQNConfig` and of `TrainingRules`, before
    updates, network, settings and crash_reward, which are the same for all tasks. gate_episodes: episodes in each
    traffic for the gates. further_episodes: of a further test in each traffic, at most. lightest: further traffics, for
    the lightest level alone (of SUMO's drivers on SUMO). levels_of: by task the levels, where none are
    named; by default all of the tasks of the study.
    """

    preset: Annotated[str, argument("NAME")]
    """Size: smoke (a minute), quick (10 to 20 minutes), study, paper (hours). All defaults below are this one's."""
    about: Hidden[str]
    learners: Hidden[Callable[[Sheet], Mapping[str, Any]]]
    backend: Annotated[str, argument("NAME")] = "sumo"
    """Simulator: sumo, replica (highway-env's physics, compiled) or highway-env."""
    tasks: StudyTasks = ()
    levels: Annotated[tuple[int, ...], argument("LEVEL ...", "all")] = ()
    """Traffic levels by number; 1 is the lightest."""
    seeds: Annotated[int, argument("N")]
    """Training seeds in each arm."""
    first_seed: Annotated[int, argument("N")] = 0
    """Number of the first training seed, so that studies share none."""
    episodes: Annotated[int, argument("N")]
    """Test episodes in each of the two traffics."""
    first_scenario: Annotated[int, argument("N")] = 0
    """Number of the first test scenario."""
    gate_episodes: Hidden[int]
    updates: Annotated[int | None, argument("N", "by task")] = None
    """Training budget of an agent in updates, the same for all tasks."""
    arms: Annotated[Names, argument("ARM ...", "control treatment")] = ()
    """control, treatment, dose25, dose50, dose75 (tested at these too), mixed, told (mixed, the dose is observed),
    no-brake, no-cut-in (treatment without these events)."""
    placebo: Flag = False
    """Train control agents alone, twice as many, and compare them with each other: no effect should be found."""
    test_on: Annotated[Names, argument("NAME ...")] = ()
    """Other simulators on which the trained agents are tested as well."""
    unseen: Flag = False
    """Also test in unseen risky traffic: each kind of event alone, none, and SUMO's driver models Krauss and EIDM."""
    traffics: Annotated[Names, argument("NAME ...")] = ()
    """Further traffics to test in: measured (drivers as published), or any other one by its name."""
    frontier: Flag = False
    """Test the careful driver at five cautions: with the constant policies, the crashes of a speed without learning."""
    drivers: Annotated[Names, argument("NAME ...")] = ()
    """Drivers to test as well, in the lightest traffic: planner, clairvoyant, and on SUMO sumo (its own driver)."""
    config: Annotated[Names, argument("KEY=VALUE ...")] = ()
    """Keys of the environments' configuration to set, for training and test (values as in JSON, or plain words);
    observation.features=[...] sets one key of an entry."""
    features: Annotated[Names, argument("NAME ...")] = ()
    """What agents observe of each vehicle beside the task's own features (docs/environments/common.md)."""
    crash_reward: Annotated[float | None, argument("X")] = None
    """Added to the reward of a crash in training, in all arms (the two-way road's own has no term for crashes)."""
    learner: Annotated[str, argument("NAME")] = LEARNER
    """Who learns: dqn, sb3-dqn, sb3-ppo, or FILE:NAME for a learner of your own; for as many steps as dqn would."""
    settings: Annotated[Names, argument("KEY=VALUE ...", "the learner's")] = ()
    """Settings of the learner, for example gamma=0.9 or device=cuda (all: agents/dqn.py, agents/sb3.py), and rules of
    the training, for example training_clock=[15,15] (experiments/study/design/training_rules.py)."""
    network: Annotated[str | None, argument("NAME", "the learner's")] = None
    """Network of the agents: attention, dueling, or FILE:CLASS for a class of your own."""
    policy: Annotated[Names, argument("FILE:MAKE ...")] = ()
    """Policies of your own to test as well: FILE:MAKE, or a model.zip of Stable-Baselines3."""
    further_episodes: Hidden[int | None] = None
    lightest: Hidden[Names] = ()
    levels_of: Hidden[Mapping[str, tuple[int, ...]]] = field(default_factory=dict)

    @in_words()
    def cells(self, dynamics: Dynamics = dynamics, make_env: MakeEnv = make_env) -> list[Cell]:
        """All of its cells: on each task and level the agents, their further tests, and the baselines.

        Args:
            make_env: of `backends`, or another; for policies of the user's own.
            dynamics: what a cell's key says of a simulator's behaviour, from (backend, task). By default a simulator
                drives a task that `fingerprints.json` does not know.

        Raises:
            UserError: something does not exist or makes no sense.
        """
        check_known("backend", (self.backend, *self.test_on), BACKENDS)
        tasks = choose_tasks(self.tasks or tuple(self.levels_of), variants=True)
        levels = choose_levels(tasks, self.levels)
        if not self.levels:
            levels |= {task: numbers for task, numbers in self.levels_of.items() if task in tasks}
        policies = self._policies()
        check_known("driver", self.drivers, DRIVERS)
        rules = dict.fromkeys((*POLICIES, *(CAUTIONS if self.frontier else ())))
        cells: list[Cell] = []
        for task, level in ((task, level) for task, numbers in levels.items() for level in numbers):
            common = self._common(task, level, dynamics)
            agents = list(self._agents(common))
            cells += agents
            cells += [
                replace(agent, kind="test", test_on=test)
                for agent in agents
                for test in self._further_tests(agent, dynamics)
            ]
            cells += [replace(common, policy=name) for name in rules]
            for name in dict.fromkeys(self.drivers) if level == 1 else ():
                if name != "sumo" or self.backend == "sumo":
                    test = tests_of(common, TRAFFICS, MOST.get(name))
                    cells.append(replace(common, policy=name, test_on=test))
            for label, source in policies.items():
                with closing(make_env(*tested_on(common.key()))) as env:
                    profile = {**common.profile, "policy_sha256": foreign_policy(source, env)[1]}
                cells.append(replace(common, policy=label, source=source, profile=profile))
        return cells

    def _common(self, task: str, level: int, dynamics: Dynamics) -> Cell:
        """What the cells of a task and level have in common, as a baseline without a policy."""
        if self.episodes < 1:
            raise UserError(f"at least one test episode is needed, not {self.episodes}")
        if self.first_scenario not in NUMBERED:
            raise UserError(
                f"the number of a scenario is from 0 to {NUMBERED[-1]}, not {self.first_scenario}"
            )
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
            env_config=env_config(self.backend, task, level, self._changes(task)),
            eval={
                "episodes": self.episodes,
                "gate_episodes": self.gate_episodes,
                "first_scenario": self.first_scenario,
            },
            dynamics=dynamics(self.backend, task_of(task)),
        )

    def _policies(self) -> dict[str, str]:
        """The policies of the user's own by their labels. Raises UserError for two of one label."""
        found: dict[str, str] = {}
        for source in dict.fromkeys(self.policy):
            label, _ = foreign(source)
            if label in found:
                raise UserError(
                    f"{found[label]} and {source} are both called {label} in results: rename one of them"
                )
            found[label] = source
        return found

    def _agents(self, common: Cell) -> Iterator[Cell]:
        """The agents of a task and level: every arm of each training seed."""
        seeds, arms = self.seeds, dict.fromkeys(self.arms or ARMS)
        if seeds < 1:
            raise UserError(f"at least one seed is needed, not {seeds}")
        if seeds > MOST_SEEDS:
            raise UserError(f"at most {MOST_SEEDS:,} seeds are trained by one sweep, not {seeds:,}")
        if self.placebo:
            if self.arms:
                raise UserError("--placebo trains control agents alone: leave out --arms")
            seeds, arms = max(2 * seeds, PLACEBO_SEEDS), {"control": None}
        check_known("arm", arms, EVERY_ARM)
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

    def _further_tests(self, agent: Cell, dynamics: Dynamics) -> Iterator[dict[str, Any]]:
        """The further tests of an agent: in further traffics, each in one test alone, and on other simulators."""
        most, on_sumo = self.further_episodes, self.backend == "sumo"
        asked = {name: traffic_named(name) for name in (*self.lightest, *self.traffics)}
        if not on_sumo and any(asked[name].is_of_sumo for name in self.traffics):
            raise UserError(f"--traffics {' '.join(self.traffics)} has drivers that {self.backend} has not")
        lightest = [name for name in self.lightest if on_sumo or not asked[name].is_of_sumo]
        tested = {*TRAFFICS}  # in its own test
        for traffics, is_asked in (
            (BETWEEN, bool(set(self.arms) & set(BETWEEN)) and agent.arm in DOSE_ARMS),
            (lightest, agent.level == 1 and agent.arm in ARMS),
            (unseen_traffics(agent.task, self.backend), self.unseen),
            (self.traffics, True),
        ):
            if is_asked and (new := [name for name in dict.fromkeys(traffics) if name not in tested]):
                tested.update(new)
                yield tests_of(agent, new, most)
        for other in dict.fromkeys(self.test_on):
            if other != self.backend:
                config = env_config(other, agent.task, agent.level, self._changes(agent.task))
                where = {
                    "backend": other,
                    "env_config": config,
                    "dynamics": dynamics(other, task_of(agent.task)),
                }
                yield tests_of(agent, TRAFFICS, TRANSFER_EPISODES.get(other, most), **where)

    def profile(self, task: str) -> dict[str, Any]:
        """Every setting of the learner on a task and the rules of its training, as plain values.

        Raises ValueError for a name that there is not, or a value that makes no sense.
        """
        from agents.dqn import DQNConfig  # here: not every command needs the learner
        from agents.learners import learner
        from agents.models import network_class

        said = {**self.learners(sheet(task))}
        ruled = {name: said.pop(name) for name in RULES if name in said}
        asked = {"updates": self.updates, "network": self.network}
        files = {}
        if self.learner != LEARNER:  # of the preset's settings, the number of steps is everybody's
            said = {"steps": settings_of(DQNConfig, said, f"the learner {LEARNER}").steps}
        said |= {name: value for name, value in asked.items() if value is not None}
        said |= assignments(self.settings, "--settings", "gamma=0.9")
        ruled |= {name: said.pop(name) for name in RULES if name in said}
        if self.crash_reward is not None:
            ruled["crash_reward"] = self.crash_reward
        rules = TrainingRules(**ruled)
        if self.learner == LEARNER and rules.training_clock:
            frequency = env_config(self.backend, task, 1, self._changes(task))["policy_frequency"]
            said.setdefault("horizon", rules.training_clock[1] * frequency)
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

    def _changes(self, task: str) -> dict[str, Any]:
        """Of config=("collision_reward=-2", "risk_law=linear"), and what is observed where that does not say it."""
        asked = assignments(self.config, "--config", "collision_reward=-2")
        is_said = {"observation", "observation.features"} & {*asked}
        return asked if is_said else with_features(task, self.features) | asked


def tests_of(cell: Cell, traffics: Iterable[str], most: int | None = None, **where: Any) -> dict[str, Any]:
    """What a further test of a cell is: in some traffics, with its own number of episodes or so many at most."""
    here = {"backend": cell.backend, "env_config": cell.env_config, **where}
    episodes = cell.eval["episodes"]
    return {**here, "traffics": list(traffics), "episodes": min(episodes, most or episodes)}


def assignments(texts: Sequence[str], option: str, example: str) -> dict[str, Any]:
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
