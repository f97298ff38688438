"""Who drives in a test: any policy by its name, resolved once into plain data that every process drives alike."""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Self

import gymnasium as gym

from agents import pretrained, rules
from agents.files import DamagedFile
from agents.plugins import sha256
from agents.policies import Policy, foreign_policy
from agents.rules import MAKERS, POLICIES, make_policy
from experiments.study.compute.policies import driver
from experiments.study.results.store import Store
from experiments.support.errors import UserError, in_words, unknown
from experiments.support.files import sha256_bytes

RULES = tuple(dict.fromkeys((*POLICIES, *MAKERS)))
Env = gym.Env[Any, Any]
Place = tuple[str, str]  # task and level
# The environment as a policy observes it, the policy, and the SHA-256 of what it is.
Made = tuple[Env, Policy, str]


@dataclass(frozen=True)
class Entrant:
    """Who drives.

    place: task and level that it was trained for, if it was trained here. observation: the entry of the environment's
    configuration that it was trained with, else the task's own is shown. load: the policy for an environment; raises
    ValueError where it does not fit. digest: of its weights and its code, once it is `resolved`.
    """

    name: str
    place: Place | None
    load: Callable[[Env], Made]
    digest: str = ""
    observation: Mapping[str, Any] | None = None

    @property
    def config(self) -> dict[str, Any]:
        """What its environments have to have configured."""
        return {"observation": self.observation} if self.observation else {}

    def resolved(self, env: Env) -> Self:
        """With its digest in this environment. Raises UserError where it cannot be made or does not fit."""
        return replace(self, digest=self._made(env)[2])

    def make(self, env: Env) -> tuple[Env, Policy]:
        """The environment as it observes it, and the policy. Raises UserError as `resolved`, or if it has changed."""
        seen, policy, digest = self._made(env)
        if self.digest not in ("", digest):
            raise UserError(f"{self.name} has changed since this command began: run the command again")
        return seen, policy

    @in_words((ValueError, DamagedFile))
    def _made(self, env: Env) -> Made:
        return self.load(env)


def entrant_of(policy: str, task: str, level: str, part: str = "") -> Entrant:
    """Who drives at a task and level; agents that were trained at another level of the task drive at any.

    Of several agents it is the one that was finished last.

    Args:
        policy: a driver of `agents.rules`; a zip file of Stable-Baselines3 or FILE:MAKE, with {task} and {level} in its
            name; a directory of results; or an arm of `agents.cards()`, with or without its setting.
        part: of the agent's name in the directory.

    Raises:
        UserError: there is nobody of this name, or for this task.
    """
    found = entrants(policy, [(task, level)], part)
    if not found:
        raise UserError(f"no agent of {policy} was trained for {task}")
    return found[task, level]


def several(policies: str, task: str, level: str) -> list[Entrant]:
    """Drivers with commas between, each as of `entrant_of`; DIR/PART is all agents of a setting, by training seed.

    Raises:
        UserError: as `entrant_of`.
    """
    found = []
    for policy in policies.split(","):
        directory, part = (path := Path(policy)).parent, path.name
        if path.exists() or not any((directory / name).is_dir() for name in ("cells", "parts")):
            found.append(entrant_of(policy, task, level))
            continue
        keys = {name: record["key"] for name, record in Store(directory).agents().items() if part in name}
        own = [name for name, key in keys.items() if (key["task"], key["level_name"]) == (task, level)]
        if not own:
            raise UserError(f"no agent of {task} {level} in {directory} has {part!r} in its name")
        own.sort(key=lambda name: keys[name]["seed"])
        found += [entrant_of(str(directory), task, level, name) for name in own]
    return found


def entrants(policy: str, places: Iterable[Place], part: str = "") -> dict[Place, Entrant]:
    """Who drives at each of these tasks and levels, as `entrant_of`; tasks that no agent was trained in are not there.

    Raises:
        UserError: there is nobody of this name.
    """
    if policy in RULES or policy.endswith(".zip") or ":" in policy:
        load = _rule if policy in RULES else _foreign
        file = policy if policy.endswith(".zip") else policy.rpartition(":")[0]
        if load is _foreign and "{" not in file and not Path(file).is_file():
            raise UserError(f"there is no file {file}")
        names = {at: policy.replace("{task}", at[0]).replace("{level}", at[1]) for at in places}
        return {at: Entrant(name, None, partial(load, name)) for at, name in names.items()}
    trained = _stored(Path(policy), part) if Path(policy).is_dir() else _published(policy)
    found = {}
    for at in places:
        if of_task := [one for one in trained if one.place and one.place[0] == at[0]]:
            found[at] = next((one for one in of_task if one.place == at), of_task[0])
    return found


def _rule(name: str, env: Env) -> Made:
    return env, make_policy(name, env), _code_of_rules()


@cache
def _code_of_rules() -> str:
    files = sorted(Path(rules.__file__).parent.glob("*.py"))
    return sha256_bytes(" ".join(map(sha256, files)).encode())


def _foreign(name: str, env: Env) -> Made:
    return env, *foreign_policy(name, env)


def _loaded(name: str, env: Env) -> Made:
    setting, _, arm = name.partition("/")
    policy = pretrained.load(setting, arm)
    digest = hashlib.sha256(name.encode())
    for part, value in policy.network.state_dict().items():
        digest.update(f" {part} {tuple(value.shape)} ".encode() + value.numpy().tobytes())
    return env, policy, digest.hexdigest()


def _agent(name: str, key: dict[str, Any], weights: Path, env: Env) -> Made:
    """A stored agent. Its cell's name has the digest of all that decides how it acts, but for the weights."""
    digest = sha256_bytes(f"{name} {sha256(weights)}".encode())
    return *driver(key, None, env, weights), digest


def _stored(directory: Path, part: str) -> list[Entrant]:
    """The agents that were trained on SUMO and have weights and this part in their names; the last one first."""
    store, found = Store(directory), dict[str, Entrant]()
    for name, record in store.records().items():
        key = record["key"]
        if part not in name or key["kind"] != "agent" or key["backend"] != "sumo":
            continue
        if weights := store.weights(name):
            place = key["task"], key["level_name"]
            load, seen = partial(_agent, name, key, weights), key["env_config"]["observation"]
            found[record["timing"]["finished"] + name] = Entrant(name, place, load, observation=seen)
    if not found:
        named = f" and {part!r} in its name" if part else ""
        raise UserError(f"no agent in {directory} has weights{named}: experiments/train.py --out makes some")
    return [found[time] for time in sorted(found, reverse=True)]


def _published(policy: str) -> list[Entrant]:
    cards: dict[str, Any] = {}
    with suppress(FileNotFoundError):
        cards = pretrained.cards()
    found, arms = [], dict[str, None]()
    for name, about in cards.items():
        setting, _, arm = name.partition("/")
        arms[arm] = None
        if policy in (name, arm):
            place = about["task"], setting.removeprefix(f"{about['task']}-")
            seen = about["config"].get("observation")
            found.append(Entrant(name, place, partial(_loaded, name), observation=seen))
    if not found and Path(policy).is_file():
        raise UserError(
            f"{policy} is no zip file; what makes a policy in a Python file is named as {policy}:make"
        )
    words = {word for name in cards for word in name.split("/")}
    if not found and "/" in policy and words.isdisjoint(policy.split("/")):
        raise UserError(f"there is no directory {policy}: python experiments/train.py --out {policy}")
    if not found:
        raise unknown("policy", policy, [*RULES, *arms, "FILE:MAKE", "a zip file", "a directory"])
    return found
