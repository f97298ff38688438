"""What simulators and learners do, as numbers: results of other behaviour are never mixed or believed to be of this.

Behaviour is taken, not source code: whole episodes of a simulator at both doses, and the Q-values of a learner after
20 updates on episodes that are the same for all. They are compared within tolerances far above what processors differ
by. `fingerprints.json` has the eight digits that cells are named with and the numbers that they stand for; a sweep
compares them before it begins. After a change that is meant,

    python -m experiments.study.design.fingerprint             # some minutes; with names of tasks, of these alone

gives what has changed a name of its own.
"""

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.learner import settings_of
from experiments.backends import BACKENDS, has, make_env, require
from experiments.study.design.arms import scenario_seed
from experiments.study.design.cell import LEARNER
from experiments.support.errors import UserError, check_known, run_command
from experiments.support.files import digest_of, read_json, write_json
from sumo_env.tasks import TASKS

IDLE, SLOWER, ANY = "IDLE", "SLOWER", ""  # what drives an episode; ANY: random actions
SLOW = ("highway-env",)  # of which the fingerprint is of one episode a dose, in the lightest traffic
TABLE = Path(__file__).with_name("fingerprints.json")
AGAIN = "python -m experiments.study.design.fingerprint"
LEARNERS = "learners"  # part of the table beside the backends
TOLERANCE = 1e-3  # relative above 1, else absolute
UPDATES, PROBES = 20, 8
# What decides how a learner of ours computes, apart from its numbers, which are in the names of its cells.
KINDS: tuple[Mapping[str, Any], ...] = (
    {"network": "attention"},
    {"network": "attention", "by_hand": False},
    {"network": "dueling"},
)

Behaviour = dict[str, str]  # numbers, with spaces between them, by what they are of


def _table() -> dict[str, dict[str, dict[str, Any]]]:
    """`name` and `behaviour` by backend and task, and by LEARNERS and learner."""
    return read_json(TABLE)


def _digits(found: Behaviour) -> str:
    """The name of a behaviour that has none yet."""
    return digest_of(found)[:8]


def _same(found: Behaviour, known: Behaviour) -> bool:
    ours, theirs = (
        {name: np.array(text.split(), float) for name, text in of.items()} for of in (found, known)
    )
    return ours.keys() == theirs.keys() and all(
        a.shape == theirs[name].shape and np.allclose(a, theirs[name], rtol=TOLERANCE, atol=TOLERANCE)
        for name, a in ours.items()
    )


# -- Simulators --------------------------------------------------------------------------------------------------------


def driven(backend: str, task: str) -> Behaviour:
    """How whole episodes go, idle, slow and with random actions, at the lightest and heaviest level and both doses.

    The numbers of an episode: policy steps, crashed vehicles at the end, and the means over steps and vehicles of the
    reward, of x and y [m] and of the speed [m/s].
    """
    levels = list(TASKS[task].levels.values())
    numbers = (1,) if backend in SLOW else dict.fromkeys((1, len(levels)))
    drivers = (IDLE,) if backend in SLOW else (IDLE, SLOWER, ANY)
    return {
        f"level {level}, risk {risk:g}, scenario {scenario}": words
        for level in numbers
        for risk in (0.0, 1.0)
        for scenario, words in enumerate(_episodes(backend, task, level, risk, drivers))
    }


def _episodes(backend: str, task: str, level: int, risk: float, drivers: Iterable[str]) -> Iterator[str]:
    config = list(TASKS[task].levels.values())[level - 1]
    env: Any
    with closing(make_env(backend, task, {**config, "risk": risk})) as env:
        for scenario, driver in enumerate(drivers):
            fixed = [number for number, name in env.unwrapped.actions.items() if name == driver]
            rng, seen, ended = np.random.default_rng(scenario), [], False
            env.reset(seed=scenario_seed(task, level, scenario))
            while not ended:
                action = fixed[0] if fixed else int(rng.integers(env.action_space.n))
                _, reward, terminated, truncated, _ = env.step(action)
                scene, ended = env.unwrapped.scene, terminated or truncated
                seen.append([reward, *(np.mean(values) for values in (scene.x, scene.y, scene.speed))])
            yield " ".join([f"{len(seen)} {int(np.sum(scene.crashed))}", *_texts(np.mean(seen, axis=0))])


def _texts(values: Iterable[float]) -> list[str]:
    return [f"{value:.6g}" for value in np.asarray(values).round(6) + 0.0]


def known_dynamics(backend: str, task: str) -> str:
    """The digits that cells of a task are named with; empty for a task that the table does not have.

    Raises:
        UserError: the backend does not have the task.
    """
    name: str = _table().get(backend, {}).get(task, {}).get("name", "")
    if not name:
        require(backend, task)
    return name


