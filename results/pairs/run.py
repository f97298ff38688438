"""Compute the cells of the fourth plan; see README.md beside this file.

    python results/pairs/run.py --code WORKTREE --work FOLDER

The same command goes on wherever it was stopped, if the saved single cells are there: they were removed when they were
packed, and README.md says how to get them back. What is said of signals, saving and commits in
results/second-rest/run.py holds here: this file takes its process that saves from there, and has cells, order, commit
and the weights of its own.

With --part 0 and --part 1 two processes share a setting, each with a working folder of its own: agents and pairs of even
and of odd training seeds. A pair needs agents of both: a part ends without the pairs of which an agent is not saved.

    python results/pairs/run.py --code WORKTREE --pack results/pairs

adds the complete settings to the tables of a folder.
"""

from __future__ import annotations

import argparse
import importlib.util
import io
import json
import lzma
import os
import re
import signal
import sys
import tarfile
import tempfile
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

HERE = Path(__file__).resolve().parent
COMMIT = "e2136f9a"  # of the plan's second amendment
TASKS = {  # in the order of the plan's amendment
    "intersection-10": "intersection",
    "roundabout-5": "roundabout",
    "u-turn-3": "u-turn",
    "highway-50": "highway",
    "two-way-5+2": "two-way",
}
MORE = "-more"  # what is exploratory in a setting, after the plan's questions in all settings
SETTINGS = {**TASKS, **{f"{name}{MORE}": task for name, task in TASKS.items()}}
# Of a setting: 30 agents, 35 pairs, 6 drivers of fixed rules. Then 50 tests of pairs in other traffic, 10 agents.
CELLS = 71, 60
# No question is about these 15 cells. They come later, too, where they were not there at the plan's fourth amendment.
LATER, LATER_IN = ("mixed", "two-mixed"), ("u-turn-3", "highway-50", "two-way-5+2")
# The fifth pair of one setting comes later, too, since the plan's fifth amendment: four more agents and six pairs.
FIFTH, FIFTH_IN = (204, 209), "two-way-5+2"
TABLES, WEIGHTS = ("episodes.parquet", "gates.parquet"), "weights.npz"

_found = importlib.util.spec_from_file_location("saving", HERE.parent / "second-rest" / "run.py")
assert _found and _found.loader
saving: Any = importlib.util.module_from_spec(_found)
_found.loader.exec_module(saving)


def number(setting: str) -> int:
    """How many cells a setting has."""
    task = setting.removesuffix(MORE)
    later = 15 * (task in LATER_IN) + 10 * (task == FIFTH_IN)
    return CELLS[1] + later if setting.endswith(MORE) else CELLS[0] - later


# -- In the process that computes ------------------------------------------------------------------------------------


def part_of(name: str) -> int:
    """Of which of two parts a cell is."""
    seed = re.search(r"-s(\d+)-", name)
    return int(seed[1]) % 2 if seed else 1  # drivers of fixed rules are with the fewer pairs


def cells_in(setting: str) -> tuple[str, list[Any]]:
    """The command that asks for a setting's cells, perhaps among others, and these cells; `code` is in the path."""
    from experiments.study.design.experiment import Experiment
    from experiments.study.design.presets import cells_of
    from experiments.study.design.traffic import TRAFFICS

    command = f"python experiments/sweep.py --preset pairs --settings by_hand=true --tasks {SETTINGS[setting]}"
    asked: dict[str, Any] = {"preset": "pairs", "tasks": (SETTINGS[setting],), "settings": ("by_hand=true",)}
    cells = cells_of(Experiment(**asked))
    late = LATER if setting.removesuffix(MORE) in LATER_IN else ()
    fifth = FIFTH if setting.removesuffix(MORE) == FIFTH_IN else ()
    later = [
        cell
        for cell in cells
        if cell.arm in late or cell.seed in fifth or not {*cell.tested["traffics"]} <= {*TRAFFICS}
    ]
    if setting.endswith(MORE):
        arms = cells_of(Experiment(**asked, arms=("mixed-belief", "mixed-seen"), seeds=5))
        cells = [cell for cell in (*arms, *later) if cell.kind == "agent"]
        cells += [cell for cell in later if cell.kind != "agent"]
    else:
        cells = [cell for cell in cells if cell not in later]
    assert len(cells) == number(setting), len(cells)
    return command, cells


def compute(code: Path, setting: str, out: Path, part: int | None) -> int:
    """The cells of a setting as `experiments/sweep.py` computes them, one at a time, but without a report."""
    sys.path[0] = str(code)
    from experiments.study.compute.cells import compute as compute_cells
    from experiments.study.design.fingerprint import check_dynamics
    from experiments.study.results.store import Store

    pack(code, dict.fromkeys((setting.removesuffix(MORE), setting)), out)  # pairs are made of the setting's agents
    _, cells = cells_in(setting)
    check_dynamics([("sumo", SETTINGS[setting])])
    Store(out).write_sweep(f"results/pairs/run.py, setting {setting}", cells)
    if part is not None:
        missing = {cell.name for cell in cells if cell.kind == "agent"} - {*Store(out).finished()}
        cells = [cell for cell in cells if part_of(cell.name) == part]
        cells = [cell for cell in cells if cell.kind != "test" or not missing & {*cell.parents}]
    failures = compute_cells(cells, out, workers=1)
    return 1 if failures or not {cell.name for cell in cells} <= {*Store(out).finished()} else 0


