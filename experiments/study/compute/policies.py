"""The policy of a cell: a rule, a trained network, or one that the user brought."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym

from agents.files import DamagedFile
from agents.plugins import foreign
from agents.policies import Policy, as_policy, foreign_policy
from agents.rules import make_policy
from experiments.study.compute.wrappers import believing, observed
from experiments.study.design.cell import learner_of
from experiments.study.design.training_rules import TrainingRules
from experiments.support.errors import UserError, in_words
from sumo_env.spaces.actions import DiscreteMetaAction

if TYPE_CHECKING:
    from agents.greedy import Greedy


def check(source: str, profile: Mapping[str, Any]) -> None:
    """Raise UserError unless the user's file is the one that the cell was named by, ValueError without a file."""
    _, digits = foreign(source)
    if digits not in (profile.get(f"{part}_sha256") for part in ("learner", "network", "policy")):
        raise UserError(
            f"{source} is not the file of the cell, or has changed since: its SHA-256 is another one"
        )


@in_words((ValueError, DamagedFile))
def driver(
    key: Mapping[str, Any],
    source: str | None,
    env: gym.Env[Any, Any],
    weights: Path | None = None,
    second: Path | None = None,
) -> tuple[gym.Env[Any, Any], Policy]:
    """The policy of a cell, and the environment as it observes it.

    source: FILE:NAME or a zip file of the user's own policy, network or learner, as the user has named it; None for one
    of ours. weights: of a trained agent, None for a policy that is not trained here. second: of a pair's other agent.

    Raises:
        UserError: the user's file is not named, not there, has changed or does not fit, or the weights belong to
            another network.
    """
    if source is not None:
        check(source, key["profile"])
    if weights is None:
        return env, foreign_policy(source, env) if source else make_policy(key["policy"], env)
    env = observed(env, TrainingRules.of(key["profile"]))
    learner, settings = learner_of(key, source)
    agent = as_policy(learner.load(weights, settings, env), f"load of the learner {key['policy']}")
    if second is None:
        return env, agent
    from agents.greedy import Greedy  # here: not every command needs torch

    other = learner.load(second, settings, env)
    if not (isinstance(agent, Greedy) and isinstance(other, Greedy)):
        raise UserError(f"agents of the learner {key['policy']} have no Q-values, which a pair needs")
    return together(env, key["pair"], agent, other)


def together(
    env: gym.Env[Any, Any], pair: Mapping[str, Any], control: Greedy, treated: Greedy
) -> tuple[gym.Env[Any, Any], Policy]:
    """Two agents who drive as one, and the environment as they observe it.

    pair: as in `cell.Cell`.
    """
    from agents.belief import Rule, Together

    inner: Any = env.unwrapped
    by_caution = DiscreteMetaAction(inner.actions, ()).by_caution
    return believing(env, pair), Together(control, treated, by_caution, Rule(**pair["rule"]))
