"""`AbstractEnv`, which the classes of highway-env's names share."""

from collections.abc import Mapping
from typing import Any

from sumo_env.env import DrivingEnv


class AbstractEnv(DrivingEnv):
    """An environment whose class says, by its attribute `task`, which task it is.

    Args:
        config: configuration keys to change.
        render_mode: None, ``"rgb_array"`` or ``"human"``.
        keywords: further ones of `DrivingEnv`.
    """

    def __init__(
        self, config: Mapping[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
    ) -> None:
        super().__init__(self.task, config, render_mode, **keywords)
