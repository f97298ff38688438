"""Drivers that do not learn: the marks that a trained agent is held against."""

from __future__ import annotations

from typing import Any

import gymnasium as gym

from agents.policies import Policy
from agents.rules.careful import Careful
from agents.rules.constant import Constant, Random
from agents.rules.idm import IDM

POLICIES = ("idle", "random", "faster", "slower", "idm", "careful")


def make_policy(name: str, env: gym.Env[Any, Any]) -> Policy:
    """The driver of this name for ``env``, whose ``unwrapped.actions`` maps action numbers to names.

    "idle", "faster" and "slower" repeat one meta-action, "random" draws uniformly, "idm" is
    :class:`agents.rules.idm.IDM`, "careful" :class:`agents.rules.careful.Careful`. Raises ValueError for an unknown
    name or an action that the environment lacks.
    """
    actions: dict[int, str] = env.unwrapped.actions  # type: ignore[attr-defined]
    if name == "random":
        return Random(len(actions))
    if name == "idm":
        return IDM(env)
    if name == "careful":
        return Careful(env)
    if name not in POLICIES:
        raise ValueError(f"Unknown policy {name!r}: choose one of {', '.join(POLICIES)}.")
    for number, action in actions.items():
        if action == name.upper():
            return Constant(number)
    raise ValueError(
        f"The policy {name!r} needs the action {name.upper()}; there are {', '.join(actions.values())}."
    )
