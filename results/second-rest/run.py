"""Compute the nine settings of the second study that are left; see README.md beside this file.

    python results/second-rest/run.py --code WORKTREE --work FOLDER

The same command goes on wherever it was stopped. The settings, their order and the commit are those of the amendment in
docs/developers/plan_v3.md. One process trains; this one saves what is finished into the folder of this file and commits
the saved files. Send SIGUSR1 to save at once, with the checkpoint of the cell that is computed; SIGINT or SIGTERM to
stop, after such a save. It needs Linux, and Python alone: the cells are computed in the worktree's environment.
"""

from __future__ import annotations

import argparse
import csv
import io
import lzma
import os
import signal
import subprocess
import sys
import tarfile
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

COMMIT = "842ea8e"
SETTINGS = {  # task and level, in the order of the plan's amendment
    "intersection-15": ("intersection", 2),
    "roundabout-10": ("roundabout", 2),
    "intersection-20": ("intersection", 3),
    "intersection-25": ("intersection", 4),
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
    """The cells of a setting as `experiments/sweep.py` computes them, one at a time, but without a report."""
    sys.path[0] = str(code)
    from experiments.study.fingerprint import check_dynamics
    from experiments.study.presets import cells_of
    from experiments.study.store import Store
    from experiments.sweep import Options
    from experiments.sweep import compute as compute_cells

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
    return 1 if compute_cells(cells, out, workers=1) else 0


# -- In the process that saves ---------------------------------------------------------------------------------------


def finished(out: Path) -> set[str]:
    """Names of the finished cells in a working folder; the store moves a cell there whole."""
    return {path.name for path in (out / "cells").glob("sumo-*")}


def saved(setting: str) -> set[str]:
    """Names of the saved cells of a setting."""
    return {path.name.removesuffix(CELL) for path in (HERE / setting).glob(f"*{CELL}")}


def restore(setting: str, out: Path) -> None:
    """Put saved cells and checkpoints where the sweep looks for them; what is there already stays."""
    for name in sorted(saved(setting) - finished(out)):
        with tarfile.open(HERE / setting / f"{name}{CELL}") as archive:
            archive.extractall(out / "restored", filter="data")
        (out / "restored" / name).rename(out / "cells" / name)
    for packed in (HERE / setting).glob(f"*{CHECKPOINT}"):
        name = packed.name.removesuffix(CHECKPOINT)
        there = out / "work" / name / "checkpoint.npz"
        if name not in finished(out) and not there.exists():
            write(there, lzma.decompress(packed.read_bytes()))
            print(f"{setting}: goes on from the saved checkpoint of {name}", flush=True)


def write(path: Path, data: bytes) -> None:
    """Write a file so that it is there whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(data)
    part.replace(path)


def save(setting: str, out: Path, checkpoints: bool) -> None:
    """Copy what is finished beside this file, on request with the checkpoints of unfinished cells, and commit it."""
    for name in sorted(finished(out) - saved(setting)):
        data = io.BytesIO()
        with tarfile.open(fileobj=data, mode="w:xz") as archive:
            archive.add(out / "cells" / name, name, filter=anonymous)
        write(HERE / setting / f"{name}{CELL}", data.getvalue())
    for packed in (HERE / setting).glob(f"*{CHECKPOINT}"):
        if packed.name.removesuffix(CHECKPOINT) in saved(setting):
            packed.unlink()
    for file in out.glob("work/*/checkpoint.npz") if checkpoints else ():
        if (name := file.parent.name) not in saved(setting):  # the training replaces its checkpoint whole
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


def follow(setting: str, code: Path, out: Path, wanted: Any) -> bool:
    """Compute a setting in a process of its own, and save; returns whether it was stopped. wanted: what signals ask."""
    log = (out / "log.txt").open("a")
    words = [".venv/bin/python", str(HERE / "run.py"), "--code", str(code), "--work", str(out), "--compute", setting]
    process = subprocess.Popen(
        words,
        cwd=code,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"},
        stdout=log,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    there, spent, total, last = finished(out), 0.0, 0.0, time.monotonic()
    while not wanted.stop:
        ended = process.poll() is not None
        total = max(total, cpu_seconds(process.pid))
        new = sorted(finished(out) - there)
        for name in new:
            note_cost(name, (total - spent) / len(new), "finished")
        if new:
            there, spent = there | set(new), total
        if wanted.save or time.monotonic() - last > EVERY:
            save(setting, out, checkpoints=wanted.save)
            wanted.save, last = False, time.monotonic()
        if ended:
            break
        time.sleep(LOOK)
    if wanted.stop:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        for folder in sorted((out / "work").glob("*")):
            if folder.name not in finished(out):
                note_cost(folder.name, total - spent, "stopped")
    save(setting, out, checkpoints=wanted.stop)
    if process.returncode and not wanted.stop:
        sys.exit(f"{setting}: the process ended with {process.returncode}, see {out / 'log.txt'}")
    return bool(wanted.stop)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--code", type=Path, required=True, help=f"a clean checkout of {COMMIT} after make setup")
    parser.add_argument("--work", type=Path, required=True, help="a folder outside of git for the sweeps")
    parser.add_argument("--settings", nargs="+", choices=SETTINGS, default=list(SETTINGS), help="default: all")
    parser.add_argument("--compute", choices=SETTINGS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.compute:
        sys.exit(compute(options.code, options.compute, options.work))
    code, work = options.code.resolve(), options.work.resolve()
    wanted = SimpleNamespace(stop=False, save=False)
    for number, name in {signal.SIGUSR1: "save", signal.SIGINT: "stop", signal.SIGTERM: "stop"}.items():
        signal.signal(number, lambda *_, name=name: setattr(wanted, name, True))
    os.nice(15)
    for setting in options.settings:
        out = work / setting
        (out / "cells").mkdir(parents=True, exist_ok=True)
        (HERE / setting).mkdir(exist_ok=True)
        restore(setting, out)
        if len(finished(out)) == CELLS and len(saved(setting)) == CELLS:
            print(f"{setting}: complete", flush=True)
            continue
        check(code)
        print(f"{setting}: {len(finished(out))} of {CELLS} cells are there", flush=True)
        if follow(setting, code, out, wanted):
            return


if __name__ == "__main__":
    main()
