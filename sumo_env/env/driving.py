"""`DrivingEnv`: highway-env's interface to a `Simulator`, which is SUMO by default."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sumo_env.compat.as_highway_env import ReadAsHighwayEnv, returned
from sumo_env.config import Config, ConfigError, keys_of, refuse_arguments
from sumo_env.env.episode import CarEpisode, EgoPlace, Episode
from sumo_env.env.screen import Screen
from sumo_env.env.sumo_access import SumoAccess
from sumo_env.scene import Scene
from sumo_env.simulator import Command, Commands, EgoCommand, Simulator, Step
from sumo_env.spaces.actions import PlainAction, plain
from sumo_env.spaces.info import ending, information, on_its_way, paid_late
from sumo_env.streams import stream
from sumo_env.sumo.libsumo_calls import Sumo
from sumo_env.sumo.process import SumoProcess
from sumo_env.tasks import get_task, reset_options
from sumo_env.tasks.base import Task, nearest_index
from sumo_env.traffic.scenario import Scenario, VehicleSpec
from sumo_env.traffic.tilt import asked_tilt

Observation = NDArray[np.float32]
Seen = tuple[Observation, dict[str, Any]]  # what `DrivingEnv.reset` returns
Result = tuple[Observation, float, bool, bool, dict[str, Any]]  # what `DrivingEnv.step` returns


class DrivingEnv(ReadAsHighwayEnv):
    """A driving task on SUMO.

    Observations, actions, rewards, endings and `config` keys are highway-env's; docs/environments has a page for each
    task. One policy step lasts ``1 / policy_frequency`` s, if it divides `simulation_frequency`. Any number of
    environments may live in one process: libsumo supports one simulation per process, so the first environment has it
    and every further one gets a worker process.

    A subclass may override `_reward`, `_rewards`, `_is_terminated`, `_is_truncated` and `default_config`, as in
    highway-env; overriding a method of highway-env's that nothing calls here is a TypeError.

    Args:
        task: the name of a task (`sumo_env.tasks.TASKS`), or a task of your own (docs/own-parts.md).
        config: configuration keys to change; the defaults are `config.COMMON` and the task's `defaults`.
        render_mode: None, ``"rgb_array"`` or ``"human"``, a window (docs/windows.md).
        simulator: the simulator that drives the traffic; None for SUMO. The environment closes it.
        sumo_options: further options of SUMO, such as ``["--tripinfo-output", "trips.xml"]`` (docs/own-parts.md).
        live: None or ``"sumo-gui"``, SUMO's own window (docs/windows.md).
        output_dir: folder for the files that SUMO writes, by `sumo_options` or a network of your own; each episode of
            each environment has a folder in it.

    Raises:
        ConfigError: unknown task or key, wrong value.
    """

    cars = 1  # learning cars of the scenario, of which this environment sees one
    steers: ClassVar[bool] = False  # whether the simulator can obey a `SteeringCommand`
    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 5}  # noqa: RUF012 (gymnasium's way)
    _car: CarEpisode

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
        self._access = SumoAccess(self.task, simulator, sumo_options, live, output_dir)
        self._screen = Screen(render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self._asked = Config()  # changes for the next episode
        self.configure(config)

    # -- gymnasium -----------------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Seen:
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
        episode = self.start_episode(seed, options)
        return self.enter_episode(episode.scenario.ego, episode.scene)

    def start_episode(self, seed: int | None, options: dict[str, Any] | None) -> Episode:
        """Draw the traffic of an episode and let it drive until the ego is there, see `reset`."""
        super().reset(seed=seed)
        options = reset_options.checked(options)
        asked = {**self._asked, **keys_of(options.get("config"))}
        # users of highway-env write to env.unwrapped.config directly
        if asked or self.config != self._configured:
            self._take(*self._checked(asked))
        task = reset_options.varied(self.task, options, self.config["risk"])
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
        self._access.refuse_backwards("the ego at the start", ego.speed)
        self._screen.action_name = ""
        self.join_episode(Episode(self._access.open(), scenario, task))
        return self._car.episode

    def join_episode(self, episode: Episode) -> None:
        """Take part in an episode that has started; `enter_episode` lets the ego in."""
        self._access.simulator = episode.simulator
        self._car = CarEpisode(episode, episode.scenario.ego, episode.scene)

    def enter_episode(self, ego: VehicleSpec, scene: Scene) -> Seen:
        """The ego is on the road: its first observation and ``info``."""
        self._car = car = CarEpisode(self._car.episode, ego, scene)
        car.rng = self._shuffling(car)
        speed = ego.speed if scene.place is None else scene.speed.item(0)  # SUMO has placed the ego
        self._look(None, nearest_index(speed, self.target_speeds))
        self._film((scene,))
        observation = self._observe()
        return observation, returned(self, "_info", self._info(observation, None), dict)

    def step(self, action: Any) -> Result:
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
        self.ensure_reset()
        if self.render_mode is not None:
            action = self._screen.chosen(action, self._action_type, bool(self.config.get("manual_control")))
        command, is_late = self.command_for(action), self._car.is_over
        step = self.drive_cars({self._car.id: command})
        result = self.result_of(action, command, step)
        self.draw_arrival()
        return (result[0], paid_late(), *result[2:]) if is_late else result

    def ensure_reset(self, before: str = "step()", is_open: bool = True) -> None:
        """An error unless there is an episode; is_open: and a simulator that can go on with it."""
        if "_car" not in vars(self) or (is_open and self._access.simulator is None):
            raise gym.error.ResetNeeded(f"call reset() before {before}")

    def command_for(self, action: Any) -> Command:
        """What an action commands the ego."""
        command = self._action_type.command(action, self._car.situation(self.target_speeds))
        return EgoCommand(None, None) if self._car.is_handed_over else command

    def drive_cars(self, commands: Commands) -> Step:
        """Drive a policy step of all learning cars, and show it."""
        step = self._car.episode.step(commands, self._screen.is_watched)
        self._film(step.trace)
        return step

    def result_of(self, action: Any, command: Command, step: Step) -> Result:
        """What `step` returns after an action that meant this command."""
        car = self._car
        car.advance(step)
        aim = command.target_speed if isinstance(command, EgoCommand) and self.actions else None
        speed, speeds = car.scene.speed.item(0), self.target_speeds
        index = nearest_index(speed, speeds) if aim is None else speeds.index(aim)
        told = plain(action)
        action = told if isinstance(told, int) else np.array(action, np.float32)
        self._look(told, index)
        observation = self._observe()
        reward = returned(self, "_reward", self._reward(action), float)
        terminated = bool(self._is_terminated()) or bool(car.ego_state.ended)
        truncated = bool(self._is_truncated())
        car.ending = ending(car.ego_state, car.arrived, terminated, truncated)
        if car.episode.is_closed:
            truncated, car.ending = True, car.ending or "window closed"
        car.is_over = car.is_over or terminated or truncated
        info = returned(self, "_info", self._info(observation, action), dict)
        return observation, reward, terminated, truncated, info

    def _look(self, action: PlainAction | None, speed_index: int) -> None:
        """Make the ego's state of what it sees; the arguments as of `CarEpisode.look`."""
        self._car.look(self._ego_place(), action, speed_index, len(self.target_speeds))
        self._car.arrived = bool(self.task.arrived(self.ego_state))
        self._terms: dict[str, float] | None = None  # of the reward, once `_reward` has asked for them

    def draw_arrival(self) -> None:
        """Draw who comes before the next step, where the scenario has not drawn it already."""

    def imagine(self, seed: int) -> "DrivingEnv":
        """A copy of this environment in which new risk events replace those that have not begun.

        ``copy.deepcopy(env)`` is a copy that knows the future: it meets the same events as the environment itself. A
        planner that must not know them acts in imagined copies instead. They still know what the traffic is going to
        do without events: drivers' parameters (on the replica other ones are drawn), routes, and who arrives later.

        Args:
            seed: of the events; the same seed imagines the same.
        """
        if not isinstance(seed, int | np.integer) or seed < 0:
            raise ConfigError(f"the seed of imagine() must be a whole number from 0 on, not {seed!r}")
        self.ensure_reset("imagine()", is_open=False)
        twin = copy.deepcopy(self)
        # Seeds of scenarios are below 2**31, so an imagined future never equals the real one.
        twin._car.episode.imagine(self._imagined(2**31 + seed))
        return twin

    def _imagined(self, seed: int) -> Scenario:
        """The scenario of an imagined episode."""
        episode = self._car.episode
        return episode.drawn_by.imagined(episode.scenario, self.config, self.scene.time, seed)

    def close(self) -> None:
        """Close the window and the simulator; `reset` opens the simulator again."""
        self._screen.close()
        self._access.close()
        super().close()

    def _draw(self, task: Task) -> Scenario:
        """The traffic of an episode, drawn with the environment's generator."""
        return task.scenario(self._law, int(self.np_random.integers(2**31)))

    def _shuffling(self, car: CarEpisode) -> np.random.Generator:
        """What shuffles the rows of observations in an episode, apart from what draws the next one."""
        return stream(car.episode.scenario.seed, f"rows of {car.ego.id}")

    @property
    def _law(self) -> Config:
        """The configuration that traffic is drawn by; a single environment's has no number of learning cars."""
        return {**self.config, "controlled_vehicles": self.cars} if self.cars > 1 else self.config

    @property
    def ego_id(self) -> str:
        """Id of the ego in SUMO and in `scene`."""
        return self.scene.ids[0]

    def _ego_place(self) -> EgoPlace:
        return self._car.place()

    # -- pictures ------------------------------------------------------------------------------------------

    def render(self) -> NDArray[np.uint8] | None:
        """The scene as a picture, uint8 of shape (screen_height, screen_width, 3); None without a render mode.

        In the render mode "human" it is shown in a window, by `reset` and `step`, and None is returned. After a step
        with the ego's contact that a window or a film shows whole, the picture is of the contact (`pictured`).
        """
        if self.render_mode is None:
            gym.logger.warn('render() needs gym.make(..., render_mode="rgb_array")')
            return None
        self.ensure_reset("render()", is_open=False)
        picture = self._screen.picture(self.pictured, self._car.episode, self.task, self.config)
        if self.render_mode != "human":
            return picture
        if not self._screen.show(picture, self.task.name, self.task.frequency(self.config)):
            self._car.episode.is_closed, self.render_mode = True, None
            if self.config.get("manual_control"):  # there are no keys any more
                self.config = {**self.config, "manual_control": False}
        return None

    @property
    def pictured(self) -> Scene:
        """The scene that `render` shows: the present one, or in a step that was filmed that of the ego's contact."""
        return self.scene if self._screen.contact is None else self._screen.contact

    def _film(self, scenes: Sequence[Scene]) -> None:
        """Show the scenes of a policy step in the window, or add all but the last one to the film, which has that.

        The contact of the ego is the last one: until the step is over, cars go on through each other.
        """
        screen, crashed = self._screen, [bool(scene.crashed[:1].any()) for scene in (self.scene, *scenes)]
        touch = crashed.index(True) if True in crashed else 0  # 0: no contact, or one of an earlier step
        screen.contact, scenes = None, scenes[:touch] if touch else scenes
        for scene in scenes if screen.window is not None else scenes[:-1]:
            self.scene = scene
            if screen.window is not None:
                self.render()
            elif screen.video is not None and not self._car.episode.is_closed:
                screen.video._capture_frame()
        screen.contact = scenes[-1] if touch else None

    # -- SUMO ----------------------------------------------------------------------------------------------

    def export(self, folder: str | Path) -> list[Path]:
        """Write the present episode, as far as it was driven, for ``sumo`` and ``sumo-gui``; returns the files.

        ``episode.sumocfg`` shows what happened. The episode is driven a second time, in a simulator of its own, so that
        every simulation step is in the files. Each of several learning cars writes the same; the first one is blue.
        """
        self.ensure_reset("export()", is_open=False)
        return self._access.export(Path(folder), self._car.episode)

    def hand_over(self, to_sumo: bool = True) -> None:
        """Let SUMO drive the ego from the next step on, whatever the actions are, or take it back; also in a copy.

        `reset` takes it back. `sumo_env.scenarios.HandOver` does both by a rule.
        """
        if self.steers:
            raise ConfigError("SUMO drives nothing on the replica: hand_over is for environments on SUMO")
        self.ensure_reset("hand_over(), which lasts until the next one", is_open=False)
        self._car.is_handed_over = to_sumo

    @property
    def sumo(self) -> Sumo:
        """SUMO of this very environment, in a worker too: ``env.unwrapped.sumo.vehicle.getFuelConsumption("ego")``.

        All functions of libsumo, but those that load, step or end a simulation.
        """
        simulator = self._access.simulator
        if self.scenario is None or not isinstance(simulator, SumoProcess):
            raise gym.error.ResetNeeded("call reset() of an environment on SUMO before asking its SUMO")
        return Sumo(simulator.call)

    @property
    def sumo_command(self) -> str:
        """The command of ``sumo`` that drives the traffic of this episode, with SUMO's own files."""
        if self.scenario is None or self.scenario.traffic is None:
            raise gym.error.ResetNeeded("call reset() of a SumoDrivingEnv before sumo_command")
        return self._access.command(self.scenario)

    # -- what a subclass may override, as in highway-env -----------------------------------------------------

    def _reward(self, action: Any) -> float:
        """The reward of a step."""
        self._terms = returned(self, "_rewards", self._rewards(action), dict)
        return returned(self.task, "reward", self.task.reward(dict(self._terms), self.config), float)

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
        car, state, place, terms = self._car, self.ego_state, self.scene.place, self._terms
        if terms is None:  # nobody has asked for those of this step
            terms = returned(self, "_rewards", self._rewards(action), dict)
        info = information(
            self.scene,
            car.met,
            arrived=car.arrived,
            on_road=state.on_road,
            rewards=terms,
            action=self._action_type.no_action if action is None else action,
            ending=car.ending,
        )
        info |= {"acceleration": state.acceleration, "jerk": state.jerk}
        return info if place is None else info | on_its_way(place)
