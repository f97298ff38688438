"""The results in README.md and docs/study.md: ``python docs/results_table.py`` writes the tables, ``--check`` compares.

Crash rates and speed of the agents of each training and task of the second study, as the analysis has them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
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
    for scope in (
        scope for scope in (*TASKS, "all tasks") if (shown[-1], scope, "crashed", "risky") in effects
    ):
        cells = [NAMES.get(scope, scope)]
        for outcome, traffic, scale, digits in COLUMNS:
            rows = [effects[arm, scope, outcome, traffic] for arm in shown if arm != "control"]
            means = [rows[0]["mean_against"], *(row["mean_arm"] for row in rows)]
            rates = [f"{mean * scale:.{digits}f}" for mean in means]
            finer = 1 if scope == "all tasks" else digits
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
