"""Names of published cells: each is the hash of its key, none was renamed, and the dynamics in the keys are today's."""

from __future__ import annotations

import hashlib
import json
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from experiments.backends import BACKENDS
from experiments.study.design.experiment import Experiment
from experiments.study.design.fingerprint import check_dynamics, dynamics, fingerprint
from experiments.study.design.grid import BACKEND_KEYS, cell_name, slug
from experiments.study.design.presets import cells_of
from experiments.study.results.store import Store
from experiments.support.errors import UserError
from experiments.support.files import canonical_json
from sumo_env.config import resolve
from sumo_env.tasks import TASKS

RESULTS = Path(__file__).resolve().parents[3] / "results"
# Number of published cells of each folder, and the SHA-256 of their sorted names, one per line.
PUBLISHED = {
    "standard": (653, "e21908dc03fbd90d299010c9136eb304c4417966afd6a7cb5231ffd50152de34"),
    "replica": (180, "efd00ce3ffc276df4f3ad3b2dfc712e0b9d532a527a876017fe1e8f82f7c1dde"),
    "paper": (80, "cb62cc3b4b74c29f98ae26d61967d9da89e13cb155e5c6cdf5842aea8a049e14"),
    "paper-v0": (80, "d18afae7e65c6dac084f0b65661d6f6812e20514a2ae1bf1720a12aacd2c3e0e"),
    "linear": (32, "8cf581dd64a7138c7204efd89423e226c71c1da521ceb92cb246dc7c117d4206"),
    "second": (645, "73efb991aa0ce8ce983f82ea4e2079996d5e18773d225a9936e7c754242564de"),
    "first-clock": (32, "f469dde699ee9872b90cfb433732aadb6645a679b917999e0cb3f4e6cc229a5f"),
    "crash-reward": (16, "6e97dd98f96d471ceb1116a982b3486c84e98844b22b1b9cd6c2ee5e94d15bda"),
}


@cache
def cells(folder: str) -> dict[str, dict[str, Any]]:
    return Store(RESULTS / folder).records()


@pytest.mark.parametrize("folder", PUBLISHED)
def test_a_published_cell_is_named_by_its_key(folder: str) -> None:
    found = cells(folder)
    assert [name for name, cell in found.items() if cell_name(cell["key"], cell["versions"]) != name] == []
    digest = hashlib.sha256("".join(f"{name}\n" for name in sorted(found)).encode()).hexdigest()
    assert (len(found), digest) == PUBLISHED[folder]


@pytest.mark.parametrize("folder", PUBLISHED)
def test_every_packed_table_of_a_published_folder_is_here(folder: str) -> None:
    listed = json.loads((RESULTS / folder / "packed.json").read_text())["files"]
    assert [file for file in listed if not (RESULTS / folder / file).is_file()] == []
    Store(RESULTS / folder).tables(next(iter(cells(folder))))


@pytest.mark.parametrize(
    ("folder", "preset", "backend", "least"),
    [
        ("standard", "standard", "sumo", 300),
        ("replica", "standard", "replica", 80),
        ("paper", "paper", "sumo", 80),
        ("second", "second", "sumo", 75),
        ("first-clock", "first-clock", "sumo", 32),
    ],
)
def test_a_study_asks_for_its_published_cells_today(folder, preset, backend, least) -> None:
    """A default, or a key that goes, would give the same computation another name, and make it anew."""
    asked = {cell.slug: cell for cell in cells_of(Experiment(preset=preset, backend=backend))}
    found = cells(folder)
    compared = [name for name, cell in found.items() if slug(cell["key"]) in asked]
    assert len(compared) >= least
    for name in compared:
        assert cell_name(asked[slug(found[name]["key"])].key(), found[name]["versions"]) == name


@pytest.mark.parametrize("folder", PUBLISHED)
def test_the_configuration_of_published_cells_is_accepted(folder: str) -> None:
    stored = {canonical_json([c["key"]["task"], c["key"]["env_config"]]) for c in cells(folder).values()}
    for task, config in map(json.loads, stored):
        resolve(task, TASKS[task].defaults, {k: v for k, v in config.items() if k not in BACKEND_KEYS})


def test_the_dynamics_of_published_cells_are_those_of_today() -> None:
    stored = set()
    for cell in (cell for folder in PUBLISHED for cell in cells(folder).values()):
        for key in (cell["key"], {**cell["key"], **cell["key"].get("test_on", {})}):
            stored.add((key["backend"], key["task"], key["dynamics"]))
    assert stored == {(backend, task, dynamics(backend, task)) for backend in BACKENDS for task in TASKS}


@pytest.mark.parametrize("backend", ["sumo", "replica"])
@pytest.mark.parametrize("task", TASKS)
def test_the_simulators_do_what_they_did(backend: str, task: str) -> None:
    assert fingerprint(backend, task) == dynamics(backend, task)


def test_a_simulator_that_behaves_otherwise_is_named_before_a_sweep_begins(monkeypatch) -> None:
    check_dynamics([("sumo", "u-turn"), ("highway-env", "u-turn"), ("sumo", "a task of the user's own")])
    rates = TASKS["u-turn"].risk_rates
    monkeypatch.setattr(type(TASKS["u-turn"]), "risk_rates", type(rates)(brake=1.0))
    with pytest.raises(UserError, match="task u-turn on the backend sumo does not behave"):
        check_dynamics([("sumo", "u-turn")])


@pytest.mark.slow
def test_highway_env_does_what_it_did() -> None:
    check_dynamics(("highway-env", task) for task in TASKS)


def test_the_published_folders_have_few_files() -> None:
    # results/second-rest and results/pairs are not published: they hold single cells until these are packed.
    command = ["git", "-C", str(RESULTS), "ls-files", ".", ":!second-rest", ":!pairs"]
    listed = subprocess.run(command, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a checkout")
    assert 0 < len(listed.stdout.splitlines()) <= 120
