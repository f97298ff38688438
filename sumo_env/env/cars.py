"""Several learning cars in one simulation: each has the observation, the reward and the end of a `DrivingEnv`.

`Cars` composes them. `TupleEnv` is a gymnasium environment of them, as highway-env's with ``MultiAgentAction`` and
``MultiAgentObservation``; `sumo_env.parallel` is PettingZoo's.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import product
from pkgutil import resolve_name
from typing import Any, NamedTuple

import gymnasium as gym
from gymnasium import spaces

from sumo_env.config import MOST_VEHICLES, Config, ConfigError, keys_of, whole_number
from sumo_env.env.driving import DrivingEnv, Result, Seen
from sumo_env.simulator import Commands
from sumo_env.spaces.info import paid_late
from sumo_env.tasks import reset_options
from sumo_env.tasks.base import Task

Make = Callable[[Config, str | None], DrivingEnv]  # of a configuration and a render mode
REPLICA = "sumo_env.replica.env:ReplicaEnv"
SHARED = {"action": "MultiAgentAction", "observation": "MultiAgentObservation"}  # highway-env's types


class Asked(NamedTuple):
    """What a configuration of several learning cars says."""

    config: Config  # of each car
    cars: int
    shared: dict[str, bool]  # whether actions, and observations, are tuples


def asked(config: Mapping[str, Any] | None, cars: int = 1) -> Asked:
    """The parts of a configuration; cars: how many there are unless it says so.

    Raises:
        ConfigError: the number of cars makes no sense.
    """
    plain = dict(keys_of(config))
    count = plain.pop("controlled_vehicles", cars)
    count = whole_number("'controlled_vehicles'", count, MOST_VEHICLES)
    shared = {}
    for key, kind in SHARED.items():
        entry = plain.get(key)
        shared[key] = cars > 1 if entry is None else isinstance(entry, Mapping) and entry.get("type") == kind
        if entry is not None and shared[key]:
            if f"{key}_config" not in entry:
                raise ConfigError(f"{kind!r} needs '{key}_config', the {key} of each car, not {entry!r}")
            plain[key] = entry[f"{key}_config"]
    return Asked(plain, count, shared)


class Cars:
    """Learning cars of one simulation."""

    def __init__(
        self, make: Make, given: Asked, render_mode: str | None = None, removes_crashed: bool = False
    ) -> None:
        """make: makes the environment of a car; removes_crashed: whether crashed cars leave the road."""
        if given.cars > 1 and given.config.get("manual_control"):
            raise ConfigError("'manual_control' drives one car: keys say nothing about further ones")
        # of the cars; the first one holds the simulator and draws the traffic. All share one random generator.
        self.envs = [make(given.config, None if number else render_mode) for number in range(given.cars)]
        self.first, self._removes_crashed = self.envs[0], removes_crashed
        self.first.cars = given.cars
        self.numbers: dict[str, int] = {}  # of the cars that have come in this episode, by their ids

    def reset(self, seed: int | None, options: dict[str, Any] | None) -> dict[int, Seen]:
        """Start an episode; returns what the cars see that are there, by their numbers."""
        self._episode = self.first.start_episode(seed, options)
        for env in self.envs[1:]:
            if env.config != self.first.config:
                env._take(*env._checked(self.first.config))
            env.np_random = self.first.np_random
            env.join_episode(self._episode)
        scenario = self._episode.scenario
        by_type = scenario.traffic is not None and scenario.traffic.car_type
        self._known = () if by_type else (scenario.ego.id, *scenario.further)  # ids, by number
        self.numbers = {}
        return self._newcomers()

    def step(self, actions: Mapping[int, Any]) -> tuple[dict[int, Result], dict[int, Seen]]:
        """Drive one policy step by the actions of cars, by their numbers.

        Returns:
            the results of these cars, and what cars see that have come.
        """
        self.first.ensure_reset()
        ids = {number: name for name, number in self.numbers.items()}
        commands = {number: self.envs[number].command_for(action) for number, action in actions.items()}
        by_id: Commands = {ids[number]: command for number, command in commands.items()}
        scene = self._episode.scene
        left = [name for name in scene.ids[: scene.cars] if name not in by_id and self._removes_crashed]
        crashed = [name for name in left if self.envs[self.numbers[name]].ego_state.crashed]
        step = self.first.drive_cars({**by_id, **dict.fromkeys(crashed)})
        results = {
            number: self.envs[number].result_of(actions[number], command, step)
            for number, command in commands.items()
        }
        if 0 not in actions:
            self.first.scene = step.scene
        come = self._newcomers()
        self.first.draw_arrival()
        return results, come

    def _newcomers(self) -> dict[int, Seen]:
        """Let cars in that have come; what they see."""
        seen, scene, scenario = {}, self._episode.scene, self._episode.scenario
        for name in scene.ids[: scene.cars]:
            if name in self.numbers:
                continue
            number = self._known.index(name) if self._known else len(self.numbers)
            self.numbers[name] = number
            spec = next((spec for spec in scenario.cars if spec.id == name), scenario.ego._replace(id=name))
            seen[number] = self.envs[number].enter_episode(spec, scene.seen_by(name))
        return seen


class TupleEnv(gym.Env[Any, Any]):
    """A task with several learning cars, as highway-env has it: actions are tuples, and so are observations.

    Reward and end are highway-env's: those of the first car, or at the intersection the mean of all rewards, and an end
    as soon as one car has crashed or all have arrived. ``info`` is the first car's, with ``agents_rewards`` and
    ``agents_terminated``. Other attributes are those of the first car's environment.

    Args:
        make: makes the environment of a car.
        given: what the configuration says.
        render_mode: None, ``"rgb_array"`` or ``"human"``.
        per_car: whether `step` returns ``agents_rewards`` and ``agents_terminated`` as the reward and the end.

    Raises:
        ConfigError: actions are no tuples.
    """

    metadata = DrivingEnv.metadata

    def __init__(self, make: Make, given: Asked, render_mode: str | None, per_car: bool = False) -> None:
        if not given.shared["action"]:
            raise ConfigError(
                "several learning cars need the action type 'MultiAgentAction' with an 'action_config', or "
                "sumo_env.parallel_env (docs/several-cars.md)"
            )
        self.cars = Cars(make, given, render_mode)
        self.render_mode, self._sees_all, self._per_car = render_mode, given.shared["observation"], per_car
        self._set_spaces()

    def _set_spaces(self) -> None:
        envs = self.cars.envs
        self.action_space = spaces.Tuple([env.action_space for env in envs])
        seen = [env.observation_space for env in envs]
        self.observation_space = spaces.Tuple(seen) if self._sees_all else seen[0]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "cars":
            raise AttributeError(name)
        return getattr(self.cars.first, name)

    @property
    def controlled_vehicles(self) -> list[Any]:
        """The learning cars, as ``env.unwrapped.vehicle`` shows the first one."""
        return [env.vehicle for env in self.cars.envs]

    def get_available_actions(self) -> Iterator[tuple[int, ...]]:
        """Tuples of actions, each of which would change something for its car now, or is IDLE."""
        return product(*(env.get_available_actions() for env in self.cars.envs))

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Change these keys of the configuration of all cars; they take effect at the next reset.

        Raises:
            ConfigError: as of `DrivingEnv.configure`; another number of cars.
        """
        changed, count = asked(config, len(self.cars.envs)), len(self.cars.envs)
        if changed.cars != count:
            raise ConfigError("'controlled_vehicles' cannot be changed: make another environment")
        for env in self.cars.envs:
            env.configure(changed.config)
        self._set_spaces()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode, see `DrivingEnv.reset`.

        Raises:
            ConfigError: as there; another number of cars.
        """
        asked_for, self._is_over = reset_options.given(options), False
        if "config" in asked_for:
            self.configure(asked_for.pop("config"))
        super().reset(seed=seed)
        seen = self.cars.reset(seed, asked_for)
        self._np_random = self.cars.first._np_random
        self._set_spaces()
        return self._observed(seen), self._informed(seen, [env._reward(None) for env in self.cars.envs])

    def step(self, action: Any) -> tuple[Any, Any, Any, bool, dict[str, Any]]:
        """Drive one policy step.

        Raises:
            ValueError: not one action for each car.
        """
        count = len(self.cars.envs)
        if not isinstance(action, tuple | list) or len(action) != count:
            raise ValueError(f"{count} learning cars need a tuple of {count} actions, not {action!r}")
        results, _ = self.cars.step(dict(enumerate(action)))
        info = {**self._informed(results, [result[1] for result in results.values()]), "action": action}
        rewards, ends = info["agents_rewards"], info["agents_terminated"]
        own: Any = results[0]
        reward, end, truncated = own[1:4]
        first, states = self.cars.first, [env.ego_state for env in self.cars.envs]
        if self._per_car:
            reward, end = rewards, ends
        elif first.task.shares_reward:
            is_off = bool(first.config["offroad_terminal"]) and not states[0].on_road
            reward = sum(rewards) / count
            have_arrived = all(env._car.arrived for env in self.cars.envs)
            end = any(state.crashed for state in states) or have_arrived or is_off
        if self._is_over:
            reward = (paid_late(),) * count if self._per_car else paid_late()
        self._is_over = self._is_over or truncated or (all(end) if self._per_car else end)
        return self._observed(results), reward, end, truncated, info

    def _observed(self, seen: Mapping[int, tuple[Any, ...]]) -> Any:
        return tuple(seen[number][0] for number in range(len(seen))) if self._sees_all else seen[0][0]

    def _informed(self, seen: Mapping[int, tuple[Any, ...]], rewards: list[float]) -> dict[str, Any]:
        """The first car's ``info`` with what belongs to all cars."""
        first, cars = self.cars.first, [env._car for env in self.cars.envs]
        ends = [car.ego_state.crashed or bool(car.ego_state.ended) or car.arrived for car in cars]
        together: dict[str, Any] = {
            "agents_rewards": tuple(map(float, rewards)),
            "agents_terminated": tuple(ends),
        }
        if first.task.shares_reward:
            terms = [one[-1]["rewards"] for one in seen.values()]
            together["rewards"] = {name: sum(term[name] for term in terms) / len(terms) for name in terms[0]}
        return seen[0][-1] | together

    def render(self) -> Any:
        """See `DrivingEnv.render`."""
        return self.cars.first.render()

    def close(self) -> None:
        """Close the simulator and the window."""
        self.cars.first.close()


# -- gymnasium -----------------------------------------------------------------------------------------------------


def make(
    task: str | Task,
    config: Mapping[str, Any] | None = None,
    render_mode: str | None = None,
    *,
    cars: int = 1,
    per_car: bool = False,
    on: str = "sumo_env.env.driving:DrivingEnv",
    **keywords: Any,
) -> DrivingEnv | TupleEnv:
    """What ``gymnasium.make`` makes of an id: the environment of one car, or of several by the configuration.

    Args:
        task, config, render_mode: as of `DrivingEnv`.
        cars: learning cars, unless the configuration says how many; if there are more, actions are tuples.
        per_car: see `TupleEnv`.
        on: class of the environment of a car.
        keywords: of that environment.
    """
    make_one: Callable[..., DrivingEnv] = resolve_name(on)
    given = asked(config, cars)
    if given.cars == 1 and not any(given.shared.values()):
        return make_one(task, config, render_mode, **keywords)
    return TupleEnv(partial(make_one, task, **keywords), given, render_mode, per_car)


make_replica: Any = partial(make, on=REPLICA)  # likewise on highway-env's physics
make.metadata = make_replica.metadata = DrivingEnv.metadata  # type: ignore[attr-defined]
