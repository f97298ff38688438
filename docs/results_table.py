"""The results in README.md and docs/study.md: ``python docs/results_table.py`` writes the tables, ``--check`` compares.

Crash rates and speed of the agents of each training of the second study, as the analysis has them: in README.md by
task, in docs/study.md by setting.
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
    "README.md": ("task", ("control", "treatment")),
    "docs/study.md": ("setting", ("control", "treatment", "mixed")),
}  # what has a line in their tables, and the arms
START, END = "<!-- written by docs/results_table.py -->\n\n", "<!-- end of the table -->"
TASKS = ("highway", "two-way", "roundabout", "intersection", "u-turn")
ALL = "all tasks"
NAMES = {"two-way": "two-way road", ALL: "**mean of the tasks**"}  # where it is not the line's own
ARMS = {
    "control": "in regular",
    "treatment": "in risky",
    "mixed": "in mixed",
}  # and the traffic of their training
HEAD = """\
| {each} | crash rate in **risky** traffic [%] | crash rate in **regular** traffic [%] | speed in risky traffic [m/s] |
|---|---|---|---|
"""
COLUMNS = (("crashed", "risky", 100, 0), ("crashed", "regular", 100, 0), ("mean_speed", "risky", 1, 1))
SPACE = "\N{NO-BREAK SPACE}"  # within a cell: a narrow screen scrolls instead of breaking every number


def difference(row: dict[str, Any], scale: float, digits: int) -> str:
    """An effect and its interval, bold where the interval excludes 0."""
    bold = "**" if row["low"] > 0 or row["high"] < 0 else ""
    numbers = [round(row[k] * scale, digits) for k in ("estimate", "low", "high")]
    point, low, high = (f"{x:+.{digits}f}".replace("-", "−") if x or bold else "0" for x in numbers)
    return f"{bold}{point}{bold} [{low}, {high}]"


def records(analysis: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """A table of the analysis, one row a dictionary."""
    return [dict(zip(analysis[name]["columns"], row, strict=True)) for row in analysis[name]["rows"]]


def effects_of(analysis: dict[str, Any], each: str) -> dict[tuple[str, ...], dict[str, Any]]:
    """Effects in the agents' own scenarios by line (a task or setting, and all), arm, outcome and traffic."""
    found = [(row["scope"], row) for row in records(analysis, "means") if row["scope"] in (*TASKS, ALL)]
    if each == "setting":
        rows = sorted(records(analysis, "effects"), key=lambda row: (TASKS.index(row["task"]), row["level"]))
        means = [(scope, row) for scope, row in found if scope == ALL]
        found = [*((f"{row['task']} {row['level_name']}", row) for row in rows), *means]
    return {
        (line, row["arm"], row["outcome"], row["term"]): row
        for line, row in found
        if (row["against"], row["scenarios"]) == ("control", "own")
    }


def lines(analysis: dict[str, Any], each: str, shown: Sequence[str]) -> Iterator[str]:
    """What the numbers are, and the table with a line for each task or setting."""
    ways = " → ".join(ARMS[arm] for arm in shown)
    what = (
        "difference and its 95 % interval"
        if len(shown) == 2
        else "differences from the first and their 95 % intervals"
    )
    yield f"Trained {ways} traffic, the {what} (bold: excludes 0):\n\n{HEAD.format(each=each)}"
    effects = effects_of(analysis, each)
    for line in dict.fromkeys(line for line, *_ in effects):
        cells = [NAMES.get(line, line)]
        for outcome, traffic, scale, digits in COLUMNS:
            rows = [effects[line, arm, outcome, traffic] for arm in shown if arm != "control"]
            means = [rows[0]["mean_against"], *(row["mean_arm"] for row in rows)]
            rates = [f"{mean * scale:.{digits}f}" for mean in means]
            finer = 1 if line == ALL else digits
            changes = [difference(row, scale, finer).replace(" ", SPACE) for row in rows]
            cells.append(f"{'→'.join(rates)}: {', '.join(changes)}")
        yield f"| {' | '.join(cells)} |\n"


def written(page: Path, table: str) -> str:
    """The page with its table."""
    before, _, rest = page.read_text(encoding="utf-8").partition(START)
    _, _, after = rest.partition(END)
    return before + START + table + END + after


def main() -> int:
    """Write the tables, or with --check say whether the pages have them."""
    analysis = json.loads(STUDY.read_text(encoding="utf-8"))
    for name, (each, shown) in PAGES.items():
        page = ROOT / name
        text = written(page, "".join(lines(analysis, each, shown)))
        if "--check" not in sys.argv:
            page.write_text(text, encoding="utf-8")
        elif text != page.read_text(encoding="utf-8"):
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
