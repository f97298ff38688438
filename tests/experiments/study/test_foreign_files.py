"""Files of other people run no code, and what a user can put right is said in a line."""

import io
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import agents
from agents import pretrained
from agents.episodes import Episodes
from agents.files import DamagedFile
from agents.greedy import Greedy
from agents.models import DuelingMLP, EgoAttention
from agents.plugins import sha256
from experiments.study.compute.policies import driver
from experiments.study.design.cell import learner_of
from experiments.study.replaying.rerun import Case, play_again
from experiments.study.results.store import Store
from experiments.support.errors import UserError, run_command, writing
from tests.experiments.fake_env import FakeEnv


@pytest.fixture
def evil(tmp_path: Path) -> Path:
    """A file that leaves a trace when it is run."""
    file = tmp_path / "evil.py"
    file.write_text(
        f"open({str(tmp_path / 'trace')!r}, 'w')\nclass Net: pass\nNet.Settings = Net.train = Net.load = Net\n"
    )
    return file


def key_of(policy: str, **profile: str) -> dict[str, Any]:
    common = {"kind": "agent", "task": "u-turn", "level": 1, "arm": "control"}
    return {**common, "policy": policy, "profile": profile}


@pytest.mark.parametrize("where", ["network", "learner", "rule"])
def test_code_that_a_record_names_is_not_run(where: str, evil: Path, tmp_path: Path) -> None:
    name, weights = f"{evil}:Net", tmp_path / "weights.npz"
    key = key_of("dqn" if where == "network" else name, **({"network": name} if where == "network" else {}))
    key["profile"] |= {f"{part}_sha256": sha256(evil) for part in ("network", "learner", "policy")}
    row = {"traffic": "regular", "scenario": 0}
    record = {"key": {**key, "kind": "baseline"} if where == "rule" else key, "source": name}
    with pytest.raises(UserError):
        driver(key, None, FakeEnv("u-turn", {"duration": 20}), None if where == "rule" else weights)
    with pytest.raises(UserError):
        play_again(Case(Store(tmp_path), "cell", record, row), FakeEnv("u-turn", {"duration": 20}))
    if where != "rule":
        with pytest.raises(UserError, match="--code"):
            learner_of(key, None)
    if where == "network":  # code that the user names has to be the cell's
        mine = tmp_path / "mine.py"
        mine.write_text("class Net: pass\n")
        with pytest.raises(UserError, match="not the file of the cell"):
            driver(key, f"{mine}:Net", FakeEnv("u-turn", {"duration": 20}), weights)
    assert not (tmp_path / "trace").exists()


def test_an_agent_s_card_runs_nothing(evil: Path, tmp_path: Path) -> None:
    file = tmp_path / "agents.npz"
    with np.load(pretrained.FILE) as stored:
        arrays = dict(stored)
    cards = json.loads(str(arrays[pretrained.CARDS]))
    cards["u-turn-3/control"]["network"] = f"{evil}:Net"
    np.savez(file, **{**arrays, pretrained.CARDS: np.array(json.dumps(cards))})
    with pytest.raises(ValueError, match="network="):
        agents.load("u-turn-3", "control", file)
    assert not (tmp_path / "trace").exists()
    ours, given = agents.load("u-turn-3", "control"), agents.load("u-turn-3", "control", file, EgoAttention)
    observation = np.zeros(cards["u-turn-3/control"]["observations"], np.float32)
    assert np.array_equal(given.q(observation), ours.q(observation))


@pytest.mark.parametrize(
    ("error", "word"),
    [
        (OSError(28, "No space left on device"), "no space left"),
        (PermissionError(13, "Permission denied", "x.parquet"), "x.parquet: Permission denied"),
        (ModuleNotFoundError("No module named 'highway_env'"), "highway_env"),
    ],
)
def test_what_a_user_can_put_right_is_said_in_a_line(
    error: Exception, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> int:
        raise error

    with pytest.raises(SystemExit) as ended:
        run_command(command)
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.startswith("error: ") and said.count("\n") == 1
    assert word in said


@pytest.mark.parametrize("ends", [int, sys.exit])  # at its end, or while it is parsed (--help)
def test_a_reader_that_leaves_is_no_problem(
    ends: Callable[[], Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As ``head -1`` does."""

    def command() -> int:
        print("words")
        return int(ends())

    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as out, pytest.raises(SystemExit) as ended:
        monkeypatch.setattr(sys, "stdout", out)
        run_command(command)
    assert (ended.value.code, capsys.readouterr().err) == (1, "")


def test_any_terminal_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that has not all characters, none at all (a daemon), and one whose reader has left in a folder's work."""

    def command() -> int:
        print("a − b")
        return 0

    for stream in (io.TextIOWrapper(written := io.BytesIO(), encoding="latin-1"), None):
        monkeypatch.setattr(sys, "stdout", stream)
        with pytest.raises(SystemExit) as ended:
            run_command(command)
        assert ended.value.code == 0
    assert written.getvalue() == b"a ? b\n"
    with pytest.raises(BrokenPipeError), writing(Path()):
        raise BrokenPipeError


def test_weights_and_values_are_numbers(tmp_path: Path) -> None:
    space = gym.spaces.Box(-1, 1, (2, 5), np.float32)
    network = DuelingMLP(space, 5)
    for weights in network.parameters():
        weights.data.fill_(np.nan)
    Greedy(network).save(tmp_path / "weights.npz")
    with pytest.raises(DamagedFile, match=r"weights\.npz: the weights .* are not finite"):
        Greedy.load(tmp_path / "weights.npz", DuelingMLP(space, 5))


def test_rewards_are_numbers() -> None:
    class Lost(FakeEnv):
        def step(self, action: int) -> Any:
            return None, float("nan"), False, False, {}

    env = Episodes(Lost("u-turn", {"duration": 20}))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="the reward of training step 1 is nan, not a finite number"):
        env.step(1)
