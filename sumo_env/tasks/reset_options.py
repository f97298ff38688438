"""What `reset` may be asked for beside the configuration: other values of a task, or a scenario to start from."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sumo_env.config import ConfigError, keys_of
from sumo_env.tasks.base import Task
from sumo_env.traffic.tilt import TILTED

VARIED = ("risk_rates", "risk_ranges", "calibration")  # parts of a task that `reset` may change
OPTIONS = ("config", "scenario", *VARIED, *TILTED)


def given(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """The options of a reset. Raises ConfigError where they are no dict."""
    return dict(keys_of(options, "reset's options", "{'config': {'risk': 0.5}}"))


def checked(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """The options of a reset. Raises ConfigError for an unknown one, or for a scenario beside what draws another."""
    asked, drawing = given(options), (*VARIED, *TILTED)
    if asked.keys() - set(OPTIONS) or ("scenario" in asked and asked.keys() & set(drawing)):
        raise ConfigError(
            f"reset's options are 'config' and either 'scenario' or {', '.join(map(repr, drawing))}, not {options!r}"
        )
    return asked


def varied(task: Task, options: Mapping[str, Any], risk: float) -> Task:
    """The task with the values that the options give it. Raises ConfigError for wrong ones, and without effect."""
    changes = {part: options[part] for part in VARIED if part in options}
    changed = task.varied(changes) if changes else task
    for part in ("risk_rates", "risk_ranges"):
        if risk == 0.0 and any(map(np.any, changes.get(part, {}).values())):
            raise ConfigError(f"options[{part!r}] has no effect at risk 0: set the config key 'risk' too")
    return changed
