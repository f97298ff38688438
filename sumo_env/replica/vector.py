"""`ReplicaVectorEnv`: the replica's environments in batches, behind gymnasium's vector interface.

envs = gym.make_vec("sumo_env:replica/u-turn-v0", num_envs=64, scenarios="seeded")
"""

import copy
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, NoReturn

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from sumo_env.config import MOST_ENVS, ConfigError, whole_number
from sumo_env.contacts.measures import NEAR_MISS_TTC
from sumo_env.replica import batch as kernels
from sumo_env.replica import draws, tables
from sumo_env.replica.batch import AFRESH, NOTHING, OTHER, SPEEDS, EnvParams, Start
from sumo_env.replica.compiled import compile_notice
from sumo_env.replica.env import ReplicaEnv
from sumo_env.replica.simulator import steered
from sumo_env.spaces.actions import SIDES, ContinuousAction
from sumo_env.spaces.factory import actions_of, seeds_of
from sumo_env.tasks import TASKS, VARIANTS
from sumo_env.tasks.base import nearest_index
from sumo_env.tasks.reset_options import given
from sumo_env.unsupported import ALONE, missing

RESULTS = kernels.OUTCOME.names or ()
PATIENCE = 1e-5  # [s] until it is looked again whether all threads have begun


def make(
    num_envs: int,
    autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    threads: int = 1,
    **keywords: Any,
) -> VectorEnv:
    """What ``gym.make_vec`` makes of the ids ``replica/*``; arguments as of `ReplicaVectorEnv` and `ReplicaEnv`.

    Observations that the compiled batch does not have (TimeToCollision, features of routes, shuffled rows), tasks of
    one's own and pictures are those of single environments in turns, in a `SyncVectorEnv`; a warning says so.
    """
    single = ReplicaEnv(**keywords)
    if is_compiled(single):
        return ReplicaVectorEnv(single, num_envs, autoreset_mode, threads)
    gym.logger.warn(
        "no compiled batch has this task, observation or render mode: single environments take turns"
    )
    return SyncVectorEnv([lambda: ReplicaEnv(**keywords)] * num_envs, autoreset_mode=autoreset_mode)


def is_compiled(env: ReplicaEnv) -> bool:
    """Whether the kernels compute all that this environment gives; rewards of a task of one's own they do not know."""
    is_known = any(env.task is task for task in (*TASKS.values(), *VARIANTS.values()))
    return is_known and env.render_mode is None and env.form is not None and not env.form.is_shuffled


