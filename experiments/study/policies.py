"""The policy of a cell: a rule, a trained network, or one that the user brought."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym

from agents.checkpoint import CheckpointError
from agents.plugins import sha256, split
from agents.policies import Policy, foreign_policy
from agents.rules import make_policy
from experiments.study.wrappers import observed
from experiments.support.errors import UserError


def foreign(name: str) -> tuple[str, str]:
    """Label and fingerprint of something in a user's file, "FILE:NAME" or "model.zip".

    The label names the file without its folder, so that a cell is called the same wherever the file lies.

    Raises:
        UserError: there is no such file.
    """
    try:
        path, attribute = (Path(name), "") if name.endswith(".zip") else split(name)
        return f"{path.name}:{attribute}" if attribute else path.name, sha256(path)
    except OSError:
        raise UserError(f"there is no file {name}") from None
    except ValueError as error:
        raise UserError(str(error)) from None


def check(source: str, expected: str) -> None:
    """Raise UserError unless the file is the one that the cell was named by."""
    if foreign(source)[1] != expected:
        raise UserError(f"{source} has changed since the sweep began: run the sweep again")


def driver(
    key: Mapping[str, Any], source: str | None, env: gym.Env[Any, Any], weights: Path | None = None
) -> tuple[gym.Env[Any, Any], Policy]:
    """The policy of a cell, and the environment as it observes it.

    source: FILE:NAME or a zip file of the user's own policy or network, None for one of ours. weights: of a trained
    agent, None for a policy that is not trained here.

    Raises:
        UserError: the user's file is not there, has changed or does not fit, or the weights belong to another network.
    """
    if source is not None:
        check(source, key["profile"]["network_sha256" if weights else "policy_sha256"])
    try:
        if weights is None:
            return env, foreign_policy(source, env) if source else make_policy(key["policy"], env)
        from agents.greedy import Greedy  # here: other policies need no learner
        from agents.models import Standardised, network_class

        env = observed(env, key["profile"])
        space: Any = env.observation_space
        actions: Any = env.action_space
        network = network_class(source or key["profile"]["network"])(space, int(actions.n))
        return env, Greedy.load(weights, Standardised(network, space))
    except (ValueError, CheckpointError) as error:
        raise UserError(str(error)) from None
