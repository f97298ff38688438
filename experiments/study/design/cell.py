"""The cell of an experiment as data, its name, and what the name is made of.

A cell is named by what it computes: a readable slug and a hash of its complete key, the fingerprint of the simulator's
behaviour included, and of the versions that can change a result. Results of other dynamics therefore never mix, and
adding tasks, levels or seeds never renames a cell that is there already.
"""

import importlib.metadata
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, Self

from agents.learner import Learner, settings_of
from experiments.backends import SIMULATORS
from experiments.study.design.arms import ARMS, gate_traffics
from experiments.study.design.sheet import task_of
from experiments.study.design.traffic import BETWEEN, TRAFFICS
from experiments.study.design.training_rules import TrainingRules
from experiments.support.errors import UserError, in_words
from experiments.support.files import digest_of

RESULT_SCHEMA = 5  # raise it with every change that makes stored results mean, or be, something else
LEARNER = "dqn"  # of the published studies


@dataclass(frozen=True)
class Cell:
    """One unit of the experiment: a trained agent with its test, the test of a policy that does not learn, or a further
    test of an agent that another cell has trained.

    kind: "agent", "baseline" or "test". task: may be a variant (`sheet.VARIANTS`). level: 1 is the lightest traffic.
    arm, seed: None for baselines. policy: name of the learner or of the policy. profile: every setting of the learner
        and the rules of its training (`training_rules.TrainingRules`); for baselines only the preset's name.
    env_config: the environment's configuration, without the dose of risk. eval: episodes of the test and for the gates
        (in each traffic, on other scenarios), and number of the first scenario.
    dynamics: fingerprint of what the backend does on this task, see `fingerprint.dynamics`.
    test_on: of a further test its backend, env_config, traffics and episodes.
    source: where the network or policy of the user's own lies, FILE:NAME or a zip file. Not part of the key, which has
        the file's fingerprint.
    """

    kind: str
    backend: str
    task: str
    level: int
    level_name: str
    arm: str | None
    seed: int | None
    policy: str
    profile: Mapping[str, Any]
    env_config: Mapping[str, Any]
    eval: Mapping[str, Any]
    dynamics: str
    source: str | None = None
    test_on: Mapping[str, Any] | None = None

    def key(self) -> dict[str, Any]:
        """All of it as plain JSON values; what cell.json stores."""
        return {
            name: dict(value) if isinstance(value, Mapping) else value
            for name, value in vars(self).items()
            if name != "source" and (value or name != "test_on")
        }

    @property
    def name(self) -> str:
        """Name of the cell's directory, "<slug>-<hash of 12 digits>"."""
        return cell_name(self.key(), self.versions)

    @property
    def versions(self) -> dict[str, Any]:
        """The versions that can change its result. Raises UserError where a package is not installed."""
        settings = None if self.kind == "baseline" else learner_of(self.key(), self.source)[1]
        simulators = SIMULATORS[self.backend], SIMULATORS[self.runs_on]
        own = getattr(settings, "packages", ())
        names = ("sumo-risky-driving", *simulators, "numpy", "torch", *own)
        return {"schema": RESULT_SCHEMA, **{name: installed(name) for name in names}}

    @property
    def tested(self) -> Mapping[str, Any]:
        """How it is tested: backend, env_config, traffics, and episodes in each of them."""
        return {**self.eval, **test_of(self.key())}

    @property
    def runs_on(self) -> str:
        """The simulator that the tests run on."""
        return str(self.tested["backend"])

    @property
    def simulated(self) -> tuple[tuple[str, str], ...]:
        """What is simulated for it, as (backend, task): in training, and in the test."""
        return (self.backend, task_of(self.task)), (self.runs_on, task_of(self.task))

    @property
    def parent(self) -> Self:
        """The cell that has trained the agent of a further test."""
        return replace(self, kind="agent", test_on=None)

    @property
    def slug(self) -> str:
        """The readable part of the name, for example "sumo-highway-50-control-s0"."""
        return slug(self.key())

    @property
    def rules(self) -> TrainingRules:
        """The rules of its training."""
        return TrainingRules.of(self.profile)

    @property
    def budget(self) -> tuple[int, int]:
        """Environment steps and gradient updates of its training (0 where nothing is trained)."""
        if self.kind != "agent":
            return 0, 0
        _, settings = learner_of(self.key(), self.source)
        return settings.steps, settings.updates

    @property
    def work(self) -> int:
        """Episodes that are played after the training, in all traffics."""
        gates = 0 if self.test_on else len(gate_traffics(self.arm)) * int(self.eval["gate_episodes"])
        return len(self.tested["traffics"]) * int(self.tested["episodes"]) + gates


