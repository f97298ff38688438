"""The pages that quote tables: ``make pages`` fills their numbers in from the stored files.

Each file of docs/templates/ is a page in Markdown: README.md.j2 is the README, any other the page of its name in docs/.
FIGURES are drawn from the same files.
Where a page has a number that a command computes, its template calls a function of this module: {{ validation().all }}
becomes the number of checks in experiments/validation/verdict.json. The words are the templates' own. Filled pages are
committed, because GitHub shows them; ``--check`` compares alone. Numbers of frozen studies are plain text.
"""

import functools
import json
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(ROOT)

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from docs.settings import learning_curves, readme_agents, trainings
from experiments import evaluate
from experiments.reporting import by_task, takeover
from experiments.reporting.arrows import crashes_against_speed
from experiments.reporting.card import ALL, card_figure
from experiments.reporting.figures import against_traffic, alone
from experiments.reporting.page import lightest
from experiments.reporting.rare import doses_figure, rare_figure
from experiments.reporting.tables import chosen, effect, interval, plain, points
from experiments.study.design.arms import ARMS
from experiments.study.design.sheet import GRID
from experiments.validation.figure import validation_figure
from sumo_env.tasks import TASKS
from sumo_env.traffic.risk import RATES

TEMPLATES = ROOT / "docs" / "templates"
STUDY = ROOT / "results" / "study-6"
# What became of an effect, by its side before times its side now (-1: fewer crashes, 1: more, 0: not decided).
BECAME = {1: "stands", -1: "turns", 0: "not decided"}
NOTE = "<!-- Filled by `make pages` from {template}: edit that file. -->\n"


def verdict(*tasks: str) -> dict[str, dict[str, Any]]:
    """What the validation came to (`validation.checks.summary`), by task: these, or those of the study."""
    found = json.loads((ROOT / "experiments" / "validation" / "verdict.json").read_text())
    return {task: found[task] for task in tasks or GRID}


def validation(*tasks: str) -> dict[str, Any]:
    """How many checks of SUMO against highway-env there are (all), by verdict, within, outside, and orders."""
    stored = verdict(*tasks).values()
    sums = pd.DataFrame([own["counts"] for own in stored]).sum().to_dict()
    sums |= {"orders": sum(own["orders"] for own in stored)}
    sums |= {"outside": sum(len(own["outside"]) for own in stored)}
    return {"all": sum(sum(own["counts"].values()) for own in stored), **sums}


def entries() -> str:
    """A table of the frozen test: crash rates [%] by driver and task, in regular/risky traffic.

    What was driven on another set or another simulator than the first entry is left out.
    """
    lines, cards = [], evaluate.entries()
    first = next(iter(cards.values()))["set"]
    for name, card in cards.items():
        line = {"driver": f"`{name}`"}
        rows = chosen(pd.DataFrame(card["rows"]), level=ALL).set_index(["task", "traffic"])
        for task in GRID:
            if card["set"].get(task) == first[task]:
                both = (rows.loc[(task, traffic)]["crashed"][0] for traffic in ("regular", "risky"))
                line[task] = "/".join(points(rate, "crashed", signed=False) for rate in both)
        lines.append(line)
    return _markdown(lines)


@functools.cache
def study() -> Any:
    """The analysis of the published study, as the report's tables take it."""
    stored = json.loads((STUDY / "analysis.json").read_text())
    parts = {name: part for name, part in stored.items() if isinstance(part, dict) and "columns" in part}
    frames = {name: pd.DataFrame(part["rows"], columns=part["columns"]) for name, part in parts.items()}
    return SimpleNamespace(**stored | frames)


def checks() -> pd.DataFrame:
    """The checks of SUMO against highway-env one by one, of all scenarios or of the first ones."""
    return pd.read_csv(ROOT / "results" / "validation.csv")


@functools.cache
def moments() -> pd.DataFrame:
    """The record of `experiments/takeover.py` in which the study's pairs were driven."""
    rows = takeover.recorded(STUDY)
    assert rows is not None
    return rows


@functools.cache
def skill_or_caution() -> pd.DataFrame:
    """What that record answers, task by task."""
    return takeover.skill_or_caution(moments())


def signs() -> str:
    """Whether treated agents have less or more of each outcome, as the report shows it."""
    return _markdown(by_task.signs(study(), "sumo", skill_or_caution()).to_dict("records"))


@functools.cache
def taken_over(frame: str) -> pd.DataFrame:
    """A frame of what `experiments/takeover.py` wrote, of all tasks: answers, rates, ..."""
    files = sorted((STUDY / "takeover").glob("*/takeover.json"))
    return pd.concat(
        pd.DataFrame(json.loads(file.read_text())[frame]).assign(task=file.parent.name) for file in files
    )


def answer(task: str, traffic: str, question: str, within: int = 3) -> dict[str, Any]:
    """The answer to a question, such as "caution", by a bound of critical moments [s]."""
    asked = {"task": task, "traffic": traffic, "question": question, "within": within}
    return dict(*chosen(taken_over("answers"), **asked).to_dict("records"))


def from_moments(task: str, traffic: str) -> dict[str, float]:
    """The share that crashes within 5 s from the moments of both leaders alike [%], by who takes over."""
    own = chosen(taken_over("rates"), task=task, traffic=traffic, within=3)
    return dict(100 * own.groupby("driver")["crashed"].mean())


