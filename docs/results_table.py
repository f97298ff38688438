"""The results in README.md and docs/study.md: ``python docs/results_table.py`` writes the tables, ``--check`` compares.

Crash rates and speed of the agents of each training and task of the second study; levels weighted alike. The
differences from control and their 95 % intervals are those of the analysis. Bold: the interval excludes 0.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
STUDY = ROOT / "results" / "second" / "analysis.json"
PAGES = {
    "README.md": ("control", "treatment"),
    "docs/study.md": ("control", "treatment", "mixed"),
}  # and their arms
START, END = "<!-- written by docs/results_table.py -->\n\n", "<!-- end of the table -->"
TASKS = ("highway", "two-way", "roundabout", "intersection", "u-turn")
NAMES = {"two-way": "two-way road", "all tasks": "**mean of the tasks**"}  # where it is not the scope's own
ARMS = {
    "control": "in regular",
    "treatment": "in risky",
    "mixed": "in mixed",
}  # and the traffic of their training
HEAD = """\
| task | crash rate in **risky** traffic [%] | crash rate in **regular** traffic [%] | speed in risky traffic [m/s] |
|---|---|---|---|
"""
COLUMNS = (("crashed", "risky", 100, 0), ("crashed", "regular", 100, 0), ("mean_speed", "risky", 1, 1))
SPACE = "\N{NO-BREAK SPACE}"  # within a cell: a narrow screen scrolls instead of breaking every number


def difference(row: dict[str, Any], scale: float, digits: int) -> str:
    """An effect and its interval, bold where the interval excludes 0."""
    numbers = [round(row[k] * scale, digits) for k in ("estimate", "low", "high")]
    point, low, high = (f"{x:+.{digits}f}".replace("-", "−") if x else "0" for x in numbers)
    bold = "**" if row["low"] > 0 or row["high"] < 0 else ""
    return f"{bold}{point}{bold} [{low}, {high}]"


def records(analysis: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """A table of the analysis, one row a dictionary."""
    return [dict(zip(analysis[name]["columns"], row, strict=True)) for row in analysis[name]["rows"]]


def tasks(analysis: dict[str, Any]) -> list[str]:
    """The tasks that have agents, in the order of the tables."""
    found = {row["task"] for row in records(analysis, "policies") if row["arm"]}
    return [task for task in TASKS if task in found]


def means(analysis: dict[str, Any], traffic: str, outcome: str, arm: str) -> dict[str, float]:
    """The mean of an arm's agents for each task, over its levels, and over the tasks."""
    wanted = ("dqn", arm, traffic)
    rows = [r for r in records(analysis, "policies") if (r["policy"], r["arm"], r["traffic"]) == wanted]
    found = {task: fmean(r[outcome] for r in rows if r["task"] == task) for task in tasks(analysis)}
    return {**found, "all tasks": fmean(found.values())}


def lines(analysis: dict[str, Any], shown: Sequence[str]) -> Iterator[str]:
    """What the numbers are, and the table with a row for each task."""
    ways = " → ".join(ARMS[arm] for arm in shown)
    what = (
        "difference and its 95 % interval"
        if len(shown) == 2
        else "differences from the first and their 95 % intervals"
    )
    yield f"Trained {ways} traffic, the {what} (bold: excludes 0):\n\n{HEAD}"
    effects = {
        (r["arm"], r["scope"], r["outcome"], r["term"]): r
        for r in records(analysis, "means")
        if (r["against"], r["scenarios"]) == ("control", "own")
    }
    for scope in (*tasks(analysis), "all tasks"):
        cells = [NAMES.get(scope, scope)]
        for outcome, traffic, scale, digits in COLUMNS:
            rates = [f"{means(analysis, traffic, outcome, arm)[scope] * scale:.{digits}f}" for arm in shown]
            finer = 1 if scope == "all tasks" else digits
            rows = [effects[arm, scope, outcome, traffic] for arm in shown if arm != "control"]
            changes = [difference(row, scale, finer).replace(" ", SPACE) for row in rows]
            cells.append(f"{SPACE.join(' → '.join(rates).split())}: {', '.join(changes)}")
        yield f"| {' | '.join(cells)} |\n"


def written(page: Path, analysis: dict[str, Any], shown: Sequence[str]) -> str:
    """The page with the table of these arms."""
    before, _, rest = page.read_text(encoding="utf-8").partition(START)
    _, _, after = rest.partition(END)
    return before + START + "".join(lines(analysis, shown)) + END + after


def main() -> int:
    """Write the tables, or with --check say whether the pages have them."""
    analysis = json.loads(STUDY.read_text(encoding="utf-8"))
    for name, shown in PAGES.items():
        page = ROOT / name
        text = written(page, analysis, shown)
        if "--check" not in sys.argv:
            page.write_text(text, encoding="utf-8")
        elif text != page.read_text(encoding="utf-8"):
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
