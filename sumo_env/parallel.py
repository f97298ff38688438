"""Several learning cars as PettingZoo's `ParallelEnv` (extra ``[multi-agent]``): see docs/several-cars.md."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, NoReturn

import gymnasium as gym
import numpy as np

from sumo_env.config import MOST_VEHICLES, ConfigError, one_of, whole_number
from sumo_env.env.cars import REPLICA, Cars, asked
from sumo_env.env.driving import DrivingEnv, Seen
from sumo_env.networks import files
from sumo_env.scenarios import NetworkTask
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import Task
from sumo_env.tasks.reset_options import OPTIONS, given

try:
    from pettingzoo import ParallelEnv
    from pettingzoo.utils import BaseParallelWrapper
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "several learning cars need PettingZoo, which is not installed: pip install pettingzoo",
        name=error.name,
    ) from None


# observations, rewards, terminations, truncations and ``info``, each by agent
Results = tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]


class ParallelDrivingEnv(ParallelEnv[str, Any, Any]):
    """Learning cars ``car_0``, ``car_1`` ..., each with the spaces, rewards and ``info`` of `DrivingEnv`.

    An agent leaves `agents` when its car has crashed or arrived, and all leave when time is up. Then SUMO drives the
    car on (on the replica it keeps its speed and lane); a crashed car stops and stays as an obstacle.

    Attributes:
        possible_agents: all agents that there can be.
        agents: those that act in the next step.
        cars: the environments of the agents, to be read: ``env.cars["car_1"].ego_state``. Their `hand_over` lets SUMO
            drive a car.
    """

    metadata: dict[str, Any] = {**DrivingEnv.metadata, "name": "sumo_env", "is_parallelizable": True}  # noqa: RUF012

    def __init__(self, cars: Cars, render_mode: str | None = None) -> None:
        self._cars, self.render_mode = cars, render_mode
        self.possible_agents = [f"car_{number}" for number in range(len(cars.envs))]
        self.cars = dict(zip(self.possible_agents, cars.envs, strict=True))
        self.agents: list[str] = []
        # highway-env has one reward and one end, those of the first car, where it does not have one for each
        self._follows_first = cars.first.steers and not cars.first.task.shares_reward

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            hint = f": of a car it is env.cars[agent].{name}" if hasattr(DrivingEnv, name) else ""
            raise AttributeError(f"a parallel_env has no attribute {name!r}{hint}", name=name)

    @property
    def ids(self) -> dict[str, str]:
        """Ids in SUMO and in scenes of the cars that have come in this episode, by agents."""
        return {self.possible_agents[number]: name for name, number in self._cars.numbers.items()}

    def observation_space(self, agent: str) -> gym.spaces.Space[Any]:
        """Of an agent."""
        return self._car(agent).observation_space

    def action_space(self, agent: str) -> gym.spaces.Space[Any]:
        """Of an agent."""
        return self._car(agent).action_space

    def _car(self, agent: str) -> DrivingEnv:
        return self.cars[one_of("agent", agent, tuple(self.cars))]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start an episode, see `DrivingEnv.reset`."""
        known = {key: value for key, value in given(options).items() if key in OPTIONS}
        if unknown := given(options).keys() - known.keys():  # PettingZoo's own test gives some
            gym.logger.warn("%s", f"options without effect: {', '.join(sorted(unknown))}")
        return self._enter(self._cars.reset(seed, known), [])

    def _enter(self, seen: Mapping[int, Seen], staying: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Let cars in beside agents that stay."""
        come = {self.possible_agents[number]: one for number, one in sorted(seen.items())}
        self.agents = [agent for agent in self.possible_agents if agent in staying or agent in come]
        return {agent: one[0] for agent, one in come.items()}, {agent: one[1] for agent, one in come.items()}

    def step(self, actions: Mapping[str, Any]) -> Results:
        """Drive one policy step.

        Returns:
            observations, rewards, terminations, truncations and ``info`` of the agents that have acted, and of those
            that have come (with reward 0).

        Raises:
            ValueError: not one action for each of `agents`.
        """
        if not isinstance(actions, Mapping) or actions.keys() != set(self.agents):
            wanted = (
                f"a dict of those of {self.agents}" if self.agents else "{}, as no car drives: call reset()"
            )
            raise ValueError(f"actions must be {wanted}, not {actions!r}")
        if not self.agents:
            return {}, {}, {}, {}, {}
        acting = {self.possible_agents.index(agent): actions[agent] for agent in self.agents}
        results, come = self._cars.step(acting)
        parts: list[dict[str, Any]] = [
            {self.possible_agents[number]: result[part] for number, result in results.items()}
            for part in range(5)
        ]
        observations, rewards, ends, truncations, infos = parts
        if self._follows_first:
            rewards = dict.fromkeys(rewards, results[0][1])
            ends = {agent: results[0][2] or self.cars[agent].ego_state.crashed for agent in ends}
        staying = [agent for agent in ends if not (ends[agent] or truncations[agent])]
        first, informed = self._enter(come, staying)
        for agent in first:
            rewards[agent], ends[agent], truncations[agent] = 0.0, False, False
        return observations | first, rewards, ends, truncations, infos | informed

    def render(self) -> Any:
        """The scene, see `DrivingEnv.render`."""
        return self._cars.first.render()

    def close(self) -> None:
        """Close the simulator and the window."""
        self._cars.first.close()


class AllAgents(BaseParallelWrapper[str, Any, Any]):
    """All possible agents act from `reset` to the end of the episode, as SuperSuit wants it.

    Who is not there yet, or no longer, sees zeros and is paid 0; its actions have no effect. All episodes end together:
    terminated, or truncated if time was up.
    """

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start an episode."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self.agents = list(self.possible_agents)
        return self._of_all(observations), {agent: infos.get(agent, {}) for agent in self.agents}

    def step(self, actions: Mapping[str, Any]) -> Results:
        """Drive one policy step."""
        acting = {agent: actions[agent] for agent in self.env.agents}
        observations, rewards, _, truncations, infos = self.env.step(acting)
        everybody, is_over, is_late = self.agents, not self.env.agents, any(truncations.values())
        self.agents = [] if is_over else everybody
        return (
            self._of_all(observations),
            {agent: rewards.get(agent, 0.0) for agent in everybody},
            dict.fromkeys(everybody, is_over and not is_late),
            dict.fromkeys(everybody, is_over and is_late),
            {agent: infos.get(agent, {}) for agent in everybody},
        )

    def _of_all(self, seen: Mapping[str, Any]) -> dict[str, Any]:
        return {
            agent: seen[agent] if agent in seen else np.zeros_like(self.observation_space(agent).low)
            for agent in self.possible_agents
        }


def parallel_env(
    env: str | Path | Task,
    config: Mapping[str, Any] | None = None,
    *,
    render_mode: str | None = None,
    remove_crashed: bool = False,
    **keywords: Any,
) -> ParallelDrivingEnv:
    """Several learning cars in one simulation, as PettingZoo's ``ParallelEnv``.

        env = sumo_env.parallel_env("sumo/highway-v0", {"controlled_vehicles": 3})
        env = sumo_env.parallel_env("town.sumocfg", vehicles=["taxi7", "taxi9"])
        env = sumo_env.parallel_env("town.sumocfg", vehicle_type="taxi", max_cars=8)

    Args:
        env: an id such as ``"sumo/highway-v0"`` or ``"replica/intersection-v1"``, the name of a task, a task of your
            own, or a file of SUMO as of `sumo_env.scenarios.SumoDrivingEnv`.
        config: keys of the configuration to change, for all cars; ``controlled_vehicles`` says how many cars there are.
        render_mode: None, ``"rgb_array"`` or ``"human"``.
        remove_crashed: whether crashed cars leave the road; not on the replica.
        keywords: of the environment of one car; with a file ``routes``, ``additional``, and either ``vehicles``, ids of
            the files, or ``vehicle_type`` and ``max_cars``: so many of this type that depart are learning cars.

    Raises:
        ConfigError: as of `DrivingEnv`; no or too many learning cars.
    """
    make: Any = DrivingEnv
    if not isinstance(config, Mapping | None):
        raise ConfigError(f"config is a dict, not {config!r}; routes and vehicles are named: routes=[FILE]")
    if not isinstance(env, Task) and (files.is_file(str(env)) or str(env).endswith(".sumocfg")):
        parts = ("routes", "additional", "vehicles", "vehicle_type", "max_cars")
        of_files = {name: keywords.pop(name) for name in parts if name in keywords}
        ids, kind, most = (of_files.get(name) for name in parts[2:])
        if bool(ids) == bool(kind) or bool(kind) != (most is not None):
            raise ConfigError("name learning cars by vehicles=[ids], or by vehicle_type= with max_cars=")
        if kind:
            of_files["max_cars"] = whole_number("'max_cars'", most, MOST_VEHICLES)
        fleet = NetworkTask(env, **of_files)
        if "controlled_vehicles" in (config or {}):
            raise ConfigError("on a network of your own 'max_cars' says how many learning cars there are")
        config, env = {**(config or {}), "controlled_vehicles": fleet.max_cars}, fleet
    elif isinstance(env, str) and env not in TASKS:
        spec = gym.spec(env)
        if not str(spec.entry_point).startswith("sumo_env.env.cars:"):
            raise ConfigError(f"{env!r} is not an environment of sumo_env")
        keywords = {**{key: value for key, value in spec.kwargs.items() if key != "per_car"}, **keywords}
        env = keywords.pop("task")
        if spec.entry_point == "sumo_env.env.cars:make_replica":
            make = resolve_name(REPLICA)
    if make is not DrivingEnv and remove_crashed:
        raise ConfigError("remove_crashed: crashed cars stay on the road on highway-env's physics")
    cars_asked = asked(config, keywords.pop("cars", 1))

    cars = Cars(partial(make, env, **keywords), cars_asked, render_mode, remove_crashed)
    return ParallelDrivingEnv(cars, render_mode)
