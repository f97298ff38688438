"""Compute the five settings of the second study that are left; see README.md beside this file.

    python results/second-rest/run.py --code WORKTREE --work FOLDER

The same command goes on wherever it was stopped. The settings, their order and the commit are those of the amendment in
docs/developers/plan_v3.md. One process trains; this one saves what is finished into the folder of this file and commits
the saved files. Send SIGUSR1 to save at once, with the checkpoint of the cell that is computed; SIGINT or SIGTERM to
stop, after such a save. It needs Linux, and Python alone: the cells are computed in the worktree's environment.

    python results/second-rest/run.py --code WORKTREE --pack results/second

adds the complete settings to the tables of a folder.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import lzma
import os
import re
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

COMMIT = "842ea8e"
SETTINGS = {  # task and level, in the order of the plan's amendment
    "u-turn-6": ("u-turn", 2),
    "u-turn-9": ("u-turn", 3),
    "highway-100": ("highway", 2),
    "two-way-10+4": ("two-way", 2),
    "two-way-15+6": ("two-way", 3),
}
CELLS = 55  # of a setting: 15 agents with two further tests each, 10 drivers of fixed rules
HERE = Path(__file__).resolve().parent
EVERY = 900.0  # [s] between two saves
LOOK = 2.0  # [s] between two looks at the working folder
CELL, CHECKPOINT = ".tar.xz", ".checkpoint.npz.xz"  # endings of the saved files, after the name of a cell
TABLES, WEIGHTS = ("episodes.parquet", "gates.parquet"), "weights.npz"
FIRST_SEED = "100"  # whose agents are published with their weights
COSTS = HERE / "costs.csv"  # cell, CPU seconds, and whether this part of the work finished the cell


def git(folder: Path, *words: str) -> str:
    """What a git command prints."""
    done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"git {words[0]}: {(done.stderr or done.stdout).strip()}")
    return done.stdout.strip()


def check(code: Path) -> None:
    """End the program unless this is a clean checkout of the plan's commit with an environment of its own."""
    if not git(code, "rev-parse", "HEAD").startswith(COMMIT) or git(code, "status", "--porcelain"):
        sys.exit(f"{code} is not a clean checkout of {COMMIT}: git worktree add --detach {code} {COMMIT}")
    if not (code / ".venv/bin/python").exists():
        sys.exit(f"{code} has no environment: make -C {code} setup")


# -- In the process that computes ------------------------------------------------------------------------------------


def compute(code: Path, setting: str, out: Path) -> int:
    """The cells of a setting as `experiments/sweep.py` computes them, one at a time, but without a report.

    An agent's further tests come right behind its training: then its weights need not be saved.
    """
    sys.path[0] = str(code)
    from experiments.study.fingerprint import check_dynamics
    from experiments.study.presets import cells_of
    from experiments.study.store import Store

    from experiments.sweep import Options
    from experiments.sweep import compute as compute_cells

    pack(code, (setting,), out)
    task, level = SETTINGS[setting]
    cells = cells_of(
        Options(
            preset="second",
            arms=("control", "treatment", "mixed"),
            frontier=True,
            unseen=True,
            test_on=("replica",),
            tasks=(task,),
            levels=(level,),
        )
    )
    assert len(cells) == CELLS and all(cell.name.startswith(f"sumo-{setting}-") for cell in cells)
    check_dynamics(dict.fromkeys((name, task) for cell in cells for name in (cell.backend, cell.runs_on)))
    Store(out).write_sweep(f"results/second-rest/run.py, setting {setting}", cells)
    agents = [cell for cell in cells if cell.kind == "agent"]
    groups = [
        [agent, *(cell for cell in cells if cell.kind == "test" and cell.parent == agent)] for agent in agents
    ]
    groups.append([cell for cell in cells if cell.kind == "baseline"])
    assert sum(map(len, groups)) == CELLS
    there = set(Store(out).finished())
    failures = {}
    for group in groups:
        if not there.issuperset(cell.name for cell in group):
            failures |= compute_cells(group, out, workers=1)
    return 1 if failures or len(Store(out).finished()) < CELLS else 0


