"""The grid of the experiment as data: cells, their names, and what their names are made of.

A cell is named by what it computes: a readable slug and a hash of its complete key and of the versions that
can change a result. Adding tasks, levels or seeds to the grid therefore never renames a cell that is there
already.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from experiments.support.errors import UserError, unknown
from experiments.support.files import canonical_json, sha256_bytes
from sumo_env.config import resolve
from sumo_env.tasks import TASKS

RESULT_SCHEMA = 3  # raise it with every change that makes stored results mean, or be, something else
# The package that computes the traffic of each backend.
SIMULATORS = {"sumo": "libsumo", "highway-env": "highway-env", "replica": "numba"}
BACKENDS = tuple(SIMULATORS)
ARMS: dict[str, float] = {"control": 0.0, "treatment": 1.0}  # dose of risk in training
TRAFFICS: dict[str, float] = {"regular": 0.0, "risky": 1.0}  # dose of risk in the test
BASELINES = ("idle", "random", "faster", "slower", "idm", "careful")
LEARNER = "dqn"
# highway-env's own time step, and drivers that see along their path (see `backends.highway_env`).
HIGHWAY_ENV = {"simulation_frequency": 15, "variant": "path"}
# Settings that say how an episode is drawn or which arm is meant, not what is simulated.
NOT_IN_KEY = {
    "risk", "screen_width", "screen_height", "scaling", "centering_position", "show_trajectories",
}  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """One unit of the experiment: a trained agent with its test, or the test of a policy that does not learn.

    kind: "agent" or "baseline". level: 1 is the lightest traffic. arm, seed: None for baselines.
    profile: every hyper-parameter of the learner and its budget; for baselines empty but for the preset's
        name.
    env_config: the environment's configuration, without the dose of risk. eval: how it is tested.
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
    source: str | None = None

    def key(self) -> dict[str, Any]:
        """All of it as plain JSON values; what cell.json stores."""
        return {
            "kind": self.kind,
            "backend": self.backend,
            "task": self.task,
            "level": self.level,
            "level_name": self.level_name,
            "arm": self.arm,
            "seed": self.seed,
            "policy": self.policy,
            "profile": dict(self.profile),
            "env_config": dict(self.env_config),
            "eval": dict(self.eval),
        }

    @property
    def name(self) -> str:
        """Name of the cell's directory, "<slug>-<hash of 12 digits>"."""
        return cell_name(self.key(), versions(self.backend))

    @property
    def slug(self) -> str:
        """The readable part of the name, for example "sumo-highway-50-control-s0"."""
        return slug(self.key())

    @property
    def risk(self) -> float:
        """Dose of risk in the cell's training traffic (0 for baselines)."""
        return ARMS[self.arm] if self.arm else 0.0

    @property
    def updates(self) -> int:
        """Training budget in gradient updates (0 for baselines)."""
        return int(self.profile.get("updates", 0))

    @property
    def episodes(self) -> int:
        """Test episodes in each traffic."""
        return int(self.eval["episodes"])

    @property
    def gate_episodes(self) -> int:
        """Episodes in a traffic on scenarios that the gates are judged on, which are not test scenarios."""
        return int(self.eval["gate_episodes"])

    @property
    def work(self) -> int:
        """Episodes that are played after the training, in all traffics."""
        return 2 * self.episodes + len(self.gate_traffics) * self.gate_episodes

    @property
    def gate_traffics(self) -> tuple[str, ...]:
        """Traffics that the gates look at: an agent's own, for the policies it is held against all."""
        return tuple(traffic for traffic, risk in TRAFFICS.items() if not self.arm or risk == self.risk)


def slug(key: Mapping[str, Any]) -> str:
    """The readable part of a cell's name."""
    last = f"{key['arm']}-s{key['seed']}" if key["kind"] == "agent" else key["policy"].replace(":", ".")
    return f"{key['backend']}-{key['task']}-{key['level_name']}-{last}"


def cell_name(key: Mapping[str, Any], version: Mapping[str, Any]) -> str:
    """Name of the cell with this key under these versions.

    The preset's name is a label: the same computation asked for by two presets is one cell.
    """
    profile = {name: value for name, value in key["profile"].items() if name != "preset"}
    digest = sha256_bytes(
        canonical_json({"key": {**key, "profile": profile}, "versions": dict(version)}).encode()
    )
    return f"{slug(key)}-{digest[:12]}"


@cache
def _installed(package: str) -> str:
    """Version of an installed package, without a build tag ("2.13.0+cpu" computes what "2.13.0" does)."""
    try:
        return importlib.metadata.version(package).partition("+")[0]
    except importlib.metadata.PackageNotFoundError:
        raise UserError(
            f"the package {package} is not installed: run make setup, then use .venv/bin/python"
        ) from None


