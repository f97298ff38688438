"""Apply the faults of faults.toml one by one to a copy of the tree, and note which test notices each of them.

    python -m tests.faults --out tests/faults/outcome.json     all of them; run again to go on where it ended
    python -m tests.faults --only holm-without-order           one of them
    python -m tests.faults --find                              only look whether the text of each is still there

A fault counts as caught by a test that fails with it and passes without it.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
Fault = dict[str, Any]
FAULTS: list[Fault] = tomllib.loads(Path(__file__).with_name("faults.toml").read_text())["fault"]


def moved(fault: Fault) -> list[str]:
    """What has to be updated before a fault can be applied: its file, which has its text once, and its tests."""
    file = ROOT / fault["file"]
    held = file.exists() and file.read_text().count(fault["before"]) == 1
    return [fault["file"]] * (not held) + [name for name in fault["tests"] if not (ROOT / name).exists()]


def copy_tree(target: Path) -> None:
    """Copy the tree; the published results are only linked."""

    def left_out(folder: str, names: list[str]) -> set[str]:
        return {
            name
            for name in names
            if name.startswith(".") or name == "__pycache__" or Path(folder, name) == ROOT / "results"
        }

    shutil.copytree(ROOT, target, symlinks=True, ignore=left_out)
    (target / "results").symlink_to(ROOT / "results")


def failing_test(root: Path, tests: list[str]) -> str | None:
    """The first test that fails in a tree, None if all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not long", *tests]
    environment = {**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True)
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    if done.returncode and not found:
        raise RuntimeError(
            f"pytest {' '.join(tests)} did not run:\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
        )
    return found[1] if found else None


def outcome(fault: Fault, root: Path) -> dict[str, Any]:
    """Apply a fault to a tree, run its tests, and take it back."""
    if names := moved(fault):
        return {"outcome": f"moved: update {', '.join(names)}"}
    path = root / fault["file"]
    clean, begun = path.read_text(), time.monotonic()
    path.write_text(clean.replace(fault["before"], fault["after"]))
    test = failing_test(root, fault["tests"])
    path.write_text(clean)
    found = {"file": fault["file"], "seconds": round(time.monotonic() - begun)}
    if test is None:
        return {"outcome": "not caught", **found}
    if failing_test(root, [test]):
        return {"outcome": "unclear: this test fails without the fault, too", **found, "test": test}
    return {"outcome": "caught", **found, "test": test}


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", metavar="ID", help="these faults, whatever is known of them")
    parser.add_argument("--out", type=Path, help="note outcomes in this file and skip those that it holds")
    parser.add_argument("--find", action="store_true", help="only look whether the text of each is there")
    arguments = parser.parse_args()
    chosen = [fault for fault in FAULTS if not arguments.only or fault["id"] in arguments.only]
    if arguments.find:
        for fault in chosen:
            print(f"{fault['id']}: {', '.join(moved(fault)) or 'is found'}")
        sys.exit(any(map(moved, chosen)))
    known = json.loads(arguments.out.read_text()) if arguments.out and arguments.out.exists() else {}
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        root = Path(folder, "tree")
        copy_tree(root)
        for fault in chosen:
            if fault["id"] not in known or arguments.only:
                known[fault["id"]] = outcome(fault, root)
            if arguments.out:
                arguments.out.write_text(json.dumps(known, indent=1) + "\n")
            print(
                f"{fault['id']}: {known[fault['id']]['outcome']} {known[fault['id']].get('test', '')}",
                flush=True,
            )
    print(f"{sum(found['outcome'] == 'caught' for found in known.values())} caught of {len(known)}")


if __name__ == "__main__":
    main()
