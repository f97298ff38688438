"""The environment with every sub-step on record, for measurements that a scene a second is too coarse for."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from sumo_env.env import DrivingEnv
from sumo_env.scene import Scene


class RecordedEnv(DrivingEnv):
    """A `DrivingEnv` that keeps the scenes of an episode.

    Attributes:
        scenes: the first scene and that after every sub-step, in order.
    """

    scenes: list[Scene]

    def reset(self, **arguments: Any) -> tuple[NDArray[Any], dict[str, Any]]:
        """Start an episode and a new record."""
        result = super().reset(**arguments)
        self.scenes = [self.scene]
        return result

    def step(self, action: int) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Drive one policy step; its last scene is the one that the observation is made of."""
        result = super().step(action)
        self.scenes.append(self.scene)
        return result

    def _on_substep(self, scene: Scene) -> None:
        self.scenes.append(scene)

    def _shows_trajectories(self) -> bool:
        return True  # which asks the world for every sub-step