def versions(backend: str) -> dict[str, Any]:
    """The versions that can change the bits of a result; part of a cell's name.

    Raises:
        UserError: a package that the cell needs is not installed.
    """
    names = ["sumo-risky-driving", SIMULATORS[backend], "numpy", "torch"]
    return {"schema": RESULT_SCHEMA, **{name: _installed(name) for name in names}}


def level_names(task: str) -> tuple[str, ...]:
    """Names of a task's traffic levels, lightest first ("50", "100", "150"); levels are numbered from 1."""
    if task not in TASKS:
        raise unknown("task", task, TASKS)
    return tuple(TASKS[task].levels)


def env_config(backend: str, task: str, level: int) -> dict[str, Any]:
    """The complete configuration of a task at a traffic level, without the dose of risk.

    Defaults are written out, so that a changed default makes other cells.
    """
    names = level_names(task)
    settings = resolve(task, TASKS[task].defaults, TASKS[task].levels[names[level - 1]])
    settings = {name: value for name, value in settings.items() if name not in NOT_IN_KEY}
    return settings if backend == "sumo" else {**settings, **HIGHWAY_ENV}


def choose_tasks(wanted: Sequence[str]) -> tuple[str, ...]:
    """The wanted tasks in the grid's order. Raises UserError for a task that does not exist."""
    for task in wanted:
        if task not in TASKS:
            raise unknown("task", task, TASKS)
    return tuple(task for task in TASKS if task in wanted)


def choose_levels(tasks: Sequence[str], wanted: Sequence[int] | None) -> dict[str, tuple[int, ...]]:
    """Level numbers of each task: the wanted ones that it has, or all.

    Raises:
        UserError: a level that none of the tasks has, or a task left without a level.
    """
    known = {task: range(1, len(level_names(task)) + 1) for task in tasks}
    chosen = {task: tuple(n for n in known[task] if wanted is None or n in wanted) for task in tasks}
    most = max(tasks, key=lambda task: len(known[task]))
    for level in wanted or ():
        if not any(level in numbers for numbers in known.values()):
            names = ", ".join(f"{n} ({name})" for n, name in enumerate(level_names(most), start=1))
            nearest = min(known[most], key=lambda n: abs(n - level))
            raise UserError(f"unknown level {level}: did you mean {nearest}? {most} has the levels {names}")
    return {task: numbers for task, numbers in chosen.items() if numbers}


def build(
    backend: str,
    levels: Mapping[str, Sequence[int]],
    seeds: int,
    episodes: int,
    profiles: Mapping[str, Mapping[str, Any]],
    preset: str,
    gate_episodes: int | None = None,
    network: str | None = None,
    policies: Mapping[str, tuple[str, str]] | None = None,
) -> list[Cell]:
    """The cells of an experiment: on each task and level both arms of every training seed, and the baselines.

    Args:
        backend: "sumo" or "highway-env".
        levels: level numbers of each task, see `choose_levels`.
        seeds: training seeds an arm; they are 0, 1, ...
        episodes: test episodes in each traffic.
        profiles: hyper-parameters and budget of each task.
        preset: label that the cells carry.
        gate_episodes: episodes for the gates in each traffic; as many as test episodes if left out.
        network: FILE:CLASS of a network of the user's own.
        policies: policies of the user's own to test: label -> (FILE:MAKE or zip file, fingerprint of the file).

    Raises:
        UserError: unknown backend, or no seed or episode at all.
    """
    if backend not in BACKENDS:
        raise unknown("backend", backend, BACKENDS)
    if seeds < 1 or episodes < 1:
        raise UserError(f"at least one seed and one test episode are needed, not {seeds} and {episodes}")
    cells = []
    evaluation = {"episodes": episodes, "gate_episodes": episodes if gate_episodes is None else gate_episodes}
    for task, numbers in levels.items():
        for level in numbers:
            common: dict[str, Any] = {
                "backend": backend,
                "task": task,
                "level": level,
                "level_name": level_names(task)[level - 1],
                "env_config": env_config(backend, task, level),
                "eval": evaluation,
            }
            profile = {"preset": preset, **profiles[task]}
            cells += [
                Cell(
                    kind="agent",
                    arm=arm,
                    seed=seed,
                    policy=LEARNER,
                    profile=profile,
                    source=network,
                    **common,
                )
                for seed in range(seeds)
                for arm in ARMS
            ]
            cells += [
                Cell(
                    kind="baseline", arm=None, seed=None, policy=policy, profile={"preset": preset}, **common
                )
                for policy in BASELINES
            ]
            cells += [
                Cell(
                    kind="baseline", arm=None, seed=None, policy=label, source=source,
                    profile={"preset": preset, "policy_sha256": fingerprint}, **common,
                )
                for label, (source, fingerprint) in (policies or {}).items()
            ]  # fmt: skip
    return cells


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