class ReplicaVectorEnv(VectorEnv):
    """`num_envs` environments that one compiled call steps.

    Each drives the episodes that the single environment drives with its seed, to the bit. ``infos`` has the entries of
    its ``info``, as arrays, but for rewards, crash, ending, traffic lights, acceleration and jerk.

    Args:
        single: an environment, which draws the episodes of all.
        num_envs: how many.
        autoreset_mode: gymnasium's; by default the step after the end of an episode is its reset.
        threads: that drive episodes at the same time; results do not depend on it.

    Raises:
        ConfigError: `num_envs` or `threads` is no whole number from 1 on.
    """

    def __init__(
        self, single: ReplicaEnv, num_envs: int, autoreset_mode: str | AutoresetMode, threads: int
    ) -> None:
        num_envs = self.num_envs = whole_number("num_envs", num_envs, MOST_ENVS)
        self._single, self._threads = single, whole_number("threads", threads, MOST_ENVS)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**single.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = single.observation_space
        self.single_action_space = single.action_space
        self.observation_space = batch_space(single.observation_space, num_envs)
        self.action_space = batch_space(single.action_space, num_envs)
        self._states: list[Any] = [None] * num_envs  # of numpy's generators; None before a reset
        # episodes drawn ahead, with the state of the generator before
        self._ahead: dict[int, tuple[Start, Any]] = {}
        self._over = np.zeros(num_envs, np.bool_)
        self._params: Any = None  # a `EnvParams`, from the first reset on
        self._controls = np.zeros((num_envs, 2))  # accelerations and angles of egos that are steered
        assert single.form is not None
        self._batch = kernels.no_episodes(num_envs, single.form.rows, len(single.form.features))
        self._pool = ThreadPoolExecutor(self._threads, "sumo_env") if self._threads > 1 else None

    # -- gymnasium -----------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode in every environment; an integer seed means seed, seed + 1, ...

        Args:
            seed: of the environments' generators.
            options: those of `ReplicaEnv.reset` but for ``scenario``, and ``reset_mask``: bool of shape (num_envs,),
                which environments are reset (then not ``config``, which they share).

        Raises:
            ConfigError: an unknown option, key or name, a wrong value.
            ValueError: wrong number of seeds, or a configuration with another observation or action space.
        """
        options = given(options)
        mask = np.asarray(options.pop("reset_mask", np.ones(self.num_envs, np.bool_)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"'reset_mask' must be bool of shape ({self.num_envs},), some of it True")
        if "scenario" in options or ("config" in options and not mask.all()):
            raise ConfigError(f"a batch takes no 'scenario', and no 'config' with a 'reset_mask'; {ALONE}")
        seeds = seeds_of(self, seed)
        for row in np.flatnonzero(mask).tolist():
            self._begin(row, self._reset_single(row, seeds[row], options))
        first, self._params = self._params is None, self._made_params()
        if first:
            with compile_notice(kernels.drive):
                kernels.drive(self._params, self._batch, np.zeros(0, np.int64), self._controls, 0, 0)
        self._over &= ~mask
        self._drive(np.where(mask, AFRESH, NOTHING))
        return self._batch.observations.copy(), self._infos(self._told(None, mask), mask)

    def step(
        self, actions: Any
    ) -> tuple[
        NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]
    ]:
        """One policy step in every environment.

        Raises:
            ValueError: not one action of the action space for each environment.
        """
        if self._params is None:
            raise gym.error.ResetNeeded("call reset() before step()")
        actions, numbers = self._read(actions_of(self, actions))
        if self.autoreset_mode is AutoresetMode.DISABLED:
            assert not self._over.any(), "episodes are over: reset them (options={'reset_mask': ...})"
        elif self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._begin_next()
        driven = np.where(self._over & (self.autoreset_mode is AutoresetMode.NEXT_STEP), AFRESH, numbers)
        self._drive(driven)
        outcomes = self._batch.outcomes
        rewards, terminated, truncated = (outcomes[name].copy() for name in RESULTS[:3])
        self._over = terminated | truncated
        infos = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._over.any():
            infos, driven = self._restart(actions), np.where(self._over, AFRESH, driven)
        infos |= self._infos(self._told(actions, driven == AFRESH), np.ones(self.num_envs, np.bool_))
        return self._batch.observations.copy(), rewards, terminated, truncated, infos

    def copies(self, rows: Sequence[int] | NDArray[np.int64]) -> "ReplicaVectorEnv":
        """A batch of copies of these environments, which go on by themselves, with one thread.

        An environment that is named several times has several copies. Copies and the batch that they are of share the
        configuration: neither takes another one at a reset.

        Raises:
            gym.error.ResetNeeded: there is no episode yet.
        """
        if self._params is None:
            raise gym.error.ResetNeeded("call reset() before copies()")
        rows = np.asarray(rows).tolist()
        twin = copy.copy(self)
        twin.num_envs, twin._threads, twin._pool = len(rows), 1, None
        twin.observation_space = batch_space(self.single_observation_space, len(rows))
        twin.action_space = batch_space(self.single_action_space, len(rows))
        twin._states = [self._states[row] for row in rows]
        twin._ahead = {k: self._ahead[row] for k, row in enumerate(rows) if row in self._ahead}
        twin._over, twin._controls = self._over[rows], self._controls[rows]
        twin._batch = kernels.copied(self._batch, rows)
        return twin

    @property
    def egos(self) -> tables.Records:
        """The egos' records, of `tables.CAR`, shape (num_envs,)."""
        return tables.chosen(self._batch.cars, (slice(None), 0))

    def __getattr__(self, name: str) -> NoReturn:
        raise missing("a compiled batch", name, dir(type(self)))

    def render(self) -> NoReturn:
        """Not here."""
        raise missing("a compiled batch", "render", ())

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    # -- episodes ------------------------------------------------------------------------------------------

    def _reset_single(self, row: int, seed: int | None, options: dict[str, Any]) -> Start:
        """The episode that an environment begins at a reset, as a single one does."""
        single, config = self._single, self._single.config
        _, self._states[row] = self._ahead.pop(row, (None, self._states[row]))
        single._np_random = None  # whoever never had a seed gets one
        with self._generator(row):
            single.reset(seed=seed, options=options)
        spaces = single.observation_space, single.action_space
        if spaces != (self.single_observation_space, self.single_action_space) or not is_compiled(single):
            single._take(*single._checked(config))
            raise ValueError("this configuration needs another batch: make a new vector environment for it")
        return single.replica.start

    def _begin_next(self) -> None:
        """Begin the next episode where one is over."""
        for row in np.flatnonzero(self._over).tolist():
            self._begin(row, self._next(row))

    def _next(self, row: int) -> Start:
        """The episode that an environment begins after the end of another."""
        if self._single.is_stock:
            return self._draw(row)
        if row not in self._ahead:
            self._draw_ahead()
        return self._ahead.pop(row)[0]

    def _draw_ahead(self, parts: Sequence[Future[None]] = ()) -> None:
        """Draw the next seeded episode of every environment that has none, until these parts of a step are done."""
        for row in range(self.num_envs):
            if parts and parts[-1].done():  # the others are about to be
                break
            if row not in self._ahead:
                before = self._states[row]
                self._ahead[row] = self._draw(row), before

    def _draw(self, row: int) -> Start:
        with self._generator(row):
            return self._single.begin()

    @contextmanager
    def _generator(self, row: int) -> Iterator[None]:
        """Let the generator of `_single`, which draws for all, be that of this environment."""
        if self._states[row] is not None:
            self._single.np_random.bit_generator.state = self._states[row]
        yield
        self._states[row] = self._single.np_random.bit_generator.state

    def _made_params(self) -> EnvParams:
        single, replica, names = self._single, self._single.replica, self._single.actions.values()
        assert single.form is not None
        kind, rules = single._action_type, replica.start.rules
        if isinstance(kind, ContinuousAction):
            rules = steered(rules, kind.speed_range, kind.dynamical)
        return EnvParams(
            replica.lanes.table,
            replica.seen_lanes,
            rules,
            single.form,
            kernels.reward_weights(single.task, single.config),
            np.array(single.target_speeds),
            np.array([SPEEDS.get(name, 0) for name in names], np.int64),
            np.array([SIDES.get(name, 0) for name in names], np.int64),
            single.time_limit(),
        )

    def _begin(self, row: int, start: Start) -> None:
        speed_index = nearest_index(start.cars["speed"].item(0), self._single.target_speeds)
        self._batch = kernels.begun(self._batch, row, start, speed_index)

    def _restart(self, actions: NDArray[Any]) -> dict[str, Any]:
        """Begin the next episode where one is over; returns what is said of the last one."""
        final = np.full(self.num_envs, None, object)
        infos = {"final_obs": final, "final_info": self._infos(actions, self._over)}
        for row in np.flatnonzero(self._over).tolist():
            final[row] = self._batch.observations[row].copy()
        self._begin_next()
        self._drive(np.where(self._over, AFRESH, NOTHING))
        return {**infos, **{f"_{name}": self._over.copy() for name in infos}}

    # -- steps ---------------------------------------------------------------------------------------------

    def _drive(self, actions: NDArray[np.int64]) -> None:
        """`batch.drive` by all threads; meanwhile seeded episodes are drawn ahead."""
        params, table = self._params, self._batch
        if self._pool is None:
            kernels.drive(params, table, actions, self._controls, 0, self.num_envs)
        else:
            ends = np.linspace(0, self.num_envs, self._threads + 1).astype(int).tolist()
            of_all = params, table, actions, self._controls
            parts = [self._pool.submit(kernels.drive, *of_all, *part) for part in pairwise(ends)]
            if not self._single.is_stock:
                while not all(part.running() or part.done() for part in parts):
                    time.sleep(PATIENCE)  # while Python draws, no thread could begin
                self._draw_ahead(parts)
            for part in parts:
                part.result()
        if self._single.draws_arrivals:
            for row in np.flatnonzero(actions >= 0).tolist():
                self._draw_arrival(row)

    def _draw_arrival(self, row: int) -> None:
        """What `ReplicaEnv.step` draws after a step at highway-env's intersection."""
        episode = self._batch.episodes[row]
        centres = kernels.remaining(self._batch, row, self._params.lanes)
        config = self._single.config
        road = self._single.task.road(config)
        with self._generator(row):
            rng = self._single.np_random
            spawn = draws.arrival(config, road, rng, centres, int(episode["steps"]))
        if spawn is not None:
            car = tables.cars_of(road, [spawn.vehicle])
            car["number"] = episode["first_arrival"] + episode["steps"]
            self._batch = kernels.expecting(self._batch, row, car)

    def _read(self, actions: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """Actions, and their numbers for the kernels; what they mean for egos that are steered is written down."""
        kind = self._single._action_type
        if isinstance(kind, ContinuousAction):
            self._controls[:, 0], self._controls[:, 1] = kind.controls(kind.numbers(actions))
        if isinstance(self.single_action_space, gym.spaces.Discrete):
            actions = actions.astype(np.int64)
            return actions, actions
        # the roundabout is paid for actions that equal 0 or 2, as `EgoState.action` may with one axis
        numbers = np.full(self.num_envs, OTHER)
        if actions.shape[1] == 1:
            numbers[np.isin(actions[:, 0], (0, 2))] = 0
        return np.array(actions, np.float32), numbers

    def _told(self, actions: Any, begins: NDArray[np.bool_]) -> NDArray[Any]:
        """What ``infos`` say of actions; of episodes that begin, that there was none."""
        nothing = np.asarray(self._single._action_type.no_action)
        if actions is None:
            return np.full((self.num_envs, *nothing.shape), nothing)
        return np.where(begins.reshape(-1, *[1] * nothing.ndim), nothing, actions)

    def _infos(self, actions: NDArray[Any], mask: NDArray[np.bool_]) -> dict[str, Any]:
        """``infos`` of the environments in `mask`, as `SyncVectorEnv` has them."""
        infos = {name: self._batch.outcomes[name] for name in RESULTS[3:]}
        crashed, min_ttc = infos["crashed"], infos["min_ttc"]
        infos |= {
            "action": actions,
            "cost": crashed.astype(float),
            "min_ttc": np.where(crashed, 0.0, min_ttc),
            "min_ttc_before_contact": min_ttc,
            "near_miss": (min_ttc < NEAR_MISS_TTC) & ~crashed,
        }
        if "goal_reward" in self._single.config:  # see `info.information`
            infos["is_success"] = infos["arrived"]
        if not mask.all():
            infos = {name: np.where(mask, one.T, np.zeros_like(one).T).T for name, one in infos.items()}
        return {key: part.copy() for name in infos for key, part in ((name, infos[name]), (f"_{name}", mask))}
