"""What the agent sees, as pictures: highway-env's GrayscaleObservation, as a function of the scenes of an episode."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from sumo_env.config import GRAYSCALE, ConfigError
from sumo_env.spaces.actions import Situation

LARGEST = 1000  # [px] of a picture, and pictures of a stack


class Grayscale:
    """highway-env's `GrayscaleObservation`: the last pictures of an episode in grey, the newest one last.

    Pictures show what highway-env's do, in its colours: the road and the vehicles, and traffic lights where there are
    some, which red, yellow and green make dark, bright and grey. They do not tell of risk events. At the start of an
    episode all pictures but the newest are 0.
    """

    def __init__(self, config: Mapping[str, Any], view: Mapping[str, Any]) -> None:
        """Make an entry ``observation``. Raises ConfigError: shape, number of pictures or camera make no sense.

        view: the configuration, whose ``scaling`` and ``centering_position`` hold where that entry has none.
        """
        given = {**GRAYSCALE, **config}
        width, height = given["observation_shape"]
        self.shape = given["stack_size"], width, height
        if not all(isinstance(size, int) and 1 <= size <= LARGEST for size in self.shape):
            raise ConfigError(f"'stack_size', 'observation_shape' must be 1 to {LARGEST}, not {self.shape}")
        scaling, centre = (given[key] or view[key] for key in ("scaling", "centering_position"))
        try:
            view = {"scaling": float(scaling), "centering_position": [float(share) for share in centre]}
        except (TypeError, ValueError):
            view = {"scaling": 0.0}
        if not view["scaling"] > 0.0 or len(view["centering_position"]) != 2:
            raise ConfigError(
                "observation 'scaling' must be pixels per metre and 'centering_position' two shares of the picture, "
                f"not {scaling!r} and {centre!r}"
            )
        self._view = {"screen_width": width, "screen_height": height, **view}
        self._weights = np.array(given["weights"], float)
        self.space = spaces.Box(0, 255, self.shape, np.uint8)
        self._pictures = np.zeros(self.shape, np.uint8)

    def observe(self, seen: Situation) -> NDArray[np.uint8]:
        """The pictures, uint8 of shape (stack_size, width, height)."""
        # Pillow is imported when the first picture is drawn
        from sumo_env.rendering.scenery import HIGHWAY_ENVS, Camera, scenery

        paint = HIGHWAY_ENVS.in_grey(self._weights)
        picture = scenery(seen.scene, seen.road, Camera.of(seen.scene, self._view), paint, "L")
        before = np.zeros_like(self._pictures) if seen.is_first else self._pictures
        self._pictures = np.concatenate((before[1:], np.asarray(picture).T[None]))
        return self._pictures
