"""The names of the published cells, and of those that the second study still lacks: by the command that asks for them.

python tests/golden/regenerate.py names     # adds what has been published since; a name never goes
"""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import tyro

from experiments.study.design.presets import cells_of
from experiments.study.results.store import Store
from experiments.sweep import Options, split_arguments

FILE = Path(__file__).with_name("names.json")
RESULTS = Path(__file__).resolve().parents[2] / "results"
FOLDERS = (
    "second",
    "standard",
    "replica",
    "paper",
    "paper-v0",
    "linear",
    "first-clock",
    "crash-reward",
    "pairs",
)
ARMS = "--arms control treatment mixed --frontier --unseen --test-on replica"
# Settings of the second study that are not published: numbers of their levels by task.
MISSING = {
    "u-turn": (2, 3),
    "highway": (2,),
    "two-way": (2, 3),
}
MISSING_COMMANDS = [
    f"python experiments/sweep.py --preset second {ARMS} --tasks {task} --levels {level}"
    for task, levels in MISSING.items()
    for level in levels
]


def asked(command: str) -> set[str]:
    """The names of the cells that a sweep's command asks for."""
    arguments = split_arguments(shlex.split(command)[2:])
    options = tyro.cli(Options, args=arguments, config=(tyro.conf.FlagCreatePairsOff,))
    return {cell.name for cell in cells_of(options)}


def golden() -> dict[str, list[str]]:
    """The stored names, by folder or command."""
    found: dict[str, list[str]] = json.loads(FILE.read_text())
    return found


def write() -> None:
    """Add the names of what is there now."""
    before = golden() if FILE.exists() else {}
    now = {folder: set(Store(RESULTS / folder).finished()) for folder in FOLDERS}
    now |= {command: asked(command) for command in MISSING_COMMANDS}
    for part, names in before.items():
        assert now[part] >= set(names), f"{part} has lost names"
    FILE.write_text(json.dumps({part: sorted(names) for part, names in now.items()}, indent=0) + "\n")
