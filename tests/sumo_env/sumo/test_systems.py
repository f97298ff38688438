"""Systems that lack what Linux has: each capability is taken away in turn, and workers and copies do as before."""

from __future__ import annotations

import copy
import socket
from contextlib import closing
from typing import Any

import gymnasium as gym
import pytest

from sumo_env.sumo import link
from sumo_env.sumo.process import SimulatorDied, SumoProcess
from tests.sumo_env.rollout import assert_same_bits, drive
from tests.sumo_env.sumo.fake import COMMAND, FAKE, scenario

ACTIONS = [1, 0, 2, 3, 1, 4]


@pytest.fixture
def no_fork(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows and macOS: a process that has loaded SUMO is not forked."""
    monkeypatch.setattr(link, "FORKS", False)
    monkeypatch.setattr("sumo_env.sumo.process._Worker.fork", None)


@pytest.mark.parametrize("lacking", ["no_inheritance", "no_fork"])
def test_workers_and_copies_drive_the_same_episode(lacking: str, request: pytest.FixtureRequest) -> None:
    request.getfixturevalue(lacking)
    ids = ["sumo/roundabout-v0"] * 2
    with closing(gym.make(ids[0])) as here, closing(gym.make(ids[1])) as there:
        for env in (here, there):
            env.reset(seed=3)
        envs: list[Any] = [here, there]
        for first, second in zip(*(drive(env, ACTIONS[:3]) for env in envs), strict=True):
            assert_same_bits(first, second)
        copies = [copy.deepcopy(env) for env in envs]
        copies.append(copy.deepcopy(copies[0]))
        copies += [env.unwrapped.imagine(5) for env in envs]
        for first, *others in zip(*(drive(env, ACTIONS[3:]) for env in (*envs, *copies)), strict=True):
            for other in others[:-2]:
                assert_same_bits(first, other)
            assert_same_bits(*others[-2:])
        for env in copies:
            env.close()


def test_a_worker_that_dies_before_it_connects_is_named(
    no_inheritance: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "interpreter", lambda: "/bin/false")
    monkeypatch.setattr(link, "PATIENCE", 0.05)
    simulator = SumoProcess(FAKE)
    with pytest.raises(SimulatorDied, match="ended with exit code 1"):
        simulator.reset(scenario(3))


def test_who_does_not_know_the_key_is_not_answered(
    no_inheritance: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another user of the machine connects first, with a key of their own."""
    create, strangers = socket.create_server, []

    def with_strangers(*arguments: Any, **keywords: Any) -> socket.socket:
        server = create(*arguments, **keywords)
        for key in (b"", b"0" * link.KEY):
            stranger = socket.create_connection(server.getsockname())
            strangers.append(stranger)
            if key:
                stranger.sendall(key)
            else:
                stranger.shutdown(socket.SHUT_WR)
        return server

    monkeypatch.setattr(socket, "create_server", with_strangers)
    simulator = SumoProcess(FAKE)
    with closing(simulator):
        simulator.reset(scenario(3))
        simulator.step({"ego": COMMAND})
        for stranger in strangers:
            stranger.settimeout(5.0)
            assert stranger.recv(1) == b""
            stranger.close()
