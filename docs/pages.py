"""The pages that quote tables: ``make pages`` fills their numbers in from the stored files.

Each file of docs/templates/ is a page in Markdown: README.md.j2 is the README, any other the page of its name in docs/.
FIGURES are drawn from the same files.
Where a page has a number that a command computes, its template calls a function of this module: {{ validation().all }}
becomes the number of checks in experiments/validation/verdict.json. The words are the templates' own. Filled pages are
committed, because GitHub shows them; ``--check`` compares alone. Numbers of frozen studies are plain text.
"""

from __future__ import annotations

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

from docs.settings import learned, readme_agents, trainings
from experiments import evaluate
from experiments.analysis import takeover
from experiments.analysis.by_task import SURROGATES
from experiments.analysis.by_task import by_task as effects_by_task
from experiments.analysis.drivers import drivers
from experiments.analysis.plan import DEFAULT
from experiments.reporting import by_task
from experiments.reporting.card import ALL, card_figure
from experiments.reporting.figures import BESIDE, alone, crashes_against_speed
from experiments.reporting.rare import doses_figure, rare_figure
from experiments.reporting.tables import chosen, effect, interval, plain, points
from experiments.reporting.takeover import danger_figure
from experiments.study.compute.takeover import PAIR
from experiments.study.design.arms import ARMS
from experiments.study.design.sheet import GRID, sheet
from experiments.validation.figure import validation_figure
from sumo_env.tasks import TASKS

TEMPLATES = ROOT / "docs" / "templates"
CELL = r"sumo-(?P<task>\D+)-(?P<level_name>[\d+]+)-(?P<arm>[a-z-]+?)(?:-s(?P<seed>\d+))?-[0-9a-f]{12}"
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


def trained() -> str:
    """Crash rates of published agents on both simulators, lightest levels: "SUMO→highway-env", a line a task [%]."""
    rows = pd.DataFrame([{"task": task, **row} for task, own in verdict().items() for row in own["agents"]])
    lines = []
    for task in GRID:
        line = {"task": f"{task} {GRID[task][0]}"}
        for row in chosen(rows, task=task, level=GRID[task][0]).to_dict("records"):
            rates = (points(row[side], "crashed", signed=False) for side in ("sumo", "reference"))
            line[f"{row['ego']}, {row['traffic']}"] = "→".join(rates)
        lines.append(line)
    return _markdown(lines)


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
def episodes() -> pd.DataFrame:
    """The test episodes of the published study on SUMO, with SURROGATES, from files of an earlier version."""
    parts = sorted((ROOT / "results" / "study" / "parts").glob("*.parquet"))
    tests = chosen(pd.concat(map(pd.read_parquet, parts)), purpose="test")
    rows = tests[~tests["cell"].str.contains("-on-replica-|-unseen-")]
    cells = pd.Series(rows["cell"].unique())
    cells = cells.str.extract(CELL).assign(cell=cells, backend="sumo", tested_on="sumo")
    cells["level"] = [GRID[task].index(name) + 1 for task, name in cells[["task", "level_name"]].values]
    cells["kind"] = cells["arm"].isin(ARMS).map({True: "agent", False: "baseline"})
    rows = rows.astype({"crashed": float}).merge(cells.assign(policy=cells["arm"]), on="cell")
    return rows.assign(**{name: one.of for name, one in SURROGATES.items()})


@functools.cache
def study() -> Any:
    """The analysis of the published study, as the report's tables take it, and danger: its SURROGATES by task."""
    stored = json.loads((ROOT / "results" / "study" / "analysis.json").read_text())
    parts = {name: part for name, part in stored.items() if isinstance(part, dict) and "columns" in part}
    frames = {name: pd.DataFrame(part["rows"], columns=part["columns"]) for name, part in parts.items()}
    frames["danger"] = effects_by_task(episodes(), DEFAULT, SURROGATES)
    return SimpleNamespace(**stored | frames)


def checks() -> pd.DataFrame:
    """The checks of SUMO against highway-env one by one, of all scenarios or of the first ones."""
    return pd.read_csv(ROOT / "results" / "validation.csv")


