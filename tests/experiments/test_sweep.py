"""The sweep: complete, resumable after any kill, shared between processes, and clear about what goes wrong."""

import json
import os
import random
import shutil
import signal
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from experiments.analysis.analysis import analyse
from experiments.analysis.comparable import comparable
from experiments.replay import Options as ReplayOptions
from experiments.replay import replay
from experiments.study.design.arms import TEST
from experiments.study.design.experiment import shard
from experiments.study.design.presets import cells_of, of_preset
from experiments.study.results.loaded import load
from experiments.support.errors import UserError
from experiments.sweep import Options, sweep
from tests.experiments.computed import TINY, compute, fingerprint, tasks_of
from tests.experiments.fake_env import FakeEnv, make_env
from tests.experiments.test_errors import FILES
from tests.processes import ROOT, children, python, started


@pytest.fixture(autouse=True, scope="module")
def no_report():
    """The report has its own tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("experiments.report.print_report", print)
        yield


def run(directory: Path, **options) -> int:
    """The fake environment behaves as no simulator does: nothing is checked."""
    asked = of_preset(Options, out=directory, **{**TINY, "workers": 2, **options})
    return sweep(asked, make_env=make_env, check=lambda _: None)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """An uninterrupted sweep, to compare with."""
    directory = tmp_path_factory.mktemp("reference")
    assert run(directory, workers=1) == 0
    return directory


def test_a_sweep_computes_every_cell_once(reference, capsys):
    results = load(reference)
    wanted = cells_of(of_preset(Options, out=reference, **TINY))
    assert set(results.cells) == {cell.name for cell in wanted} == set(results.expected)
    assert not results.failed
    assert not list((reference / "work").iterdir())
    before = {path: path.stat().st_mtime_ns for path in reference.glob("*/*.*")}
    assert run(reference) == 0
    assert {path: path.stat().st_mtime_ns for path in reference.glob("*/*.*")} == before
    assert "8 of them finished before" in capsys.readouterr().out


def test_further_arms_are_trained_and_agents_tested_elsewhere(reference, tmp_path, here):
    directory = tmp_path / "results"
    arms = ("control", "treatment", "dose25", "dose50", "told")
    options: dict[str, Any] = {"arms": arms, "test_on": ("replica",)}
    assert run(directory, **options) == 0
    results = load(directory)
    assert set(results.expected) == set(results.cells)
    assert set(load(reference).cells) < set(results.cells)
    tests = [record["key"] for record in results.cells.values() if record["key"]["kind"] == "test"]
    assert "test" not in set(results.gate_episodes["kind"])  # which have test episodes alone
    assert len(tests) == 5 + 4  # each agent elsewhere, and those of the dose response at every dose
    doses = next(key for key in tests if key["arm"] == "dose50" and key["test_on"]["backend"] == "sumo")
    assert doses["test_on"]["traffics"] == ["dose25", "dose50", "dose75"]
    assert {3} == set(results.episodes.groupby(["cell", "traffic"]).size())
    weights = next(directory.glob("weights/*-dose25-s0-*"))
    for path in directory.glob("cells/*-on-*"):
        path.unlink()
    weights.unlink()
    with pytest.raises(UserError, match="are not here"):
        run(directory, **options, cell="sumo-u-turn-3-dose25-s0-on-replica")


def test_a_placebo_trains_control_agents_alone_and_compares_them():
    cells = cells_of(of_preset(Options, placebo=True, **TINY))
    agents = [cell for cell in cells if cell.kind == "agent"]
    assert sorted((cell.arm, cell.seed) for cell in agents) == [("control", seed) for seed in range(4)]
    usual = {cell.name for cell in cells_of(of_preset(Options, **TINY)) if cell.arm == "control"}
    assert usual <= {cell.name for cell in agents}


def test_an_agent_that_diverges_fails_alone_is_named_and_is_tried_once(
    reference, tmp_path, monkeypatch, capsys, here
):
    usual = FakeEnv.step

    def failing(env, action):  # in the training of one arm
        if env.config["risk"] == 1.0 and env.met[-1][0] < TEST and env.time == 2:
            raise ValueError("the values are no finite numbers")
        return usual(env, action)

    with monkeypatch.context() as patch:
        patch.setattr(FakeEnv, "step", failing)
        assert run(tmp_path) == 1
        log = next(tmp_path.glob("work/*/log.txt"))
        with pytest.raises(ValueError, match="no finite numbers"):  # the command shows its traceback
            run(tmp_path, cell=log.parent.name)
    errors = capsys.readouterr().err
    for words in ("no finite numbers", str(log), f"--cell {log.parent.name}"):
        assert words in errors
    assert log.read_text().count("Traceback") == 1
    results = load(tmp_path)
    assert len(results.cells) == 7
    assert [name.rpartition("-")[0] for name in results.failed] == ["sumo-u-turn-3-treatment-s0"]
    assert run(tmp_path) == 0
    assert not load(tmp_path).failed
    assert fingerprint(tmp_path) == fingerprint(reference)


def test_an_agent_that_diverges_in_its_last_update_ends_no_other_cell(tmp_path, here):
    """It is found when the weights are read for the test."""
    assert run(tmp_path, updates=20, settings=("learning_rate=1e30", "clip_goals=false")) == 1
    results = load(tmp_path)
    assert {cell["key"]["kind"] for cell in results.cells.values()} == {"baseline"}
    assert len(results.failed) == 2 and all("not finite" in why for why in results.failed.values())
    assert run(tmp_path) == 0  # other settings, so that nobody asks for those cells any more
    assert not load(tmp_path).failed


def command(directory: Path, **options) -> tuple[object, ...]:
    return ROOT / "tests/experiments/study/fake_sweep.py", directory, json.dumps({**TINY, **options})


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_twenty_random_kills_lose_nothing_and_change_nothing(tmp_path):
    """kill -9 at random times of workers and of the sweep itself, which is then begun again.

    The times are relative to what a sweep takes on this machine now: on a slow one nothing would ever get done between
    two kills that are seconds apart.
    """

    size = {"seeds": 2, "updates": 400, "episodes": 10}
    reference, start = tmp_path / "reference", time.monotonic()
    python(*command(reference, **size))
    duration = time.monotonic() - start
    rng, tries = random.Random(2), 0
    kills: Counter[str] = Counter()
    while kills.total() < 20:
        tries += 1
        assert tries <= 10, kills
        directory = tmp_path / str(tries)
        again = True
        while again:
            process = started(*command(directory, **size))
            again = False
            while process.poll() is None and not again and kills.total() < 20:
                time.sleep(rng.uniform(0.0, duration / 2))
                victim = "sweep" if rng.random() < 0.5 else "worker"
                workers = children(process.pid, "spawn_main")
                if process.poll() is None and (victim == "sweep" or workers):
                    os.kill(process.pid if victim == "sweep" else rng.choice(workers), signal.SIGKILL)
                    kills[victim] += 1
                    again = victim == "sweep"
            output = process.communicate(timeout=600)
            assert again or process.returncode in (0, 1), output
            again = again or process.returncode == 1  # a cell met four kills: the same command tries it again
        assert fingerprint(directory) == fingerprint(reference)
        assert not list((directory / "work").iterdir())
        assert not (directory / "damaged").exists()
    print(f"{kills} in {tries} sweeps")
    assert kills["worker"] and kills["sweep"]


def test_a_shard_that_has_computed_everything_is_well_and_writes_no_report(
    tmp_path, monkeypatch, capsys, here
):
    """As under a preset whose plan has no report of a part of the study."""

    def incomplete(directory):
        raise UserError("no setting is complete yet")

    monkeypatch.setattr("experiments.report.print_report", incomplete)
    assert [run(tmp_path, shard=f"{part}/2") for part in (1, 2)] == [0, 0]
    with pytest.raises(UserError, match="no setting is complete"):
        run(tmp_path)


def test_neither_shards_nor_order_nor_company_change_anything(reference, tmp_path):
    """Every cell in this process, in another order."""
    tasks = {task.name: task for task in tasks_of(tmp_path)}
    parts = [shard([task.cell for task in tasks.values()], f"{i}/2") for i in (1, 2)]
    compute(tasks[cell.name] for part in parts for cell in reversed(part))
    assert fingerprint(tmp_path) == fingerprint(reference)


def test_a_sweep_goes_on_where_it_was_and_computes_damaged_cells_again(reference, tmp_path, capsys, here):
    """What is missing as after a kill, with the work of that process in its folder."""
    copy = shutil.copytree(reference, tmp_path / "copy")
    cell, gone, *_ = sorted((copy / "cells").iterdir())
    cell.write_bytes(b"PAR1")
    gone.unlink()
    (copy / "work" / gone.stem).mkdir(parents=True)
    for name in ("lock", "progress.json", f".{gone.name}.1.tmp"):
        (copy / "work" / gone.stem / name).touch()
    assert run(copy) == 0
    assert f"{cell} is damaged" in capsys.readouterr().out
    assert next((copy / "damaged").glob(f"*/{cell.name}")).read_bytes() == b"PAR1"
    assert fingerprint(copy) == fingerprint(reference)
    assert not list((copy / "work").iterdir())


# -- parts of the user's own ---------------------------------------------------------------------------------

NETWORK = """
from torch import nn
class Mine(nn.Module):
    def __init__(self, space, actions):
        super().__init__()
        self.layers = nn.Sequential(nn.Flatten(), nn.Linear(space.shape[0] * space.shape[1], actions))
    def forward(self, x):
        return self.layers(x)
