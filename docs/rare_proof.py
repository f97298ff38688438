"""Proof of rare.py by plain counting: ``python docs/rare_proof.py DIR`` drives what DIR lacks, and prints it.

In every task, crash probabilities at two rates of events from one run, beside those of plain counting in other
scenarios. In one task, in how many of 200 runs the interval covers the mean of all runs, and that mean beside counting.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import numpy as np
import pandas as pd

from experiments.rare import Options, rare
from experiments.support.files import read_json

DRIVERS = {
    "highway": "idle",
    "two-way": "careful",
    "roundabout": "idle",
    "intersection": "idle",
    "u-turn": "idle",
}
COUNTED = {0.001: 20_000, 0.01: 10_000}  # episodes, by rate
EPISODES = 4_000  # of one run for both rates
REPEATED, REPEATED_RATES, RUNS, RUN_EPISODES = ("slower", "u-turn"), (0.03, 0.1), 200, 600
PARTS = ("crashes", "by_events")


def curve(out: Path, driver: str, task: str, rates: tuple[float, ...], **options: object) -> pd.DataFrame:
    """By rate, the curve that is in `out`; driven if it is not there."""
    if not (out / "curve.json").exists():
        asked = Options(driver, task, rates=",".join(map(str, rates)), out=out, **options)  # type: ignore[arg-type]
        rare(asked, ["(by docs/rare_proof.py)"])
    return pd.DataFrame(read_json(out / "curve.json")["curve"]).set_index("rate")


def counted(out: Path, driver: str, task: str, episodes: dict[float, int]) -> pd.DataFrame:
    """The same by counting at each rate by itself, in other scenarios."""
    runs = [
        curve(out / f"{task}-{driver}-{rate:g}", driver, task, (rate,), episodes=n, plain=True, seed=1)
        for rate, n in episodes.items()
    ]
    return pd.concat(runs)


def difference(one: pd.Series, other: pd.Series, part: str) -> str:
    """Two estimates, and their difference with its 95 % interval (Zou and Donner 2008)."""
    (a, low, high), (b, least, most) = (
        [row[f"{part}_per_episode{end}"] for end in ("", "_low", "_high")] for row in (one, other)
    )
    below, above = np.hypot(a - low, most - b), np.hypot(high - a, b - least)
    sizes = f"{a:.2g} [{low:.1e}, {high:.1e}] {b:.2g} [{least:.1e}, {most:.1e}]"
    return f"{sizes} {a - b:+.1e} [{a - b - below:+.1e}, {a - b + above:+.1e}]"


def main(out: Path) -> None:
    """Drive, and print."""
    lines = []
    for task, driver in DRIVERS.items():
        once = curve(out / task, driver, task, tuple(COUNTED), episodes=EPISODES)
        plain = counted(out, driver, task, COUNTED)
        for rate in COUNTED:
            lines += [
                f"{task} {driver} {rate:g} {part}: {difference(once.loc[rate], plain.loc[rate], part)}"
                for part in PARTS
            ]
    driver, task = REPEATED
    runs = [
        curve(out / "runs" / str(seed), driver, task, REPEATED_RATES, episodes=RUN_EPISODES, seed=seed)
        for seed in range(2, 2 + RUNS)
    ]
    plain = counted(out, driver, task, dict.fromkeys(REPEATED_RATES, 20_000))
    for rate in REPEATED_RATES:
        rows = pd.DataFrame([run.loc[rate] for run in runs])
        name = "crashes_per_episode"
        mean, error = rows[name].mean(), rows[name].std() / np.sqrt(RUNS)
        covered = ((rows[f"{name}_low"] <= mean) & (mean <= rows[f"{name}_high"])).sum()
        counts = [plain.loc[rate, f"{name}{end}"] for end in ("", "_low", "_high")]
        lines.append(
            f"{task} {driver} {rate:g}: mean {mean:.3g} +- {error:.1g}, counted {counts}, {covered} of {RUNS} cover"
        )
    print("\n".join(lines))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
