"""Several environments at once: gymnasium's `SyncVectorEnv` over environments that step at the same time.

    envs = gym.make_vec("sumo/highway-v0", num_envs=4, config={"vehicles_count": 20})

Every environment has SUMO in a worker process. While its worker drives, the thread that waits for it lets the others
run, so the simulations are parallel and everything else is gymnasium's.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from sumo_env.config import COMMON, MOST_ENVS, refuse_arguments, whole_number
from sumo_env.env import DrivingEnv
from sumo_env.simulator import SimulatorError
from sumo_env.spaces.factory import actions_of, seeds_of
from sumo_env.sumo.process import SimulatorDied, SumoProcess
from sumo_env.tasks import get_task
from sumo_env.tasks.base import Task
from sumo_env.tasks.reset_options import given


class SumoVectorEnv(SyncVectorEnv):
    """`num_envs` environments of one task, whose simulations run in parallel.

    Where SUMO cannot go on with an episode, the others lose nothing: the step that meets this warns and reports that
    episode truncated, with reward 0, the last observation once more, and ``infos["ending"]`` "simulator error". A
    worker that dies (a crash of SUMO, the system's out-of-memory killer) or hangs is replaced, and
    ``infos["worker_died"]`` is True (only then is there such a key). The environment's next episode is drawn by its own
    generator, as always.

    Args:
        num_envs: how many.
        task: the name of a task, or a task of your own.
        config: as for one environment.
        render_mode: None or ``"rgb_array"``.
        autoreset_mode: as of `SyncVectorEnv`; by default the step after the end of an episode is its reset.

    Raises:
        ConfigError: as for one environment; `num_envs` is no whole number from 1 on.
    """

    def __init__(
        self,
        num_envs: int,
        task: str | Task,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        **unknown: Any,
    ) -> None:
        refuse_arguments(unknown, {**COMMON, **get_task(task).defaults})
        num_envs = whole_number("num_envs", num_envs, MOST_ENVS)
        self._pool = ThreadPoolExecutor(num_envs, thread_name_prefix="sumo_env")
        self._ahead = [
            _Ahead(DrivingEnv(task, config, render_mode, SumoProcess()), self._pool) for _ in range(num_envs)
        ]
        made = iter(self._ahead)
        super().__init__([lambda: next(made)] * num_envs, autoreset_mode=autoreset_mode)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode in every environment; an integer seed means seed, seed + 1, ...

        Raises:
            ConfigError: ``options["config"]`` is not right.
            ValueError: wrong number of seeds, or a configuration with another observation or action space.
        """
        options, seeds = given(options), seeds_of(self, seed)
        if config := options.get("config"):
            self._check(config)
        if "reset_mask" not in options:
            for env, one in zip(self._ahead, seeds, strict=True):
                env.begin("reset", seed=one, options=options)
        try:
            return super().reset(seed=seeds, options=options)
        finally:
            self._settle()

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One policy step in every environment.

        Raises:
            ValueError: not one action of the action space for each environment.
        """
        actions = actions_of(self, actions)
        resets = self.autoreset_mode is AutoresetMode.NEXT_STEP
        for env, action, over in zip(self._ahead, list(actions), self._autoreset_envs, strict=True):
            if over and resets:
                env.begin("reset", seed=None, options=None)
            else:
                env.begin("step", action)
        try:
            return super().step(actions)
        finally:
            self._settle()

    def _check(self, config: Mapping[str, Any]) -> None:
        """Refuse a configuration that changes a space, before any episode ends."""
        env: Any = self._ahead[0].unwrapped
        _, _, (actions, observations) = env._checked(config)
        if (observations.space, actions.space) != (self.single_observation_space, self.single_action_space):
            raise ValueError("this configuration changes a space: make a new vector environment for it")

    def close_extras(self, **kwargs: Any) -> None:
        """End the workers."""
        super().close_extras(**kwargs)
        self._pool.shutdown()

    def _settle(self) -> None:
        """After an error in one environment, let the others finish what they have begun."""
        for env in self._ahead:
            env.settle()


class _Ahead(gym.Wrapper[Any, Any, Any, Any]):
    """Begins a step or a reset in a thread, and gives its result when `step` or `reset` is called.

    An episode that its simulator cannot go on with is truncated.
    """

    def __init__(self, env: DrivingEnv, pool: ThreadPoolExecutor) -> None:
        super().__init__(env)
        self._pool = pool
        self._begun: Future[Any] | None = None

    def begin(self, name: str, *args: Any, **kwargs: Any) -> None:
        """Call a method of the environment in a thread."""
        self._begun = self._pool.submit(getattr(self.env, name), *args, **kwargs)

    def settle(self) -> None:
        """Forget what was begun, once it is over."""
        if self._begun is not None:
            wait([self._begun])
            self._begun = None

    def _result(self) -> Any:
        assert self._begun is not None
        result, self._begun = self._begun.result(), None
        return result

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        self._seen, info = self._result() if self._begun else self.env.reset(seed=seed, options=options)
        return self._seen, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        try:
            result = self._result() if self._begun else self.env.step(action)
        except SimulatorError as error:
            gym.logger.warn("%s", error)
            died = {"worker_died": True} if isinstance(error, SimulatorDied) else {}
            return self._seen, 0.0, False, True, {"ending": "simulator error", **died}
        self._seen = result[0]
        return result