"""


def replayed(directory: Path, arm: str) -> int:
    """One episode of an agent again."""
    cells = load(directory).cells.items()
    name = next(name for name, cell in cells if (cell["key"]["kind"], cell["key"]["arm"]) == ("agent", arm))
    return replay(ReplayOptions(f"{directory}/cells/{name}:risky:1", out=directory / "film.gif"), make_env)


def test_a_network_of_the_users_own_is_trained_and_stored(tmp_path, here):
    file = tmp_path / "mine.py"
    file.write_text(NETWORK)
    observed = {"tasks": ("roundabout",)}  # where the time is
    assert run(tmp_path / "results", network=f"{file}:Mine", **observed) == 0
    results = load(tmp_path / "results")
    agents = [record for record in results.cells.values() if record["key"]["kind"] == "agent"]
    assert len(agents) == 2
    for record in agents:
        assert record["key"]["profile"]["network"] == "mine.py:Mine"
        assert record["source"] == f"{file}:Mine"

    assert replayed(tmp_path / "results", "treatment") == 0

    def names(file: Path) -> set[str]:
        return {
            cell.name
            for cell in cells_of(of_preset(Options, **{**TINY, "network": f"{file}:Mine"}))
            if cell.arm
        }

    elsewhere = tmp_path / "other" / "mine.py"
    elsewhere.parent.mkdir()
    elsewhere.write_text(NETWORK)
    assert names(elsewhere) == names(file)  # where the file lies does not matter, what it says does
    elsewhere.write_text(NETWORK + "# changed")
    assert not names(elsewhere) & names(file)


LEARNER = """
from dataclasses import dataclass
import numpy as np
import torch
from agents.greedy import Greedy
from agents.learner import Trained