@cache
def dynamics(backend: str, task: str) -> str:
    """The digits that cells of a task are named with; of a task that the table does not have, those of its behaviour.

    Raises:
        UserError: the backend does not have the task.
    """
    return known_dynamics(backend, task) or _digits(driven(backend, task))


def check_dynamics(pairs: Iterable[tuple[str, str]]) -> None:
    """Check that simulators do what the names of cells say, for pairs of backend and task.

    Raises:
        UserError: one does not.
    """
    table = _table()
    for backend, task in dict.fromkeys(pairs):
        known = table.get(backend, {}).get(task)
        if known and not _same(driven(backend, task), known["behaviour"]):
            raise UserError(
                f"the task {task} on the backend {backend} does not behave as the stored results of this name did: "
                f"undo the change of its dynamics, or run {AGAIN}, which gives the changed dynamics a name of their own"
            )


# -- Learners ----------------------------------------------------------------------------------------------------------


class Tape(gym.Env[Any, Any]):
    """Episodes in which nothing depends on the actions, so that every learner has the same replay."""

    observation_space = gym.spaces.Box(-1.0, 1.0, (5, 7), np.float32)
    action_space = gym.spaces.Discrete(5)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin the episode of this seed."""
        super().reset(seed=seed)
        return self._observation(), {}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """The next step of the episode."""
        crashed = bool(self.np_random.random() < 0.15)
        return self._observation(), float(self.np_random.random()), crashed, False, {"crashed": crashed}

    def _observation(self) -> Any:
        return self.np_random.uniform(-1, 1, self.observation_space.shape).astype(np.float32)


def kind_of(policy: str, profile: Mapping[str, Any]) -> str:
    """What kind of learner an agent has, as the table calls it: "dqn attention", or "dqn attention by hand"."""
    from agents.dqn import DQNConfig  # here: not every command needs the learner

    what = {name: profile[name] for name in ("network", "device", "by_hand") if name in profile}
    by_hand = " by hand" if policy == "dqn" and DQNConfig(**what).is_by_hand else ""
    return f"{policy} {profile.get('network', '')}{by_hand}"


def learnt(settings: Mapping[str, Any]) -> Behaviour:
    """The Q-values of our learner with such settings on some observations, after UPDATES updates."""
    from agents.learners import learner  # here: not every command needs the learner

    found = learner(LEARNER)
    few: dict[str, float] = {"updates": UPDATES, "steps_per_update": 2, "warm_up": 100, "batch_size": 32}
    few |= {"n_steps": 3, "learning_rate": 5e-3, "tau": 5e-3}
    trained: Any = found.train(Tape, settings_of(found.Settings, {**few, **settings}, "the learner"), 0)
    rng = np.random.default_rng(0)
    probes = rng.uniform(-1, 1, (PROBES, *Tape.observation_space.shape)).astype(np.float32)
    return {f"observation {k}": " ".join(_texts(trained.policy.q(probe))) for k, probe in enumerate(probes)}


def learner_name(policy: str, profile: Mapping[str, Any]) -> str:
    """The digits that agents of a learner are named with; empty for the first one, and for others'."""
    return _table().get(LEARNERS, {}).get(kind_of(policy, profile), {}).get("name", "")


def check_learners(agents: Iterable[tuple[str, Mapping[str, Any]]]) -> None:
    """Check that learners do what the names of cells say, for pairs of learner and profile.

    Raises:
        UserError: one does not.
    """
    table = _table().get(LEARNERS, {})
    asked = {kind_of(policy, profile) for policy, profile in agents}
    for settings in KINDS:
        kind = kind_of("dqn", settings)
        if kind in asked and kind in table and not _same(learnt(settings), table[kind]["behaviour"]):
            raise UserError(
                f"the learner {kind} does not learn as that of the stored agents of this name did: undo the change of "
                f"agents, or run {AGAIN}, which gives the changed learner a name of its own"
            )


def main(tasks: Sequence[str] = ()) -> int:
    """Compare simulators and learners with the table; add what is new, and give new names to what has changed.

    tasks: the simulators of these alone, and no learner. Raises UserError for one that there is not.
    """
    check_known("task", tasks, TASKS)
    table, asked = _table(), tasks or tuple(TASKS)
    found = {
        (backend, task): driven(backend, task) for backend in BACKENDS for task in asked if has(backend, task)
    }
    if not tasks:
        found |= {(LEARNERS, kind_of("dqn", settings)): learnt(settings) for settings in KINDS}
    for (part, name), behaviour in found.items():
        known = table.setdefault(part, {}).setdefault(name, {"name": "none", "behaviour": {}})
        if not _same(behaviour, known["behaviour"]):
            print(f"{part} {name}: {known['name']} -> {_digits(behaviour)}")
            known.update(name=_digits(behaviour), behaviour=behaviour)
    write_json(TABLE, table)
    return 0


if __name__ == "__main__":
    run_command(lambda: main(sys.argv[1:]))