def pack(code: Path, settings: Iterable[str], out: Path) -> None:
    """Add the saved cells of some settings to the packed tables of a folder, if they are not in it."""
    sys.path[0] = str(code)
    import pandas as pd
    from experiments.study.results.packed import add
    from experiments.study.results.store import Store

    from experiments.support.files import sha256_bytes

    records: dict[str, Any] = {}
    tables: dict[str, Any] = {}
    weights: dict[str, Path] = {}
    out.mkdir(parents=True, exist_ok=True)
    there = set(Store(out).finished())
    with tempfile.TemporaryDirectory() as folder:
        for setting in settings:
            for name in sorted(saving.saved(setting) - there):
                with tarfile.open(HERE / setting / f"{name}{saving.CELL}") as archive:
                    files = {entry.name: archive.extractfile(entry).read() for entry in archive}  # type: ignore[union-attr]
                records[name] = json.loads(files.pop("cell.json"))
                del records[name]["checksum"]
                if WEIGHTS in files:
                    weights[name] = Path(folder) / f"{name}.npz"
                    weights[name].write_bytes(files.pop(WEIGHTS))
                for file, data in files.items():
                    if sha256_bytes(data) != records[name]["files"][file]:
                        sys.exit(f"{file} of {setting}/{name} is damaged: restore it with git, or delete it")
                tables[name] = {file: pd.read_parquet(io.BytesIO(data)) for file, data in files.items()}
        if records:
            add(out, records, tables, weights)
    print(f"{len(records)} saved cells added to {out}", flush=True)


# -- In the process that saves ---------------------------------------------------------------------------------------


def save(setting: str, out: Path, unfinished: bool) -> None:
    """Copy finished cells beside this file, agents with their weights in half precision, and commit them.

    unfinished: checkpoints of trainings are copied as well.
    """
    there = saving.finished(setting, out)
    for name in sorted(there - saving.saved(setting)):
        data, folder = io.BytesIO(), out / "cells" / name
        with tarfile.open(fileobj=data, mode="w:xz") as archive:
            for file in ("cell.json", *TABLES):
                if (folder / file).exists():
                    archive.add(folder / file, file, filter=saving.anonymous)
            if (folder / WEIGHTS).exists():
                halved = half(folder / WEIGHTS)
                entry = tarfile.TarInfo(WEIGHTS)
                entry.size = len(halved)
                archive.addfile(entry, io.BytesIO(halved))
        saving.write(HERE / setting / f"{name}{saving.CELL}", data.getvalue())
    for packed in (HERE / setting).glob(f"*{saving.CHECKPOINT}"):
        if packed.name.removesuffix(saving.CHECKPOINT) in saving.saved(setting):
            packed.unlink()
    for file in out.glob("work/*/checkpoint.npz") if unfinished else ():
        if (name := file.parent.name) not in there:  # the training replaces its checkpoint whole
            packed = HERE / setting / f"{name}{saving.CHECKPOINT}"
            saving.write(packed, lzma.compress(file.read_bytes(), preset=9))
    saving.commit(f"Pairs, {setting}: {len(saving.saved(setting))} of {number(setting)} cells")


def half(file: Path) -> bytes:
    """The weights of a file in half precision, in which pairs use them wherever they come from."""
    import numpy as np

    buffer = io.BytesIO()
    with np.load(file) as arrays:
        np.savez(buffer, **{name: arrays[name].astype(np.float16) for name in arrays.files})
    return buffer.getvalue()


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--code", type=Path, required=True, help=f"a clean checkout of {COMMIT} after make setup"
    )
    parser.add_argument("--work", type=Path, help="a folder outside of git for the sweeps")
    parser.add_argument(
        "--settings", nargs="+", choices=SETTINGS, default=list(SETTINGS), help="default: all"
    )
    parser.add_argument(
        "--pack", type=Path, metavar="DIR", help="add the complete settings to this folder instead"
    )
    parser.add_argument("--part", type=int, choices=(0, 1), help="one of two halves of each setting")
    parser.add_argument("--compute", choices=SETTINGS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    saving.HERE, saving.COMMIT, saving.COSTS, saving.save = HERE, COMMIT, HERE / "costs.csv", save
    code = options.code.resolve()
    if not (code / ".venv/bin/python").samefile(sys.executable):
        parser.error(f"it needs {code}/.venv/bin/python")
    if options.pack:
        pack(code, complete := saving.complete(options.settings, number), options.pack)
        from experiments.study.results.store import Store

        for command, cells in map(cells_in, complete):
            Store(options.pack).write_sweep(command, cells)
        return
    if not options.work:
        parser.error("--work is needed")
    if options.compute:
        sys.exit(compute(code, options.compute, options.work, options.part))
    further = []
    if options.part is not None:
        further = ["--part", str(options.part)]
        saving.mine = lambda name: part_of(name) == options.part
    wanted = SimpleNamespace(stop=False, save=False)
    for signum, name in {signal.SIGUSR1: "save", signal.SIGINT: "stop", signal.SIGTERM: "stop"}.items():
        signal.signal(signum, lambda *_, name=name: setattr(wanted, name, True))
    os.nice(15)
    for setting in options.settings:
        out = options.work.resolve() / setting
        for folder in (out / "cells", HERE / setting):
            folder.mkdir(parents=True, exist_ok=True)
        if len(saving.saved(setting)) == number(setting):
            print(f"{setting}: complete", flush=True)
            continue
        saving.check(code)
        saving.restore(setting, out)
        print(
            f"{setting}: {len(saving.finished(setting, out))} of {number(setting)} cells are there",
            flush=True,
        )
        if saving.follow(setting, code, out, wanted, further):
            return


if __name__ == "__main__":
    main()