@dataclass(frozen=True)
class Settings:
    steps: int = 40
    scale: float = 1.0
    updates: int = 0

def network(env, scale):
    torch.manual_seed(0)
    shape = env.observation_space.shape
    return torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(shape[0] * shape[1], 5)).requires_grad_(False)

class Guess:
    Settings = Settings

    def train(self, make_env, settings, seed, *, progress=print):
        envs, log, steps = make_env(2), {"step": [], "return": [], "length": [], "crashed": []}, 0
        envs.reset()
        while steps < settings.steps:
            *_, ended, cut, info = envs.step(np.array([1, 4]))
            steps += 2
            for k in np.flatnonzero(ended | cut):
                for name, value in zip(log, (steps, 1.0, 10, bool(info["crashed"][k])), strict=True):
                    log[name].append(value)
        policy = Greedy(network(make_env(), settings.scale))
        return Trained(policy, {k: np.array(v) for k, v in log.items()}, {"steps": steps, "updates": 0})

    def load(self, path, settings, env):
        return Acts(Greedy.load(path, network(env, settings.scale)))

class Acts:
    def __init__(self, policy):
        self.act = policy.act
"""


def test_a_study_of_another_learner(tmp_path, here):
    """Arms, gates that apply, tests on another simulator, effects with intervals, the report and a replay."""
    file = tmp_path / "guess.py"
    file.write_text(LEARNER + "\nown = Guess()\n")
    options = {
        "learner": f"{file}:own",
        "updates": None,
        "network": None,
        "seeds": 2,
        "test_on": ("replica",),
    }
    directory = tmp_path / "results"
    assert run(directory, settings=("steps=60",), **options) == 0
    results = load(directory)
    agents = {name: cell for name, cell in results.cells.items() if cell["key"]["kind"] == "agent"}
    assert {cell["key"]["policy"] for cell in agents.values()} == {"guess.py:own"}
    assert all("-guess.py.own-" in name for name in agents)
    assert not set(agents) & {cell.name for cell in cells_of(of_preset(Options, **{**TINY, "seeds": 2}))}
    assert {cell["learner"].get("q_bound") for cell in agents.values()} == {None}
    analysis = analyse(results)
    assert len(analysis.gates) == 4
    assert set(analysis.gates["passed"]) <= {True, False} and set(analysis.gates["q_bounded"]) == {None}
    found = analysis.effects.query("outcome == 'crashed' and term == 'risky'")
    assert {("treatment", "control")} <= set(zip(found["arm"], found["against"], strict=True))
    assert set(analysis.by_task["tested_on"]) == {"sumo", "replica"} and not analysis.notes["left_out"]

    assert replayed(directory, "control") == 0


def test_policies_of_the_users_own_get_cells_of_their_own(tmp_path, here):
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    file, zipped = tmp_path / "mine.py", tmp_path / "model.zip"
    file.write_text(FILES["mine.py"])  # as slower
    stable_baselines3.DQN("MlpPolicy", make_env("sumo", "u-turn"), device="cpu").save(zipped)
    assert run(tmp_path / "results", policy=(f"{file}:Mine", str(zipped))) == 0
    results = load(tmp_path / "results")
    episodes = results.episodes.set_index("policy")
    assert {"mine.py:Mine", "model.zip"} <= set(episodes.index)
    mine, slower = (episodes.loc[policy, "return"].tolist() for policy in ("mine.py:Mine", "slower"))
    assert mine == slower
    chosen, left_out = comparable(results)
    assert not left_out and set(chosen.cells) == set(results.cells)
    assert set(analyse(results).policies["policy"]) >= {"mine.py:Mine", "model.zip"}
