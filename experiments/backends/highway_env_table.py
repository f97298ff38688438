"""highway-env's observations as the study uses them: with ranges, and the features of `sumo_env.spaces.approach`."""

from typing import Any

import numpy as np
import pandas as pd
from highway_env.envs.common import observation
from highway_env.envs.common.observation import ExitObservation, KinematicObservation

from sumo_env.spaces.approach import APPROACH, approach
from sumo_env.spaces.factory import ObservationType
from sumo_env.spaces.observation import RELATIVE, Kinematics, TableForm


class ApproachTable(KinematicObservation):
    """`KinematicObservation` in which these features may be named.

    highway-env makes a table of its own features and calls `normalize_obs`, which adds the others before empty rows and
    shuffling.

    form: of the same table in `sumo_env`: scales and limits of the columns.
    """

    features: list[str]
    normalize: bool

    def __init__(self, env: Any, form: TableForm, **config: Any) -> None:
        super().__init__(env, **config)
        self._form, self._asked, self._normalizes = form, self.features, self.normalize

    def observe(self) -> np.ndarray:
        """The table."""
        theirs = [name for name in self._asked if name not in APPROACH]
        self.features, self.normalize = [*dict.fromkeys((*theirs, *RELATIVE))], True
        try:
            return super().observe()
        finally:
            self.features, self.normalize = self._asked, self._normalizes

    def normalize_obs(self, df: pd.DataFrame) -> pd.DataFrame:
        """highway-env's table in highway-env's scales, if it is normalised, with the columns that are asked for."""
        ego = np.array([*self.observer_vehicle.position, *self.observer_vehicle.velocity])
        others = df[list(RELATIVE)].to_numpy(float, copy=True)[1:] - ego * self.absolute
        rows = [(0.0,) * len(RELATIVE), *others.tolist()]
        values = dict(zip(APPROACH, np.array([approach(*row) for row in rows]).T, strict=True))
        if self._normalizes:
            df = super().normalize_obs(df)
        for name, *scaling in zip(self._asked, *self._form[2:6], strict=True):
            if name in values:
                scale, shift, low, high = scaling
                df[name] = np.clip(values[name] * scale + shift, low, high)
        self.features = self._asked
        return df


class ApproachExitTable(ApproachTable, ExitObservation):
    """The same of `ExitObservation`."""


def told(env: Any, ours: ObservationType) -> observation.ObservationType:
    """The observation type of an environment of highway-env, which has made its own one.

    Args:
        ours: the same of `sumo_env`, whose features, ranges and absolute it also gets where it has none.
    """
    found = env.observation_type
    if isinstance(ours, Kinematics) and set(ours.features) & set(APPROACH):
        kind = ApproachExitTable if isinstance(found, ExitObservation) else ApproachTable
        found = kind(env, ours.form, **env.config["observation"])
    for name in ("features", "ranges", "absolute"):
        if not hasattr(found, name):
            setattr(found, name, getattr(ours, name))
    return found
