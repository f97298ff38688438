"""The policy of a cell: a rule, a trained network, or one that the user brought."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym

from agents.files import DamagedFile
from agents.plugins import foreign
from agents.policies import Policy, as_policy, foreign_policy
from agents.rules import make_policy
from experiments.study.compute.wrappers import observed
from experiments.study.design.cell import learner_of
from experiments.study.design.training_rules import TrainingRules
from experiments.support.errors import UserError, in_words


def check(source: str, digest: str, profile: Mapping[str, Any]) -> None:
    """Raise UserError unless the user's file is the one that the cell was named by."""
    if digest not in (profile.get(f"{part}_sha256") for part in ("learner", "network", "policy")):
        raise UserError(
            f"{source} is not the file of the cell, or has changed since: its SHA-256 is another one"
        )


@in_words((ValueError, DamagedFile))
def driver(
    key: Mapping[str, Any],
    source: str | None,
    env: gym.Env[Any, Any],
    weights: Path | None = None,
) -> tuple[gym.Env[Any, Any], Policy]:
    """The policy of a cell, and the environment as it observes it.

    source: FILE:NAME or a zip file of the user's own policy, network or learner, as the user has named it; None for one
    of ours. weights: of a trained agent, None for a policy that is not trained here.

    Raises:
        UserError: the user's file is not named, not there, has changed or does not fit, or the weights belong to
            another network.
    """
    if weights is None:
        if source is None:
            return env, make_policy(key["policy"], env)
        policy, digest = foreign_policy(source, env)
        check(source, digest, key["profile"])
        return env, policy
    if source is not None:
        check(source, foreign(source)[1], key["profile"])
    env = observed(env, TrainingRules.of(key["profile"]))
    learner, settings = learner_of(key, source)
    return env, as_policy(learner.load(weights, settings, env), f"load of the learner {key['policy']}")