def pack(code: Path, settings: Iterable[str], out: Path) -> None:
    """Add the saved cells of some settings to the packed tables of a folder, if they are not in it."""
    sys.path[0] = str(code)
    import pandas as pd
    from experiments.study.packed import add
    from experiments.study.store import Store

    from experiments.support.files import sha256_bytes

    records: dict[str, Any] = {}
    tables: dict[str, Any] = {}
    weights: dict[str, Path] = {}
    out.mkdir(parents=True, exist_ok=True)
    there = set(Store(out).finished())
    with tempfile.TemporaryDirectory() as folder:
        for setting in settings:
            for name in sorted(saved(setting) - there):
                with tarfile.open(HERE / setting / f"{name}{CELL}") as archive:
                    files = {entry.name: archive.extractfile(entry).read() for entry in archive}  # type: ignore[union-attr]
                records[name] = json.loads(files.pop("cell.json"))
                del records[name]["checksum"]
                for file, data in files.items():
                    if sha256_bytes(data) != records[name]["files"][file]:
                        sys.exit(
                            f"{file} of {setting}/{name}{CELL} is damaged: restore it with git, or delete it"
                        )
                tables[name] = {
                    file: pd.read_parquet(io.BytesIO(files[file])) for file in TABLES if file in files
                }
                if WEIGHTS in files:
                    weights[name] = Path(folder) / f"{name}.npz"
                    weights[name].write_bytes(files[WEIGHTS])
        if records:
            add(out, records, tables, weights)
    print(f"{len(records)} saved cells added to {out}", flush=True)


# -- In the process that saves ---------------------------------------------------------------------------------------


def saved(setting: str) -> set[str]:
    """Names of the saved cells of a setting."""
    return {path.name.removesuffix(CELL) for path in (HERE / setting).glob(f"*{CELL}")}


def complete(settings: Iterable[str], cells: Callable[[str], int]) -> list[str]:
    """The settings of which all cells are saved; says which are left out."""
    there = {setting: len(saved(setting)) == cells(setting) for setting in settings}
    if lacking := [setting for setting, whole in there.items() if not whole]:
        print("left out, because not complete:", *lacking, flush=True)
    return [setting for setting, whole in there.items() if whole]


def finished(setting: str, out: Path) -> set[str]:
    """Names of the cells of a setting that are saved, or finished in a working folder, where they are moved whole."""
    there = saved(setting) | {path.name for path in (out / "cells").glob("sumo-*")}
    return {name for name in there if mine(name)}


def mine(name: str) -> bool:
    """Whether this process computes the cell of this name."""
    return True


def restore(setting: str, out: Path) -> None:
    """Put saved checkpoints where the sweep looks for them; what is there already stays."""
    for packed in (HERE / setting).glob(f"*{CHECKPOINT}"):
        name = packed.name.removesuffix(CHECKPOINT)
        there = out / "work" / name / "checkpoint.npz"
        if mine(name) and name not in finished(setting, out) and not there.exists():
            write(there, lzma.decompress(packed.read_bytes()))
            print(f"{setting}: goes on from the saved checkpoint of {name}", flush=True)


