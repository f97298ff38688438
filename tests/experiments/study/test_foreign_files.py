"""Files of other people: what they name is neither run nor read, and nothing is written through their links."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from contextlib import nullcontext
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

import agents
from agents import pretrained
from agents.episodes import Episodes
from agents.files import DamagedFile, atomic
from agents.greedy import Greedy
from agents.models import DuelingMLP, EgoAttention
from agents.plugins import sha256
from experiments.reporting.page import LARGEST, films
from experiments.study.compute.policies import driver
from experiments.study.compute.run import locked, log, watched
from experiments.study.design.cell import learner_of
from experiments.study.replaying.rerun import Case, play_again
from experiments.study.results.loaded import load
from experiments.study.results.store import DamagedCell, Store
from experiments.study.results.working import LOCK, LOG, PROGRESS, fraction_done
from experiments.support.errors import UserError, run_command
from experiments.support.files import alone, made
from experiments.support.films import save_gif
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


@pytest.mark.parametrize(("place", "kind"), [("cells", "pipe"), ("cells", "folder"), ("parts", "device")])
def test_what_is_no_file_is_not_read(results: Path, place: str, kind: str) -> None:
    if place == "parts":
        Store(results).pack()
    file = min((results / place).iterdir())
    file.unlink()
    if kind == "pipe":
        os.mkfifo(file)
    elif kind == "device":
        file.symlink_to("/dev/zero")
    else:
        file.mkdir()
    if place == "cells":
        assert "is damaged" in load(results).damaged[file.stem]
    else:
        with pytest.raises(UserError, match=rf"{file.name} is damaged"):
            load(results)


BESIDE = ["weights/{}.npz", "training/{}.parquet"]


@pytest.mark.parametrize(
    ("place", "is_packed"),
    [*((place, False) for place in ("cells/{}.parquet", "work/{}/log.txt")), *product(BESIDE, (False, True))],
)
def test_no_link_is_followed(results: Path, tmp_path: Path, place: str, is_packed: bool) -> None:
    """A private file would come into the report, or go to whoever gets the folder."""
    name = min(Store(results).agents())
    if is_packed:
        Store(results).pack()
    file = results / place.format(name)
    made(file.parent)
    if file.exists():
        file.rename(tmp_path / "private")
    else:
        (tmp_path / "private").write_text("secret")
        Store(results)._own(name).unlink()
    file.symlink_to(tmp_path / "private")
    if "log" in place:
        assert not Store(results).failures()
    else:
        with pytest.raises(DamagedCell, match="a link lies in its place"):
            Store(results).is_whole(name)


def test_a_film_is_a_picture_and_no_link(tmp_path: Path) -> None:
    """What lies there comes into a report, which people send to each other."""
    film, long, private = (tmp_path / name for name in ("film.gif", "long.gif", "private.gif"))
    film.write_bytes(b"GIF89a...")
    long.write_bytes(b"GIF89a...")
    os.truncate(long, LARGEST + 1)
    private.write_text("secret")
    (tmp_path / "link.gif").symlink_to(film)
    (tmp_path / "folder.gif").mkdir()
    assert list(films(tmp_path)) == ["film.gif"]


# The name of a link in a folder, and what writes there in its place.
OUTPUTS: dict[str, Callable[[Path], Any]] = {
    ".out.json.{pid}.tmp": lambda folder: atomic(folder / "out.json"),
    "film.gif": lambda folder: save_gif([Image.new("RGB", (4, 4))], folder / "film.gif"),
    LOG: lambda folder: log(folder, "words"),
    PROGRESS: lambda folder: watched(folder, 60.0),
    ".lock": alone,
    LOCK: locked,
}


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_link_in_the_place_of_an_output_is_not_followed(name: str, tmp_path: Path) -> None:
    precious, folder = tmp_path / "precious", made(tmp_path / "folder")
    precious.write_text("mine")
    (folder / name.format(pid=os.getpid())).symlink_to(precious)
    with OUTPUTS[name](folder) or nullcontext():
        pass
    assert precious.read_text() == "mine"


@pytest.mark.parametrize("kind", ["parts", "work", "cells", "damaged"])
def test_a_link_in_the_place_of_a_folder_is_not_followed(kind: str, results: Path, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    shutil.rmtree(results / kind, ignore_errors=kind != "cells")
    (results / kind).symlink_to(precious)
    with pytest.raises(OSError, match="a link lies in its place"):
        made(results / kind)
    with pytest.raises(OSError, match="a link lies in its place"):
        if kind == "parts":
            Store(results).pack()
        elif kind == "damaged":
            Store(results).put_aside(min((results / "cells").iterdir()).stem)
        else:
            Store(results).write_sweep("sweep", [])
    assert not list(precious.iterdir())


@pytest.mark.parametrize("file", [LOG, PROGRESS])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_files_beside_the_cells_are_no_trap(file: str, kind: str, results: Path) -> None:
    place = made(results / "work" / "cell") / file
    if kind == "pipe":
        os.mkfifo(place)
    else:
        place.symlink_to("/dev/zero")
    Store(results).failures()
    assert fraction_done(results / "work" / "cell") == 0.0


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


def test_a_name_does_not_command_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever a command prints, and however."""
    words, shown = "\x1b]0;evil\x07 and\u202e other words", "\\x1b]0;evil\\x07 and\\u202e other words\n"

    def command() -> int:
        print(words)
        print(words, file=sys.stderr)
        raise UserError(words)

    with pytest.raises(SystemExit):
        run_command(command)
    assert capsys.readouterr() == (shown, f"{shown}error: {shown}")


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
