"""Drivers that do not learn: the marks that a trained agent is held against."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym

from agents.plugins import unknown
from agents.policies import Policy
from agents.rules.careful import Careful
from agents.rules.constant import BySumo, Constant, Random
from agents.rules.idm import IDM
from agents.rules.planner import Planner

POLICIES = ("idle", "random", "faster", "slower", "idm", "careful")
DRIVERS = ("planner", "clairvoyant", "sumo")  # who take long, or drive by another's rules
# The careful driver at other cautions: with the constant policies, how many crashes a speed costs without learning.
CAUTIONS = {"careful-0.1": 0.1, "careful-0.5": 0.5, "careful": 1.0, "careful-2": 2.0, "careful-4": 4.0}
MAKERS: dict[str, Callable[[gym.Env[Any, Any]], Policy]] = {
    **{name: partial(Careful, caution=caution) for name, caution in CAUTIONS.items()},
    "idm": IDM,
    "sumo": BySumo,
    "planner": partial(Planner, foresees=False),
    "clairvoyant": partial(Planner, foresees=True),
}


def make_policy(name: str, env: gym.Env[Any, Any]) -> Policy:
    """The driver of this name for ``env``, whose ``unwrapped.actions`` maps action numbers to names.

    "idle", "faster" and "slower" repeat one meta-action, "random" draws uniformly, "idm" is
    :class:`agents.rules.idm.IDM`, "careful" :class:`agents.rules.careful.Careful`, "careful-2" the same with twice the
    caution (see CAUTIONS). "planner" is :class:`agents.rules.planner.Planner` with imagined copies, "clairvoyant" the
    same with copies that know the future; these two need an environment that can be copied. "sumo" is SUMO's own
    driver, who needs an environment on SUMO.

    Raises:
        ValueError: unknown name, or an action that the environment lacks.
    """
    actions: dict[int, str] = env.unwrapped.actions  # type: ignore[attr-defined]
    if name == "random":
        return Random(len(actions))
    if name in MAKERS:
        return MAKERS[name](env)
    if name not in POLICIES:
        raise unknown("policy", name, dict.fromkeys((*POLICIES, *MAKERS)))
    for number, action in actions.items():
        if action == name.upper():
            return Constant(number)
    raise ValueError(f"{name!r} needs the action {name.upper()}; there are {', '.join(actions.values())}.")
