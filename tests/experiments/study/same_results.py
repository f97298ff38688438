"""Compare two checkouts: one tiny cell per backend and arm, computed by both on this machine in one run.

    python tests/experiments/study/same_results.py OLD_CHECKOUT [BACKEND ...]

Prints one line per cell and exits with status 1 if any weights or tested episodes differ. Nothing is stored: bits
depend on the processor, so only two computations of one machine can be compared.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parents[3]
BACKENDS = ("sumo", "replica", "highway-env")
SWEEP = ("--preset", "smoke", "--tasks", "u-turn", "--updates", "150", "--episodes", "3", "--workers", "1")


def compute(checkout: Path, backend: str, out: Path) -> None:
    """Run a sweep with the code of a checkout."""
    subprocess.run(
        [sys.executable, "experiments/sweep.py", "--backend", backend, "--out", str(out), *SWEEP],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"},
        check=True,
        stdout=subprocess.DEVNULL,
    )


def main(old: str, *backends: str) -> int:
    """Compute and compare; returns the exit status."""
    sys.path.insert(0, str(HERE))
    from experiments.study.grid import slug
    from experiments.study.store import load

    different = 0
    for backend in backends or BACKENDS:
        found = []
        with tempfile.TemporaryDirectory() as folder:
            for name, checkout in (("old", Path(old)), ("new", HERE)):
                compute(checkout, backend, Path(folder) / name)
                results = load(Path(folder) / name)
                weights = {n: c.get("learner", {}).get("weights_sha256") for n, c in results.cells.items()}
                episodes = dict(iter(results.episodes.groupby("cell")))
                found.append({slug(c["key"]): (weights[n], episodes[n]) for n, c in results.cells.items()})
        before, after = found
        if before.keys() != after.keys():
            raise SystemExit(f"{backend}: other cells: {sorted(before.keys() ^ after.keys())}")
        for cell, (weights, episodes) in before.items():
            columns = [column for column in episodes if column not in ("cell", "preset")]
            new = after[cell][1][columns].reset_index(drop=True)
            same = weights == after[cell][0] and episodes[columns].reset_index(drop=True).equals(new)
            print(f"{'same' if same else 'DIFFERENT':<10}{cell:<40}{(weights or '')[:12]}", flush=True)
            different += not same
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
