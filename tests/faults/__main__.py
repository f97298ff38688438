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
LIST = Path(__file__).with_name("faults.toml")
PACKAGES = ("networks", "sumo_env", "agents", "experiments")
NOT_FOUND = 4  # exit status of pytest
LIMIT = 1800.0  # [s] for the tests of one fault; a test that hangs has noticed it, too

Fault = dict[str, Any]


def faults() -> list[Fault]:
    """The list, in its order."""
    return tomllib.loads(LIST.read_text())["fault"]


def find(fault: Fault, root: Path) -> Path | None:
    """The file that holds the text of a fault exactly once: the named one, or the only such file of the packages."""
    named = root / fault["file"]
    if named.exists() and named.read_text().count(fault["before"]) == 1:
        return named
    files = {path.resolve() for package in PACKAGES for path in (root / package).rglob("*.py")}
    holding = [path for path in files if fault["before"] in path.read_text()]
    one = len(holding) == 1 and holding[0].read_text().count(fault["before"]) == 1
    return root / holding[0].relative_to(root.resolve()) if one else None


def gone(fault: Fault, root: Path) -> str | None:
    """What has to be updated before a fault can be applied, None if it can."""
    if find(fault, root) is None:
        return "moved: update the fault"
    missing = [name for name in fault["tests"] if not (root / name).exists()]
    return f"moved: update the tests ({', '.join(missing)})" if missing else None


def copy_tree(target: Path) -> None:
    """Copy what git knows or would add; the published results are only linked."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    for name in names:
        source, copy = ROOT / name, target / name
        if name.startswith("results/") or not (source.is_symlink() or source.exists()):
            continue
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, copy, follow_symlinks=False)
    (target / "results").symlink_to(ROOT / "results")


def failing_test(root: Path, tests: list[str]) -> tuple[str | None, str]:
    """The first test that fails in a tree (None if all pass), and the last line that pytest prints."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not long", *tests]
    environment = {**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, cwd=root, env=environment, capture_output=True, text=True, timeout=LIMIT
        )
    except subprocess.TimeoutExpired:
        return tests[0], f"no end after {LIMIT:.0f} s"
    last = done.stdout.strip().rpartition("\n")[2]
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    if found:
        return found[1], last
    if done.returncode == NOT_FOUND and "::" in tests[0]:  # a test of this name is no longer there
        return None, last
    if done.returncode:
        raise RuntimeError(
            f"pytest {' '.join(tests)} did not run:\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
        )
    return None, last


def outcome(fault: Fault, root: Path, hint: str | None = None) -> dict[str, Any]:
    """Apply a fault to a tree, run its tests, and take it back.

    hint: the test that has caught it before, which is tried first.
    """
    if words := gone(fault, root):
        return {"outcome": words}
    path = find(fault, root)
    assert path is not None
    clean = path.read_text()
    begun = time.monotonic()
    path.write_text(clean.replace(fault["before"], fault["after"]))
    try:
        test, last = (None, "") if hint is None else failing_test(root, [hint])
        if test is None:
            test, last = failing_test(root, fault["tests"])
    finally:
        path.write_text(clean)
    found: dict[str, Any] = {"file": str(path.relative_to(root)), "seconds": round(time.monotonic() - begun)}
    if test is None:
        return {"outcome": "not caught", **found, "said": last}
    without, _ = failing_test(root, [test])
    if without is not None:
        return {"outcome": "unclear: this test fails without the fault, too", **found, "test": test}
    return {"outcome": "caught", **found, "test": test}


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", metavar="ID", help="these faults, whatever is known of them")
    parser.add_argument("--out", type=Path, help="note outcomes in this file and skip those that it holds")
    parser.add_argument("--first", type=Path, help="an earlier outcome, whose tests are tried first")
    parser.add_argument("--find", action="store_true", help="only look whether the text of each is there")
    arguments = parser.parse_args()
    chosen = [fault for fault in faults() if not arguments.only or fault["id"] in arguments.only]
    if arguments.find:
        moved = [f"{fault['id']}: {words}" for fault in chosen if (words := gone(fault, ROOT))]
        print("\n".join(moved) or f"all {len(chosen)} faults and their tests are found")
        sys.exit(bool(moved))
    before = json.loads(arguments.first.read_text()) if arguments.first else {}
    known: dict[str, Any] = {}
    if arguments.out and arguments.out.exists():
        known = json.loads(arguments.out.read_text())
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        root = Path(folder)
        copy_tree(root)
        for number, fault in enumerate(chosen, start=1):
            if fault["id"] not in known or arguments.only:
                hint = before.get(fault["id"], {}).get("test")
                there = hint and (root / hint.partition("::")[0]).exists()
                known[fault["id"]] = outcome(fault, root, hint if there else None)
            if arguments.out:
                arguments.out.write_text(json.dumps(known, indent=1) + "\n")
            result = known[fault["id"]]
            print(
                f"{number}/{len(chosen)} {fault['id']}: {result['outcome']} {result.get('test', '')}",
                flush=True,
            )
    counts = {
        word: sum(r["outcome"].startswith(word) for r in known.values()) for word in ("caught", "not caught")
    }
    print(f"{counts['caught']} caught, {counts['not caught']} not caught, of {len(known)}")


if __name__ == "__main__":
    main()
