"""The results in README.md: ``python docs/results_table.py`` writes the table, ``--check`` compares it.

Crash rates and speed of control and treated agents for each task of results/standard, levels weighted alike, with the
difference and its 95 % interval as the analysis has them. Bold: the interval excludes 0.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
README, ANALYSIS = ROOT / "README.md", ROOT / "results" / "standard" / "analysis.json"
START, END = "<!-- written by docs/results_table.py -->\n", "<!-- end of the table -->"
TASKS = {
    "highway": "highway", "two-way": "two-way road", "roundabout": "roundabout",
    "intersection": "intersection", "u-turn": "u-turn",
}  # fmt: skip
HEAD = """\
| task | crash rate in **risky** traffic [%] | crash rate in **regular** traffic [%] | speed in risky traffic [m/s] |
|---|---|---|---|
"""


def difference(row: dict[str, Any], scale: float, digits: int) -> str:
    """An effect and its interval, bold where the interval excludes 0."""
    numbers = [round(row[k] * scale, digits) for k in ("estimate", "low", "high")]
    point, low, high = (f"{x:+.{digits}f}".replace("-", "−") if x else "0" for x in numbers)
    bold = "**" if row["low"] > 0 or row["high"] < 0 else ""
    return f"{bold}{point}{bold} [{low}, {high}]"


def records(analysis: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """A table of the analysis, one row a dictionary."""
    return [dict(zip(analysis[name]["columns"], row, strict=True)) for row in analysis[name]["rows"]]


def means(analysis: dict[str, Any], traffic: str, outcome: str, arm: str) -> dict[str, float]:
    """The mean of an arm's agents for each task, over its levels, and over the tasks."""
    rows = [
        r
        for r in records(analysis, "policies")
        if (r["policy"], r["arm"], r["traffic"]) == ("dqn", arm, traffic)
    ]
    found = {task: fmean(r[outcome] for r in rows if r["task"] == task) for task in TASKS}
    return {**found, "all tasks": fmean(found.values())}


def lines(analysis: dict[str, Any]) -> Iterator[str]:
    """The rows of the table."""
    columns = [("crashed", "risky", 100, 0), ("crashed", "regular", 100, 0), ("mean_speed", "risky", 1, 1)]
    effects = {
        (r["scope"], r["outcome"], r["term"]): r
        for r in records(analysis, "means")
        if (r["arm"], r["against"], r["scenarios"]) == ("treatment", "control", "own")
    }
    for scope, name in {**TASKS, "all tasks": "**mean of the tasks**"}.items():
        cells = [name]
        for outcome, traffic, scale, digits in columns:
            control, treated = (
                means(analysis, traffic, outcome, arm)[scope] * scale for arm in ("control", "treatment")
            )
            change = difference(
                effects[scope, outcome, traffic], scale, 1 if scope == "all tasks" else digits
            )
            cells.append(f"{control:.{digits}f} → {treated:.{digits}f}: {change}")
        yield f"| {' | '.join(cells)} |\n"


def main() -> int:
    """Write the table, or with --check say whether README.md has it."""
    before, _, rest = README.read_text(encoding="utf-8").partition(START)
    _, _, after = rest.partition(END)
    analysis = json.loads(ANALYSIS.read_text(encoding="utf-8"))
    text = before + START + HEAD + "".join(lines(analysis)) + END + after
    if "--check" in sys.argv:
        return int(text != README.read_text(encoding="utf-8"))
    README.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
