"""`DrivingEnv`: highway-env's interface to a `Simulator`, which is SUMO by default."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sumo_env.compat.as_highway_env import class_or_instance, returned
from sumo_env.config import COMMON, Config, ConfigError, pace, refuse_arguments, tell_of_steps
from sumo_env.contacts.rectangles import state_of
from sumo_env.env.screen import OnScreen
from sumo_env.env.sumo_access import OwnSumo
from sumo_env.networks.roads import LaneIndex
from sumo_env.scene import Scene
from sumo_env.simulator import Command, Commands, Driven, EgoCommand, EgoStep, Simulator, Step, WindowClosed
from sumo_env.spaces.actions import PlainAction
from sumo_env.spaces.info import ending, information, on_its_way, paid_late
from sumo_env.spaces.interface import interface
from sumo_env.streams import stream
from sumo_env.sumo.process import SumoProcess
from sumo_env.tasks import get_task, reset_options
from sumo_env.tasks.base import EgoState, Task, nearest_index
from sumo_env.traffic.scenario import Scenario
from sumo_env.traffic.tilt import asked_tilt

Observation = NDArray[np.float32]


class DrivingEnv(OnScreen, OwnSumo):
    """A driving task on SUMO.

    Observations, actions, rewards, endings and `config` keys are highway-env's; docs/environments has a page for each
    task. One policy step lasts ``1 / policy_frequency`` s. Any number of environments may live in one process: libsumo
    supports one simulation per process, so the first environment has it and every further one gets a worker process.

    A subclass may override `_reward`, `_rewards`, `_is_terminated`, `_is_truncated` and `default_config`, as in
    highway-env; overriding a method of highway-env's that nothing calls here is a TypeError.

    Args:
        task: the name of a task (`sumo_env.tasks.TASKS`), or a task of your own (docs/own-parts.md).
        config: configuration keys to change; the defaults are `config.COMMON` and the task's `defaults`.
        render_mode: None, ``"rgb_array"`` or ``"human"``, a window (docs/windows.md).
        simulator: the simulator that drives the traffic; None for SUMO. The environment closes it.
        sumo_options: further options of SUMO, such as ``["--tripinfo-output", "trips.xml"]`` (docs/own-parts.md).
        live: None or ``"sumo-gui"``, SUMO's own window (docs/windows.md).
        output_dir: on a network of your own, folder for SUMO's outputs, with files of its own for each episode of each
            environment.

    Raises:
        ConfigError: unknown task or key, wrong value.
    """

    cars = 1  # learning cars of the scenario, of which this environment sees one
    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 5}  # noqa: RUF012 (gymnasium's way)

    def __init__(
        self,
        task: str | Task,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        simulator: Simulator | None = None,
        sumo_options: Sequence[str] = (),
        live: str | None = None,
        output_dir: str | Path | None = None,
        **unknown: Any,
    ) -> None:
        self._refuse_overrides()
        self.task: Task = get_task(task)
        refuse_arguments(unknown, self.default_config())
        self._prepare_sumo(simulator, sumo_options, live, output_dir)
        self._open(render_mode)
        self._configured: Config | None = None
        self.scenario: Scenario | None = None
        self.configure(config)

    # -- configuration -------------------------------------------------------------------------------------

    @class_or_instance
    def default_config(self) -> Config:
        """Every key with its default. A subclass may change defaults and add keys for a reward of its own.

        Of an environment, or of a class, as in highway-env: ``HighwayEnv.default_config()``.
        """
        task = getattr(self, "task", None)  # a class may have none
        return copy.deepcopy({**COMMON, **(task.defaults if task else {})})

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Change these keys of the configuration; they take effect at the next reset."""
        changed, is_raised = self._resolved(config)
        if changed.get("manual_control") and self.render_mode != "human":
            raise ConfigError("'manual_control' needs render_mode='human': keys are pressed in its window")
        offered = interface(self.task, changed, self.steers)
        if offered.action_type.names:
            self._refuse_backwards("'target_speeds'", offered.action_type.target_speeds[0])
        self._refuse_backwards("'initial_speed'", changed.get("initial_speed") or 0.0)
        if self._is_on_sumo:
            tell_of_steps(self.task.frequency(changed))
        self._offered = offered
        self.config: Config = changed  # after all checks: an error leaves the environment as it was
        self._is_raised = is_raised
        self._configured = copy.deepcopy(changed)
        self.define_spaces()
        self._set_frame_rate()

    def define_spaces(self) -> None:
        """Set the types and spaces of observation and action, whenever the configuration changes."""
        self._action_type, self._observation_type = self._offered
        self.actions, self.target_speeds = self._action_type.names, self._action_type.target_speeds
        self._own_observation = None
        self.observation_space, self.action_space = self._observation_type.space, self._action_type.space

    @property
    def _is_on_sumo(self) -> bool:
        return self._given is None or isinstance(self._given, SumoProcess)

    def _refuse_backwards(self, what: str, speed: float) -> None:
        """An error if SUMO would have to drive at a negative speed [m/s]."""
        if self._is_on_sumo and speed < 0.0:
            raise ConfigError(f"{what}, {speed:g} m/s: SUMO's vehicles never drive backwards; replica/* do")

    # -- gymnasium -----------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        The traffic depends on the seed alone (on the environment's own generator if no seed is given), never on
        earlier episodes or on the agent.

        Args:
            seed: of the environment's generator.
            options: ``config`` changes the configuration first, as in highway-env. ``risk_rates``, ``risk_ranges`` and
                ``calibration`` change values of `RiskRates`, `RiskRanges` and `Calibration` in this episode alone, such
                as ``{"risk_rates": {"cut_in": 0.2}}``. ``{"event_factor": 50, "event_reach": 30.0}``: risk events of
                vehicles within so many metres of a learning car come so many times as often (docs/rare.md).
                ``scenario`` is a `Scenario` to start from.

        Raises:
            ConfigError: an unknown option, key or name, a wrong value.
        """
        return self._begin(*self._start(seed, options))

    def _start(self, seed: int | None, options: dict[str, Any] | None) -> tuple[Scenario, Scene]:
        """Draw the traffic of an episode and let it drive until the ego is there, see `reset`."""
        super().reset(seed=seed)
        options = reset_options.checked(options)
        # also without options: users of highway-env write to env.unwrapped.config directly
        if options.get("config") or self.config != self._configured:
            self.configure(options.get("config"))
        self._drawn_by = task = reset_options.varied(self.task, options, self.config["risk"])
        tilt = asked_tilt(options, task.risk_rates, self.config["risk"], self.config["duration"])
        try:
            if (given := options.get("scenario")) is not None:
                self.task.refuse_foreign(given, self.config)
            scenario = given or self._draw(task)
            scenario = scenario.tilted(tilt) if tilt else scenario
            ego = scenario.ego
            if scenario.traffic is not None:
                # SUMO's numbers have 31 bits; of a larger seed SUMO gets the scenario's
                if seed is not None and seed < 2**31 and "scenario" not in options:
                    scenario = replace(scenario, traffic=replace(scenario.traffic, seed=seed))
            else:
                scenario.network.place(ego.lane, ego.s, ego.destination)  # there are such a network and place
        except ValueError as error:
            raise ConfigError(str(error)) from error
        self._refuse_backwards("the ego at the start", ego.speed)
        self.scenario = scenario
        if self._simulator is None:
            self._simulator = SumoProcess(options=self._options, here=True, live=self._live)
        self._commands = Driven()
        self._met = None
        return scenario, self._simulator.reset(scenario)

    def _begin(self, scenario: Scenario, scene: Scene) -> tuple[Observation, dict[str, Any]]:
        """The ego is on the road: its first observation and ``info``."""
        self.scenario, self.scene = scenario, scene
        self._road, self._route = scenario.road, scenario.ego.route(scenario.road)
        self._spec_of = {spec.id: spec for spec in scenario.specs}
        self._spec_of |= {spawn.vehicle.id: spawn.vehicle for spawn in scenario.spawns}
        self._row_order = self._shuffling(scenario)
        self._target_lane, speed = scenario.ego.lane, scenario.ego.speed
        if self.scene.place is not None:  # SUMO has found a place for the ego
            self._target_lane, speed = self.scene.place.lane, self.scene.speed.item(0)
            self._find_route()
        self._speed_index = nearest_index(speed, self.target_speeds)
        self.steps, self._handed_over, self._is_closed, self._is_over = 0, False, False, False
        self._ending = self._action_name = ""
        self._last = EgoStep(self._target_lane, None, math.inf, 0.0)
        self.ego_state = self._ego_state(None)
        self._film((self.scene,))
        observation = self._observe()
        return observation, returned(self, "_info", self._info(observation, None), dict)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive one policy step.

        Returns:
            observation, reward, terminated (crash, arrival), truncated (time is up), info.
            ``info`` has the same keys after every step and reset: speed [m/s], crashed, arrived, on_road, action (-1 at
            a reset), rewards (the raw terms), cost (1 at a crash), crash (a `CrashRecord` as a dict, empty without a
            crash), ending ("" while the episode goes on, then crash, arrived, missed turn, time and others, see
            `info.ending`), density (vehicles within 200 m), min_ttc [s] (0 at a contact, inf where nothing
            is near), min_ttc_before_contact, near_miss, distance [m] of this step, traffic_light (the next one on
            the ego's way: 0 red, 1 yellow, 2 green, -1 without one), traffic_light_distance [m] (inf without one).
            With ``event_factor`` also those of `scene.NearEvents`.

        After the end of an episode a step warns and pays 0.

        Raises:
            SimulatorError: the simulator cannot continue this episode; `reset` starts another one.
            ValueError: the action is not in the action space.
        """
        if self._simulator is None or self.scenario is None:
            raise gym.error.ResetNeeded("call reset() before step()")
        action = self._chosen(action)
        command = self._command(action)
        is_late = self._is_over
        step = self._drive({(ego := self.ego_id): command})
        result = self._after(action, command, step.scene.seen_by(ego), step.egos[ego])
        self._follow_up()
        return (result[0], paid_late(), *result[2:]) if is_late else result

    def _command(self, action: Any) -> Command:
        """What an action commands the ego."""
        command = self._action_type.command(action, self._situation())
        return EgoCommand(None, None) if self._handed_over else command

    def _drive(self, commands: Commands) -> Step:
        """A policy step of the simulator."""
        assert self._simulator is not None
        self._commands.append(commands)
        try:
            step = self._simulator.step(commands, trace=self._is_watched)
        except WindowClosed:  # the episode ends where it was
            self._is_closed = True
            step = Step(self.scene, dict.fromkeys(commands, self._last._replace(distance=0.0)))
        self._met = step.egos.get(next(iter(step.scene.ids), ""))
        self._film(step.trace)
        return step

    def _after(
        self, action: Any, command: Command, scene: Scene, ego: EgoStep
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """What `step` returns after an action that meant this command."""
        self.scene, self._last, self._target_lane = scene, ego, ego.target_lane
        if self.scene.place is not None:
            self._find_route()
        self.steps += 1
        if (
            isinstance(command, EgoCommand)
            and command.target_speed is not None
            and command.acceleration is None
        ):
            self._speed_index = self.target_speeds.index(command.target_speed)
        else:
            self._speed_index = nearest_index(self.scene.speed.item(0), self.target_speeds)
        plain = self._action_type.plain(action)
        action = plain if isinstance(plain, int) else np.array(action, np.float32)
        self.ego_state = self._ego_state(plain)
        observation = self._observe()
        reward = returned(self, "_reward", self._reward(action), float)
        terminated, truncated = bool(self._is_terminated()), bool(self._is_truncated())
        self._ending = ending(self.ego_state, self.task.arrived(self.ego_state), terminated, truncated)
        if self._is_closed:
            truncated, self._ending = True, self._ending or "window closed"
        self._is_over = self._is_over or terminated or truncated
        info = returned(self, "_info", self._info(observation, action), dict)
        return observation, reward, terminated, truncated, info

    def _follow_up(self) -> None:
        """What happens between two steps."""

    def imagine(self, seed: int) -> DrivingEnv:
        """A copy of this environment in which new risk events replace those that have not begun.

        ``copy.deepcopy(env)`` is a copy that knows the future: it meets the same events as the environment itself. A
        planner that must not know them acts in imagined copies instead. They still know what the traffic is going to
        do without events: drivers' parameters (on the replica other ones are drawn), routes, and who arrives later.

        Args:
            seed: of the events; the same seed imagines the same.
        """
        if not isinstance(seed, int | np.integer) or seed < 0:
            raise ConfigError(f"the seed of imagine() must be a whole number from 0 on, not {seed!r}")
        if self.scenario is None:
            raise gym.error.ResetNeeded("call reset() before imagine()")
        twin = copy.deepcopy(self)
        # Seeds of scenarios are below 2**31, so an imagined future never equals the real one.
        twin._go_on(lambda whole: self._drawn_by.imagined(whole, self.config, self.scene.time, 2**31 + seed))
        return twin

    def close(self) -> None:
        """Close the window and the simulator; `reset` opens the simulator again."""
        self._shut()
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = self._given
        super().close()

    def _draw(self, task: Task) -> Scenario:
        """The traffic of an episode, drawn with the environment's generator."""
        return task.scenario(self._law, int(self.np_random.integers(2**31)))

    def _shuffling(self, scenario: Scenario) -> np.random.Generator:
        """What shuffles the rows of observations in an episode, apart from what draws the next one."""
        return stream(scenario.seed, f"rows of {scenario.ego.id}")

    @property
    def _law(self) -> Config:
        """The configuration that traffic is drawn by; a single environment's has no number of learning cars."""
        return {**self.config, "controlled_vehicles": self.cars} if self.cars > 1 else self.config

    # -- parts ---------------------------------------------------------------------------------------------

    def _ego_state(self, action: PlainAction | None) -> EgoState:
        lane, s, lateral, on_road = self._ego_place()
        assert self.scenario is not None
        scene = self.scene
        frequency = pace(self.scenario.simulation_frequency, self.scenario.policy_frequency)
        last = None if action is None else self.ego_state
        acceleration = (scene.speed.item(0) - last.speed) * frequency if last else 0.0
        return EgoState(
            lane=lane,
            s=s,
            lateral=lateral,
            speed=scene.speed.item(0),
            heading=scene.heading.item(0),
            target_lane=self._target_lane,
            speed_index=self._speed_index,
            speed_count=len(self.target_speeds),
            action=action,
            crashed=scene.crashed.item(0),
            on_road=on_road,
            scene=scene,
            acceleration=acceleration,
            jerk=(acceleration - last.acceleration) * frequency if last else 0.0,
            before=last.scene if last else None,
            lanes_abreast=self._road.count(*self._target_lane[:2]),
        )

    def _ego_place(self) -> tuple[LaneIndex, float, float, bool]:
        """The ego's lane, its coordinates there [m], and whether it is on the road."""
        x, y, _, heading = state_of(self.scene, 0)
        place = self.scene.place
        index = place.lane if place is not None else self._road.closest_lane(x, y, heading)
        lane = self._road.lane(index)
        s, lateral = lane.local_coordinates(x, y)
        return index, s, lateral, lane.covers(s, lateral)

    # -- what a subclass may override, as in highway-env -----------------------------------------------------

    def _reward(self, action: Any) -> float:
        """The reward of a step."""
        terms = returned(self, "_rewards", self._rewards(action), dict)
        return returned(self.task, "reward", self.task.reward(terms, self.config), float)

    def _rewards(self, action: Any) -> dict[str, float]:
        """The raw terms of the reward, by name; the action is None at a reset."""
        return returned(self.task, "rewards", self.task.rewards(self.ego_state, self.config), dict)

    def _is_terminated(self) -> bool:
        """Whether the episode has ended by what happened in it."""
        return self.task.terminated(self.ego_state, self.config)

    def _is_truncated(self) -> bool:
        """Whether time is up."""
        return bool(self.steps / self.config["policy_frequency"] >= self.config["duration"])

    def _info(self, obs: Observation, action: Any = None) -> dict[str, Any]:
        """What `step` and `reset` return beside the observation."""
        state, met, place = self.ego_state, self._last, self.scene.place
        info = information(
            self.scene,
            met,
            arrived=self.task.arrived(state),
            on_road=state.on_road,
            rewards=returned(self, "_rewards", self._rewards(action), dict),
            action=self._action_type.no_action if action is None else action,
            ending=self._ending,
        )
        info |= {"acceleration": state.acceleration, "jerk": state.jerk}
        return info if place is None else info | on_its_way(place)