@in_words()
def learner_of(key: Mapping[str, Any], source: str | None) -> tuple[Learner, Any]:
    """The learner of an agent's cell, and its settings.

    Args:
        source: FILE:NAME of the user's own learner or network, if there is one: as the user has named it, never as a
            stored record does.

    Raises:
        UserError: the user's file is not named, not there or does not fit.
    """
    from agents.learners import learner  # here: not every command needs a learner

    def here(name: str) -> str:
        """The name, or the file that the user has named in the place of a label such as mine.py:Mine."""
        if ":" not in name:
            return name
        if source is None:
            raise UserError(
                f"{name} is code of somebody's own, which a stored cell alone never runs: read the file, then name it "
                "(replay.py has --code FILE:NAME; evaluate.py takes FILE:MAKE, which may load the weights)"
            )
        return source

    profile = key["profile"]
    found = learner(here(key["policy"]))
    names = {field.name for field in fields(found.Settings)}
    values = {name: value for name, value in profile.items() if name in names}
    if "network" in values:
        values["network"] = here(values["network"])
    return found, settings_of(found.Settings, values, f"the learner {key['policy']}")


def test_of(key: Mapping[str, Any]) -> dict[str, Any]:
    """The key of a cell, with the backend, dynamics, env_config and traffics that it is tested in."""
    return {**key, "traffics": TRAFFICS, **(key.get("test_on") or {})}


def tested_on(key: Mapping[str, Any]) -> tuple[str, str, dict[str, Any]]:
    """Backend, task and configuration of the environment that a cell is tested in, as `make_env` takes them."""
    where = test_of(key)
    return where["backend"], task_of(key["task"]), dict(where["env_config"])


def setting(key: Mapping[str, Any]) -> str:
    """The first part of a cell's name: backend, task and level, for example "sumo-highway-50"."""
    return f"{key['backend']}-{key['task']}-{key['level_name']}"


def slug(key: Mapping[str, Any]) -> str:
    """The readable part of a cell's name."""
    policy = key["policy"].replace(":", ".")
    last = f"{key['arm']}-s{key['seed']}" if key["arm"] else policy
    if key["arm"] and key["policy"] != LEARNER:
        last += f"-{policy}"
    if test_on := key.get("test_on"):
        elsewhere = test_on["backend"] != key["backend"]
        traffics = set(test_on["traffics"])
        here = "" if traffics <= set(TRAFFICS) else "-doses" if traffics <= set(BETWEEN) else "-unseen"
        last += f"-on-{test_on['backend']}" if elsewhere else here
    return f"{setting(key)}-{last}"


def setting_of_agent(name: str) -> str:
    """The setting in the name of a cell that trains an agent of one of both arms; empty for any other cell."""
    # behind the seed stands the learner, if it is not LEARNER, and then what a further test is of
    found = re.fullmatch(rf"(.+)-({'|'.join(ARMS)})-s\d+(-.+)?-[0-9a-f]+", name)
    is_test = found and re.search(r"-(doses|unseen|on-[a-z-]+)$", found[3] or "")
    return found[1] if found and not is_test else ""


def cell_name(key: Mapping[str, Any], version: Mapping[str, Any]) -> str:
    """Name of the cell with this key under these versions.

    The preset's name is a label: the same computation asked for by two presets is one cell.
    """
    profile = {name: value for name, value in key["profile"].items() if name != "preset"}
    digest = digest_of({"key": {**key, "profile": profile}, "versions": dict(version)})
    return f"{slug(key)}-{digest[:12]}"


@cache
def installed(package: str) -> str:
    """Version of an installed package, without a build tag ("2.13.0+cpu" computes what "2.13.0" does)."""
    try:
        return importlib.metadata.version(package).partition("+")[0]
    except importlib.metadata.PackageNotFoundError:
        raise UserError(
            f"the package {package} is not installed: run make setup, then use .venv/bin/python"
        ) from None