def write(path: Path, data: bytes) -> None:
    """Write a file so that it is there whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(data)
    part.replace(path)


def save(setting: str, out: Path, unfinished: bool) -> None:
    """Copy finished cells beside this file, and commit them.

    An agent waits for its further tests. unfinished: it does not, and checkpoints are copied as well.
    """
    there = finished(setting, out)
    for name in sorted(there - saved(setting)):
        files = ["cell.json", *TABLES]
        if agent := re.fullmatch(r"(.*-(?:control|treatment|mixed)-s(\d+))-[0-9a-f]{12}", name):
            tests = [
                test for test in there if test.startswith((f"{agent[1]}-unseen-", f"{agent[1]}-on-replica-"))
            ]
            if len(tests) < 2 and not unfinished:
                continue
            if len(tests) < 2 or agent[2] == FIRST_SEED:
                files.append(WEIGHTS)
        data = io.BytesIO()
        with tarfile.open(fileobj=data, mode="w:xz") as archive:
            for file in files:
                if (path := out / "cells" / name / file).exists():
                    archive.add(path, file, filter=anonymous)
        write(HERE / setting / f"{name}{CELL}", data.getvalue())
    for packed in (HERE / setting).glob(f"*{CHECKPOINT}"):
        if packed.name.removesuffix(CHECKPOINT) in saved(setting):
            packed.unlink()
    for file in out.glob("work/*/checkpoint.npz") if unfinished else ():
        if (name := file.parent.name) not in there:  # the training replaces its checkpoint whole
            write(HERE / setting / f"{name}{CHECKPOINT}", lzma.compress(file.read_bytes(), preset=9))
    commit(f"Second study, {setting}: {len(saved(setting))} of {CELLS} cells")


def anonymous(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    """An entry of an archive without the names of a user."""
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    return entry


def commit(message: str) -> None:
    """Commit the folder of this file, and nothing else; what cannot be committed now goes with the next save."""
    for _ in range(20):
        try:
            git(HERE, "add", "--all", ".")
            if git(HERE, "status", "--porcelain", "."):
                git(HERE, "commit", "--quiet", "--message", message, "--", ".")
                print(f"committed: {message}", flush=True)
            return
        except RuntimeError as error:  # another git command holds the index, or a merge is under way
            problem = error
            time.sleep(3)
    print(f"not committed ({problem}): {message}", flush=True)


def cpu_seconds(session: int) -> float:
    """CPU time of the processes of a session, and of those that they have waited for [s]."""
    ticks = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            values = stat.read_text().rpartition(")")[2].split()
        except OSError:  # it has just ended
            continue
        if int(values[3]) == session:
            ticks += sum(map(int, values[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


def note_cost(cell: str, seconds: float, state: str) -> None:
    """Add a row to the table of costs."""
    new = not COSTS.exists()
    with COSTS.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(["cell", "cpu_seconds", "state"])
        writer.writerow([cell, f"{seconds:.1f}", state])


def follow(setting: str, code: Path, out: Path, wanted: Any, further: Iterable[str] = ()) -> bool:
    """Compute a setting in a process of its own, and save; returns whether it was stopped.

    wanted: what signals ask. further: words of the process's command.
    """
    words = [
        ".venv/bin/python",
        str(HERE / "run.py"),
        "--code",
        str(code),
        "--work",
        str(out),
        "--compute",
        setting,
        *further,
    ]
    with (out / "log.txt").open("a") as log:
        process = subprocess.Popen(
            words,
            cwd=code,
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"},
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    there, spent, total, last = finished(setting, out), 0.0, 0.0, time.monotonic()
    ended = False
    while not ended:
        time.sleep(LOOK)
        if wanted.stop:
            os.killpg(process.pid, signal.SIGKILL)  # the store and the checkpoints are made for it
            process.wait()
        ended = process.poll() is not None
        total = max(total, cpu_seconds(process.pid))
        new = sorted(finished(setting, out) - there)
        for name in new:
            note_cost(name, (total - spent) / len(new), "finished")
        if new:
            there, spent = there | set(new), total
        if wanted.save or time.monotonic() - last > EVERY:
            save(setting, out, unfinished=wanted.save)
            wanted.save, last = False, time.monotonic()
    if wanted.stop:
        for file in out.glob("work/*/checkpoint.npz"):
            if file.parent.name not in there:
                note_cost(file.parent.name, total - spent, "stopped")
    save(setting, out, unfinished=wanted.stop)
    if process.returncode and not wanted.stop:
        sys.exit(f"{setting}: the process ended with {process.returncode}, see {out / 'log.txt'}")
    return bool(wanted.stop)


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
    parser.add_argument("--compute", choices=SETTINGS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.pack:
        if not (options.code / ".venv/bin/python").samefile(sys.executable):
            parser.error(f"--pack needs {options.code}/.venv/bin/python")
        pack(options.code.resolve(), complete(options.settings, lambda _: CELLS), options.pack)
        return
    if not options.work:
        parser.error("--work is needed")
    if options.compute:
        sys.exit(compute(options.code, options.compute, options.work))
    code, work = options.code.resolve(), options.work.resolve()
    wanted = SimpleNamespace(stop=False, save=False)
    for number, name in {signal.SIGUSR1: "save", signal.SIGINT: "stop", signal.SIGTERM: "stop"}.items():
        signal.signal(number, lambda *_, name=name: setattr(wanted, name, True))
    os.nice(15)
    for setting in options.settings:
        out = work / setting
        for folder in (out / "cells", HERE / setting):
            folder.mkdir(parents=True, exist_ok=True)
        if len(saved(setting)) == CELLS:
            print(f"{setting}: complete", flush=True)
            continue
        check(code)
        restore(setting, out)
        print(f"{setting}: {len(finished(setting, out))} of {CELLS} cells are there", flush=True)
        if follow(setting, code, out, wanted):
            return


if __name__ == "__main__":
    main()