@functools.cache
def moments() -> pd.DataFrame:
    """The record of `experiments/takeover.py` in which two pairs of published agents were driven."""
    return pd.read_parquet(ROOT / "results" / "takeover.parquet")


def taken_over() -> list[tuple[dict[str, Any], ...]]:
    """Of each task and leader of that record, in risky and in regular traffic: danger and, by driver, crashes [%]."""
    found = []
    for task, leader in product(GRID, PAIR):
        both = []
        for traffic in ("risky", "regular"):
            rows = chosen(moments(), task=task, traffic=traffic)
            danger = takeover.overall(rows).set_index("driver").loc[leader, "danger"]
            crashed = chosen(takeover.rates(rows), leader=leader).set_index("driver")["crashed"]
            both.append({"task": task, "danger": 100 * danger, "crashed": (100 * crashed).to_dict()})
        found.append(tuple(both))
    return found


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


def survivors(task: str, level: str) -> tuple[int, int]:
    """How many drivers the study has in a setting, and how many of them ever survive a regular episode."""
    own = chosen(episodes(), task=task, level_name=level, traffic="regular")
    survive = own.groupby("cell")["crashed"].min() < 1
    return len(survive), int(survive.sum())


SHARES: dict[str, Callable[[pd.DataFrame], pd.Series]] = {
    "enters": lambda rows: rows["distance"] >= sheet("roundabout").crossing,
    "overtakes at once": lambda rows: rows["actions"].str[:2].str.contains("0"),  # LANE_LEFT, within 2 s
    "hits an oncoming car": lambda rows: rows["crash_type"] == "frontal",
}


def share(what: str, task: str, level: str, arm: str) -> float:
    """In how many of the regular test episodes of an arm's agents that happens [%]."""
    own = chosen(episodes(), task=task, level_name=level, arm=arm, traffic="regular", kind="agent")
    return float(100 * SHARES[what](own).mean())


def other_learners(learner: str) -> tuple[float, float]:
    """The least and the largest crash rate in risky traffic of a learner's agents, roundabout, 5 cars, replica [%]."""
    table = pd.read_parquet(ROOT / "results" / "other-learners" / "trainings.parquet")
    rates = 100 * chosen(table, task="roundabout", traffic="risky", learner=learner)["crashed"]
    return rates.min(), rates.max()


def events_per_hour(task: str) -> float:
    """How many risk events a vehicle of the task has at dose 1 in an hour."""
    rates = TASKS[task].risk_rates
    return 3600 * (rates.cut_in + rates.brake + rates.surge)


def arrow(row: dict[str, Any], bold: bool = False) -> str:
    """From control to treated agents, "38.4→34.2"; bold where the interval of the difference excludes 0."""
    control, treated = (
        points(row[side], row["outcome"], signed=False) for side in ("mean_against", "mean_arm")
    )
    return f"{control}→**{treated}**" if bold and row["low"] * row["high"] > 0 else f"{control}→{treated}"


def _markdown(lines: list[dict[str, str]]) -> str:
    table = pd.DataFrame(lines).fillna("")
    rows = [list(table.columns), ["---"] * len(table.columns), *table.values]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


FUNCTIONS: list[Callable[..., Any]] = [
    *(by_task.difference, checks, entries, events_per_hour, failing, other_learners, readme_agents, row),
    *(share, study, survivors, taken_over, trained, trainings, validation, verdict),
]
FILTERS: list[Callable[..., str]] = [arrow, effect, interval, plain, points]
LEADS = "random actions", "DQN, median and range"
# Their files are in docs/img; study: of each task's lightest traffic.
FIGURES: dict[str, Callable[[], str]] = {
    "study": lambda: crashes_against_speed(
        drivers(chosen(episodes(), level=1, arm=[*ARMS, *BESIDE])), "study"
    ),
    "takeover": lambda: danger_figure(moments()),
    "entries": entries_figure,
    "settings": lambda: crashes_against_speed(learned(), "settings", LEADS),
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
