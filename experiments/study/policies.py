"""The policy of a cell: a rule, a trained network, or one that the user brought."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym

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


def untrained_policy(key: Mapping[str, Any], source: str | None, env: gym.Env[Any, Any]) -> Policy:
    """The policy of a cell that was not trained here. source: FILE:MAKE or a zip file, None for a rule.

    Raises:
        UserError: the file is not there, has changed, or does not fit the environment.
    """
    if source is None:
        return make_policy(key["policy"], env)
    check(source, key["profile"]["policy_sha256"])
    try:
        return foreign_policy(source, env)
    except ValueError as error:
        raise UserError(str(error)) from None


def check(source: str, expected: str) -> None:
    """Raise UserError unless the file is the one that the cell was named by."""
    if foreign(source)[1] != expected:
        raise UserError(f"{source} has changed since the sweep began: run the sweep again")


def load_agent(
    key: Mapping[str, Any], source: str | None, weights: Path, env: gym.Env[Any, Any]
) -> tuple[gym.Env[Any, Any], Policy]:
    """A trained agent, and the environment as it observes it.

    source: FILE:CLASS of a network of the user's own, None for one of ours.

    Raises:
        UserError: the network's file is not there or has changed, or the weights belong to another network.
    """
    from agents.checkpoint import CheckpointError
    from agents.greedy import Greedy
    from agents.models import Standardised, network_class

    env = observed(env, key["profile"])
    if source is not None:
        check(source, key["profile"]["network_sha256"])
    try:
        space: Any = env.observation_space
        actions: Any = env.action_space
        network = network_class(source or key["profile"]["network"])(space, int(actions.n))
        return env, Greedy.load(weights, Standardised(network, space))
    except (ValueError, CheckpointError) as error:
        raise UserError(str(error)) from None