def beside_plan_5() -> str:
    """The effects on crashes by plan 5 and here, in the settings of both, and what became of the first.

    An effect is one whose 95 % interval excludes 0; without one by either plan there is no line.
    """
    earlier = pd.read_csv(ROOT / "results" / "plan_v5.csv").rename(columns={"difference": "estimate"})
    earlier = chosen(earlier, tested_on="sumo", outcome="crashed").assign(status="ok")
    arms, lines = dict(zip(("against", "arm"), ARMS, strict=True)), []
    effects = chosen(study().effects, backend="sumo", outcome="crashed", **arms)
    places = product([(task, name) for task in GRID for name in GRID[task]], ("risky", "regular"))
    for (task, name), traffic in places:
        before = chosen(earlier, scope=f"{task}-{name}", traffic=traffic).to_dict("records")
        now = chosen(effects, task=task, level_name=name, term=traffic).to_dict("records")
        for both in zip(before, now, strict=False):  # one of each, or none
            was, became = (int(one["low"] > 0) - int(one["high"] < 0) for one in both)
            if was or became:
                found = dict(zip(("plan 5", "now"), (effect(one, "crashed") for one in both), strict=True))
                place = {"setting": f"{task} {name}", "traffic": traffic}
                lines.append({**place, **found, "": BECAME[was * became] if was else "new"})
    return _markdown(lines)


def rare_curves() -> str:
    """Crashes of two rules against the rate of risk events, as `experiments/rare.py` stored them."""
    curves = pd.read_csv(ROOT / "results" / "rare.csv").groupby("policy")
    return rare_figure({str(policy): curve for policy, curve in curves}, "u-turn, 3 other vehicles")


def entries_figure() -> str:
    """Crashes against speed of the frozen test's entries."""
    cards = evaluate.entries()
    return card_figure(cards, next(iter(cards.values()))["set"]) or ""


def row(frame: str, **wanted: Any) -> dict[str, Any]:
    """The row of a frame of that analysis that has these values."""
    (found,) = chosen(getattr(study(), frame), backend="sumo", **wanted).to_dict("records")
    return dict(found)


def failing(*arms: str) -> dict[str, Any]:
    """Where the agents of these arms of that study fail the gates, see `reporting.by_task.failing`."""
    return by_task.failing(chosen(study().gates, arm=list(arms or ARMS)))


def events_per_hour(task: str) -> float:
    """How many risk events a vehicle of the task has at dose 1 in an hour."""
    return 3600 * sum(getattr(TASKS[task].risk_rates, name) for name in RATES)


def arrow(row: dict[str, Any]) -> str:
    """From control to treated agents, "38.4→34.2"."""
    return "→".join(points(row[side], row["outcome"], signed=False) for side in ("mean_against", "mean_arm"))


def _markdown(lines: list[dict[str, str]]) -> str:
    table = pd.DataFrame(lines).fillna("")
    rows = [list(table.columns), ["---"] * len(table.columns), *table.values]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


FUNCTIONS: list[Callable[..., Any]] = [
    *(answer, beside_plan_5, by_task.difference, checks, entries, events_per_hour, failing, from_moments),
    *(readme_agents, row, signs, study, trainings, validation, verdict),
]
FILTERS: list[Callable[..., str]] = [arrow, effect, interval, plain, points]
# Their files are in docs/img; study: of each task's lightest traffic.
FIGURES: dict[str, Callable[[], str]] = {
    "study": lambda: crashes_against_speed(lightest(study().drivers), "study"),
    "traffic": lambda: against_traffic(chosen(study().policies, backend="sumo"), "study"),
    "takeover": lambda: takeover.danger_figure(moments()),
    "entries": entries_figure,
    "settings": learning_curves,
    "validation": lambda: validation_figure(checks()),
    "road-units": lambda: doses_figure(pd.read_parquet(ROOT / "results" / "road-units.parquet")),
    "rare": rare_curves,
}


def figure_file(name: str) -> Path:
    """The file of one of FIGURES."""
    return ROOT / "docs" / "img" / f"{name}.svg"


def page_of(template: Path) -> Path:
    """The page that a template becomes."""
    name = template.stem
    return ROOT / name if name == "README.md" else ROOT / "docs" / name


def filled(template: Path) -> str:
    """The text of the page that a template becomes."""
    blocks: Any = {"trim_blocks": True, "lstrip_blocks": True, "keep_trailing_newline": True}
    environment = Environment(loader=FileSystemLoader(TEMPLATES), undefined=StrictUndefined, **blocks)
    environment.globals.update({function.__name__: function for function in FUNCTIONS})
    environment.filters.update({function.__name__: function for function in FILTERS})
    text = environment.get_template(template.name).render()
    return NOTE.format(template=template.relative_to(ROOT)) + text


def templates() -> list[Path]:
    """All templates."""
    return sorted(TEMPLATES.glob("*.md.j2"))


def main() -> int:
    """Write pages and figures, or with --check say which are not what is made of the tables; 1 if there is one."""
    stale = 0
    made = {page_of(template): filled(template) for template in templates()}
    made |= {figure_file(name): alone(draw()) for name, draw in FIGURES.items()}
    for page, text in made.items():
        if page.exists() and page.read_text(encoding="utf-8") == text:
            continue
        if "--check" in sys.argv:
            print(f"{page.relative_to(ROOT)} is not what the tables make: make pages", file=sys.stderr)
            stale = 1
        else:
            page.write_text(text, encoding="utf-8")
            print(page.relative_to(ROOT))
    return stale


if __name__ == "__main__":
    sys.exit(main())
