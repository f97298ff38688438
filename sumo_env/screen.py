"""What a user sees of an environment: pictures and films."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sumo_env.config import Config
from sumo_env.scene import Scene
from sumo_env.tasks.base import Task
from sumo_env.traffic.scenario import Scenario

if TYPE_CHECKING:
    from gymnasium.wrappers import RecordVideo

    from sumo_env.rendering import Renderer


class OnScreen:
    """The part of `DrivingEnv` that shows its scene."""

    config: Config
    metadata: dict[str, Any]
    render_mode: str | None
    scenario: Scenario | None
    scene: Scene
    task: Task
    _renderer: Renderer | None = None
    _video: RecordVideo[Any, Any] | None = None

    def render(self) -> NDArray[np.uint8] | None:
        """The scene as a picture, uint8 of shape (screen_height, screen_width, 3); None without a render mode."""
        if self.render_mode is None:
            gym.logger.warn('render() needs gym.make(..., render_mode="rgb_array")')
            return None
        if self.scenario is None:
            raise gym.error.ResetNeeded("call reset() before render()")
        if self._renderer is None:
            from sumo_env.rendering import Renderer  # Pillow is imported when the first picture is drawn

            self._renderer = Renderer()
        return self._renderer.draw(self.scene, self.task.road(self.config), self.config)

    def set_record_video_wrapper(self, wrapper: RecordVideo[Any, Any]) -> None:
        """Make a `gymnasium.wrappers.RecordVideo` film every simulation step, in real time, as in highway-env.

        >>> env = RecordVideo(gym.make("sumo/highway-v0", render_mode="rgb_array"), "videos")
        >>> env.unwrapped.set_record_video_wrapper(env)

        Without this call, a film has one frame per policy step. ``config["simulation_frequency"]`` is the frame rate.
        """
        self._video = wrapper
        self._set_frame_rate()

    def _set_frame_rate(self) -> None:
        if self._video is not None:
            frequency = self.task.frequency(self.config)
            self.metadata = {**self.metadata, "render_fps": frequency}
            self._video.frames_per_sec = frequency

    def _film(self, scenes: Iterable[Scene]) -> None:
        """Add these scenes to the film."""
        for scene in scenes:
            self.scene = scene
            assert self._video is not None
            self._video._capture_frame()
