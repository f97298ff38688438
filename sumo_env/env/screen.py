"""What a user sees of an environment: pictures, films and a window."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sumo_env.compat.as_highway_env import ReadAsHighwayEnv
from sumo_env.scene import Scene
from sumo_env.simulator import EgoStep

if TYPE_CHECKING:
    from gymnasium.wrappers import RecordVideo

    from sumo_env.env.window import Window


class OnScreen(ReadAsHighwayEnv):
    """The part of `DrivingEnv` that shows its scene."""

    metadata: dict[str, Any]
    render_mode: str | None
    _met: EgoStep | None = None  # what the first car of the scene has met in this policy step
    _video: RecordVideo[Any, Any] | None = None
    _window: Window | None = None  # of render mode "human"
    _action_name = ""  # of the last meta-action of this episode
    _is_closed = False  # whether the user has closed a window in this episode

    def render(self) -> NDArray[np.uint8] | None:
        """The scene as a picture, uint8 of shape (screen_height, screen_width, 3); None without a render mode.

        In the render mode "human" it is shown in a window, by `reset` and `step`, and None is returned.
        """
        if self.render_mode is None:
            gym.logger.warn('render() needs gym.make(..., render_mode="rgb_array")')
            return None
        if self.scenario is None:
            raise gym.error.ResetNeeded("call reset() before render()")
        from sumo_env import rendering  # Pillow is imported when the first picture is drawn

        limit = float(self.config["duration"])
        notes = rendering.notes(self.scene, self.scenario, self._met, self._action_name, limit)
        picture = rendering.draw(self.scene, self.task.road(self.config), self.config, notes)
        if self.render_mode != "human":
            return picture
        if self._window is not None and not self._window.show(
            picture, self.task.name, self.task.frequency(self.config)
        ):
            gym.logger.warn("the window was closed: this episode ends, and the next ones have no window")
            self._shut()
            self._is_closed, self.render_mode = True, None
            if self.config.get("manual_control"):  # there are no keys any more
                self.config = {**self.config, "manual_control": False}
        return None

    def _open(self, render_mode: str | None) -> None:
        """Take over the render mode; ValueError if there is no such one."""
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be None, 'rgb_array' or 'human', not {render_mode!r}")
        self.render_mode = render_mode
        if render_mode == "human":
            from sumo_env.env.window import Window  # pygame is imported where there is a window

            self._window = Window()

    def _shut(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def _chosen(self, action: Any) -> Any:
        """The action, or under ``manual_control`` that of the keys."""
        if self.config.get("manual_control") and self._window is not None:
            action = self._window.action(self._action_type)
        if np.ndim(action) == 0 and self.render_mode is not None:
            self._action_name = self._action_type.names.get(np.asarray(action).item(), "")
        return action

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

    @property
    def _is_watched(self) -> bool:
        """Whether somebody sees every simulation step."""
        return self._window is not None or (self._video is not None and self._video.recording)

    def _film(self, scenes: Sequence[Scene]) -> None:
        """Show the scenes of a policy step in the window, or add all but the last one to the film, which has that."""
        for scene in scenes if self._window is not None else scenes[:-1]:
            self.scene = scene
            if self._window is not None:
                self.render()
            elif self._video is not None and not self._is_closed:
                self._video._capture_frame()
