"""What a learner is: settings and a function, so that a study knows no more of it.

`agents.learners` has them by name; a learner of your own is an object with the attributes of `Learner` in a file,
FILE:NAME. `agents.sb3` has learners of another library.

* ``Settings``: a frozen dataclass with the properties ``steps`` (environment steps of a training) and ``updates``
  (gradient updates), and, where packages apart from numpy and torch decide the bits, ``packages`` (their names).
  Its fields are the profile, its comments the help, `settings_of` the check: a name that it does
  not have is an error. They are plain values: a study names its cells by them, so a file is named by its SHA-256.
* ``train(make_env, settings, seed, *, progress)``: `make_env()` gives an environment whose episodes follow
  from the training's seed, whatever `reset` is given; `make_env(n)` gymnasium's vector environment of n of them, which
  share the episodes out. Traffic and rules of the training are in them. `progress` is called with environment steps.
* ``load(path, settings, env)``: the policy of a file that `Trained.policy.save` has written. It needs no more than
  ``act(observation)``; a ``reset(seed)`` is called when an episode begins.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import gymnasium as gym
import numpy as np

from agents.plugins import unknown

MakeEnv = Callable[..., Any]  # make_env() -> gym.Env, make_env(n) -> gym.vector.VectorEnv
T = TypeVar("T")


class SavedPolicy(Protocol):
    """What can act and be written to a file (`agents.greedy.Greedy` is one)."""

    def act(self, observation: np.ndarray) -> int:
        """The action for an observation."""

    def save(self, path: Path) -> None:
        """Write the file that the learner's `load` reads."""


@dataclass(frozen=True)
class Trained:
    """What a training leaves behind.

    episodes: an array a column, a row a training episode, at least of step (environment steps after it), return, length
    and crashed. record: plain values by name: "steps", "updates"; of a learner of Q-values also "probe_q" (update, mean
    and largest max |Q| on some observations) and "q_bound" (that no true value exceeds), and if it clips the goals of
    its updates "goals_clipped" (update, share since the row before).
    """

    policy: SavedPolicy
    episodes: dict[str, np.ndarray]
    record: dict[str, Any]


class Learner(Protocol):
    """See the module."""

    Settings: type[Any]

    def train(
        self,
        make_env: MakeEnv,
        settings: Any,
        seed: int,
        *,
        progress: Callable[[int], None] = lambda _: None,
    ) -> Trained:
        """Train an agent; the same arguments give the same one, to the bit.

        So one that is killed is begun again.

        Raises:
            ValueError: settings or spaces that do not fit.
        """

    def load(self, path: Path, settings: Any, env: gym.Env[Any, Any]) -> Any:
        """A trained policy. ValueError for the weights of another one, DamagedFile for a damaged file."""


def settings_of(cls: type[T], given: Mapping[str, Any], whose: str) -> T:
    """A dataclass of settings with these values.

    Args:
        whose: what they are the settings of, for the message ("the learner dqn").

    Raises:
        ValueError: a name that is no setting, with the nearest one; or a value that makes no sense.
    """
    known = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
    for name in given:
        if name not in known:
            raise unknown("setting", name, known, f" of {whose}")
    return cls(**given)


def check_numbers(settings: Any, may_be_0: Sequence[str] = ()) -> None:
    """Check the values of a dataclass of settings.

    Raises:
        ValueError: another type than the default's, or a number that is not finite and above 0.
    """
    for field in dataclasses.fields(settings):
        value, default = getattr(settings, field.name), field.default
        fits = type(value) is type(default) or (isinstance(default, float) and type(value) is int)
        if fits and isinstance(value, int | float) and not isinstance(value, bool):
            fits = 0 < value < float("inf") or (value == 0 and field.name in may_be_0)
        if not fits:
            kinds = {str: "text", bool: "true or false", int: f"a whole number above 0 such as {default!r}"}
            kind = kinds.get(type(default), f"a number above 0 such as {default!r}")
            raise ValueError(f"{field.name} must be {kind}, got {value!r}")
