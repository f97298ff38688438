"""Where a user sees an environment: pictures, films and a window, with the keys pressed in it (extra ``[window]``)."""

import os
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sumo_env.config import Config, ConfigError, warn_once
from sumo_env.env.episode import Episode
from sumo_env.scene import Scene
from sumo_env.spaces.actions import ActionType, ContinuousAction, DiscreteAction
from sumo_env.tasks.base import Task

PRESSED = 0.7  # of a number from -1 to 1 (``EventHandler.handle_continuous_action_event``)


class Window:
    """Opens with the first picture; a copy of an environment has none."""

    def __init__(self) -> None:
        try:
            import pygame
        except ImportError as error:
            raise ImportError("render_mode='human' needs pygame: pip install pygame-ce") from error
        self._pygame: Any = pygame
        self._clock: Any = pygame.time.Clock()
        self._screen: Any = None
        self._keys: set[int] = set()  # that were pressed since the last action

    def __deepcopy__(self, memo: dict[int, object]) -> None:
        return None

    def show(self, picture: NDArray[np.uint8], title: str, frequency: float) -> bool:
        """Show a picture, at most `frequency` of them in a second [Hz]; False once the user has closed the window."""
        pygame = self._pygame
        height, width, _ = picture.shape
        if self._screen is None or self._screen.get_size() != (width, height):
            pygame.display.init()
            self._screen = pygame.display.set_mode((width, height))
            pygame.display.set_caption(title)
            if pygame.display.get_driver() == "offscreen" and "SDL_VIDEODRIVER" not in os.environ:
                warn_once("no window is seen: it needs a display (the variable DISPLAY)")
        self._screen.blit(pygame.surfarray.make_surface(picture.swapaxes(0, 1)), (0, 0))
        pygame.display.flip()
        self._clock.tick(frequency)
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                return False
            if event.type == pygame.KEYDOWN:
                self._keys.add(event.key)
        return True

    def action(self, kind: ActionType) -> Any:
        """The action that the arrow keys ask for, as in highway-env: IDLE, or zeros, without any."""
        pygame, names = self._pygame, ("UP", "DOWN", "LEFT", "RIGHT")
        held = pygame.key.get_pressed() if self._screen is not None else ()
        keys = {
            name
            for name in names
            if (key := getattr(pygame, f"K_{name}")) in self._keys or (held and held[key])
        }
        self._keys.clear()
        if isinstance(kind, DiscreteAction):
            raise ConfigError("'manual_control' needs 'DiscreteMetaAction' or 'ContinuousAction'")
        if isinstance(kind, ContinuousAction):
            pedals, turn = (("UP" in keys) - ("DOWN" in keys)), (("RIGHT" in keys) - ("LEFT" in keys))
            numbers = [*([pedals] if kind.longitudinal else []), *([turn] if kind.lateral else [])]
            return np.array(numbers, np.float32) * np.float32(PRESSED)
        wanted = {"RIGHT": "FASTER", "LEFT": "SLOWER", "DOWN": "LANE_RIGHT", "UP": "LANE_LEFT"}
        asked = {wanted[key] for key in keys} or {"IDLE"}
        numbers_of = {name: number for number, name in kind.names.items()}
        return next((numbers_of[name] for name in sorted(asked) if name in numbers_of), numbers_of["IDLE"])

    def close(self) -> None:
        """Close the window."""
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None


class Screen:
    """Shows the scenes of an environment."""

    def __init__(self, render_mode: str | None, render_modes: Sequence[str]) -> None:
        if render_mode not in (None, *render_modes):
            raise ValueError(f"render_mode must be None, 'rgb_array' or 'human', not {render_mode!r}")
        self.window = Window() if render_mode == "human" else None
        self.video: gym.wrappers.RecordVideo[Any, Any] | None = None  # films every simulation step
        self.action_name = ""  # of the last meta-action of this episode, which pictures show
        self.contact: Scene | None = None  # at the ego's contact in the last policy step, if that was watched

    @property
    def is_watched(self) -> bool:
        """Whether somebody sees every simulation step."""
        return self.window is not None or (self.video is not None and self.video.recording)

    def chosen(self, action: Any, kind: ActionType, manual: bool) -> Any:
        """The action, or under ``manual_control`` that of the keys."""
        if manual and self.window is not None:
            action = self.window.action(kind)
        if np.ndim(action) == 0:
            self.action_name = kind.names.get(np.asarray(action).item(), "")
        return action

    def picture(self, scene: Scene, episode: Episode, task: Task, config: Config) -> NDArray[np.uint8]:
        """A scene of an episode, with notes."""
        from sumo_env import rendering  # Pillow is imported when the first picture is drawn

        limit = float(config["duration"])
        notes = rendering.notes(scene, episode.scenario, episode.met, self.action_name, limit)
        return rendering.draw(scene, task.road(config), config, notes)

    def show(self, picture: NDArray[np.uint8], title: str, frequency: float) -> bool:
        """Show a picture in the window, if there is one; False once the user has closed it."""
        if self.window is None or self.window.show(picture, title, frequency):
            return True
        gym.logger.warn("the window was closed: this episode ends, and the next ones have no window")
        self.close()
        return False

    def close(self) -> None:
        """Close the window, if there is one."""
        if self.window is not None:
            self.window.close()
            self.window = None
