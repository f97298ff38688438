"""The gymnasium environment: highway-env's interface over an episode on SUMO (`world.World`)."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from operator import index
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sumo_env import safety
from sumo_env.config import Config, ConfigError, resolve
from sumo_env.ego import Ego
from sumo_env.interface import interface
from sumo_env.models.lane_table import lane_at
from sumo_env.networks.catalogue import network
from sumo_env.observation import TimeToCollision
from sumo_env.scenario import Scenario
from sumo_env.scene import Scene
from sumo_env.tasks import get_task
from sumo_env.tasks.base import EgoState, Task
from sumo_env.world import World

if TYPE_CHECKING:
    from gymnasium.wrappers import RecordVideo

    from sumo_env.rendering import Renderer

Observation = NDArray[np.float32]


class DrivingEnv(gym.Env[Observation, Any]):
    """One of the five driving tasks on SUMO.

    Observations, actions, rewards, endings and `config` keys are highway-env's (see `tasks`); one policy step is
    ``1 / policy_frequency`` s. libsumo holds one simulation a process: of several environments in one process,
    the one that was reset last drives, and an earlier one that steps on raises `SimulationTaken`.

    Args:
        task: highway, two-way, roundabout, intersection or u-turn.
        config: keys to change, see `config.COMMON` and the task's `defaults`.
        render_mode: None or ``"rgb_array"``.

    Raises:
        ConfigError: unknown task or key, wrong value.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012 (gymnasium's way)

    def __init__(
        self, task: str, config: Mapping[str, Any] | None = None, render_mode: str | None = None
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(
                f"render_mode must be None or 'rgb_array' (drawn without a display), not {render_mode!r}"
            )
        self.task: Task = get_task(task)
        self.render_mode = render_mode
        self._world: World | None = None
        self._world_key: tuple[Any, ...] = ()
        self._renderer: Renderer | None = None
        self._video: RecordVideo[Any, Any] | None = None
        self._configured: Config | None = None
        self.scenario: Scenario | None = None
        self.configure(config)

    # -- configuration -------------------------------------------------------------------------------------

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Lay `config` over the present configuration; takes effect at the next reset."""
        changed = resolve(self.task.name, self.task.defaults, getattr(self, "config", None), config)
        offered = interface(self.task, changed)
        self.config: Config = changed  # only now that nothing can go wrong
        self._configured = copy.deepcopy(changed)
        self.actions, self.target_speeds = offered.actions, offered.target_speeds
        self.observation_type = offered.observation_type
        self.observation_space, self.action_space = offered.observation_space, offered.action_space
        self._set_frame_rate()

    # -- gymnasium -----------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode. ``options={"config": {...}}`` changes the configuration first, as in highway-env.

        The traffic is a function of the seed alone (or of the environment's own generator when no seed is given),
        never of earlier episodes or of the agent.
        """
        super().reset(seed=seed)
        # also when no options are given: users of highway-env write to env.unwrapped.config directly
        override = (options or {}).get("config")
        if override or self.config != self._configured:
            self.configure(override)
        config = self.config
        self.scenario = self.task.scenario(config, int(self.np_random.integers(2**31)))
        world = self._open_world()
        spec = self.scenario.ego
        route: tuple[str, ...] = (spec.lane[0], spec.lane[1])
        if spec.destination is not None and spec.destination != spec.lane[1]:
            route = (spec.lane[0], *world.road.route(spec.lane[1], spec.destination))
        self.ego = Ego(world.road, spec.lane, spec.speed, self.target_speeds, route)
        self.steps = 0
        self.scene: Scene = world.reset(self.scenario, self.ego)
        world.min_ttc, world.distance = math.inf, 0.0
        self.ego_state = self._ego_state(None)
        observation = self._observe()
        return observation, self._info(None, self.task.rewards(self.ego_state, config))

    def step(self, action: int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive one policy step.

        Returns:
            observation, reward, terminated (crash, arrival), truncated (time is up), info.
            ``info`` holds speed [m/s], crashed, arrived, on_road, action, rewards (the raw terms), crash (a
            `CrashRecord` as a dict, empty without a crash), density (vehicles within 200 m), min_ttc [s], near_miss,
            distance [m] of this step.

        Raises:
            SimulationTaken: another environment of this process was reset meanwhile.
            ValueError: the action is not in the action space.
        """
        if self._world is None or self.scenario is None:
            raise gym.error.ResetNeeded("call reset() before step()")
        try:
            name = self.actions[index(action)]
        except (KeyError, TypeError):
            raise ValueError(f"action must be one of {self.actions}, not {action!r}") from None
        world = self._world
        self.ego.command(name, self.scene.x.item(0), self.scene.y.item(0))
        self.scene = world.step(self._on_substep if self._video or self._shows_trajectories() else None)
        self.steps += 1
        self.ego_state = state = self._ego_state(int(action))
        observation = self._observe()
        rewards = self.task.rewards(state, self.config)
        reward = float(self.task.reward(rewards, self.config))
        terminated = bool(self.task.terminated(state, self.config))
        truncated = bool(self.steps / self.config["policy_frequency"] >= self.config["duration"])
        info = self._info(int(action), rewards)
        world.come_and_go()
        return observation, reward, terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """The scene as a picture, uint8 of shape (screen_height, screen_width, 3); None without a render mode."""
        if self.render_mode is None:
            gym.logger.warn('render() needs gym.make(..., render_mode="rgb_array")')
            return None
        if self.scenario is None:
            raise gym.error.ResetNeeded("call reset() before render()")
        return self._camera().draw(self.scene, self.task.road(self.config), self.config)

    def set_record_video_wrapper(self, wrapper: RecordVideo[Any, Any]) -> None:
        """Let a `gymnasium.wrappers.RecordVideo` film every simulation sub-step, in real time, as in highway-env.

        >>> env = RecordVideo(gym.make("sumo/highway-v0", render_mode="rgb_array"), "videos")
        >>> env.unwrapped.set_record_video_wrapper(env)

        Without this call a film has one frame a policy step. ``config["simulation_frequency"]`` is the frame rate.
        """
        self._video = wrapper
        self._set_frame_rate()

    def _set_frame_rate(self) -> None:
        if self._video is not None:
            self.metadata = {**self.metadata, "render_fps": self.config["simulation_frequency"]}
            self._video.frames_per_sec = self.config["simulation_frequency"]

    def _on_substep(self, scene: Scene) -> None:
        """Between two policy steps: a frame for the film, points for the trajectories."""
        if self._shows_trajectories():
            self._camera().remember(scene)
        if self._video is not None and self._video.recording:
            self.scene = scene
            self._video._capture_frame()

    def _shows_trajectories(self) -> bool:
        return self.render_mode is not None and bool(self.config["show_trajectories"])

    def _camera(self) -> Renderer:
        if self._renderer is None:
            from sumo_env.rendering import Renderer  # Pillow is loaded by those only who look

            self._renderer = Renderer()
        return self._renderer

    def close(self) -> None:
        """Give SUMO back; the environment can be reset again all the same."""
        if self._world is not None:
            self._world.sim.release(self._world)
            self._world = None
        super().close()

    # -- parts ---------------------------------------------------------------------------------------------

    def _open_world(self) -> World:
        keys = ("simulation_frequency", "policy_frequency", "traffic_model", "lanes_count", "road_length")
        key = tuple(self.config.get(name) for name in keys)
        if self._world is None or key != self._world_key:
            lanes, length = self.config.get("lanes_count", 4), self.config.get("road_length", 800.0)
            try:
                built = network(self.task.name, lanes_count=int(lanes), road_length=float(length))
            except ValueError as error:
                raise ConfigError(str(error)) from error
            self._world = World(self.task, self.config, built)
            self._world_key = key
        self._world.config = self.config
        return self._world

    def _ego_state(self, action: int | None) -> EgoState:
        assert self._world is not None
        road, scene, ego = self._world.road, self.scene, self.ego
        x, y, heading = scene.x.item(0), scene.y.item(0), scene.heading.item(0)
        index = lane_at(road, x, y, heading)
        lane = road.lane(index)
        s, lateral = lane.local_coordinates(x, y)
        return EgoState(
            lane=index,
            s=s,
            lateral=lateral,
            speed=scene.speed.item(0),
            heading=heading,
            target_lane=ego.target_lane,
            speed_index=ego.speed_index,
            speed_count=len(self.target_speeds),
            action=action,
            crashed=scene.crashed.item(0),
            on_road=lane.covers(s, lateral),
        )

    def _observe(self) -> Observation:
        assert self._world is not None
        road = self._world.road
        if isinstance(self.observation_type, TimeToCollision):
            return self.observation_type.observe(
                self.scene, road, self.ego_state, self.target_speeds, self.ego.route
            )
        return self.observation_type.observe(
            self.scene, road, self.ego_state, self._world.spec_of, self.np_random
        )

    def _info(self, action: int | None, rewards: dict[str, float]) -> dict[str, Any]:
        assert self._world is not None
        world, state, scene = self._world, self.ego_state, self.scene
        ttc = float(world.min_ttc)
        info = {
            "speed": state.speed,
            "crashed": state.crashed,
            "arrived": bool(self.task.arrived(state)),
            "on_road": state.on_road,
            "rewards": rewards,
            # always a dict: vector environments cannot merge None with a dict
            "crash": {} if world.crash is None else world.crash.as_dict(),
            "density": int(safety.density(scene.x, scene.y, 0, 200.0)),
            "min_ttc": ttc,
            "near_miss": ttc < safety.NEAR_MISS_TTC and not state.crashed,
            "distance": float(world.distance),
        }
        if action is not None:  # at a reset there is none, not even None: vector environments merge by type
            info["action"] = action
        return info
