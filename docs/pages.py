"""The pages that quote results: ``make pages`` fills their numbers in from the stored tables.

Each file of docs/templates/ is a page in Markdown: README.md.j2 is the README, any other the page of its name in docs/.
Where a page has a number of the results, its template calls a function of this module. {{ effect("second", "crashed",
"risky") }} becomes the effect of the treatment on the crash rate in risky traffic, as results/second/analysis.json has
it. The words are the templates' own. Filled pages are committed, because GitHub shows them; ``--check`` compares alone.

In all functions `folder` is the name of a folder of results/ and `traffic` that of the test ("risky", "regular" or one
of unseen risk). `scope` is what is averaged: "all tasks", a task, "without TASK", "lightest" (the lightest setting of
each task) or one setting ("u-turn 12"). `who` is an arm, or a policy that does not learn. Shares are in per cent.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_HALF_UP, Decimal
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(ROOT)

import pandas as pd
import pyarrow.parquet as pq
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from scipy import stats

from experiments.analysis.analysis import Analysis, stored
from experiments.analysis.by_task import COLUMNS
from experiments.analysis.plan import OUTCOMES
from experiments.reporting import by_task, tables
from experiments.reporting.tables import UNITS, chosen, plain
from sumo_env.tasks import TASKS

RESULTS = ROOT / "results"
TEMPLATES = ROOT / "docs" / "templates"
NOTE = "<!-- Filled by `make pages` from {template}: edit that file. -->\n"
ALL = "all tasks"
LIGHTEST = "lightest"
CONSTANT = ("idle", "random", "faster", "slower")
NO_BREAK = "\N{NO-BREAK SPACE}"  # in cells of a table: a narrow screen scrolls instead of breaking numbers
WORDS = [
    "none",
    "one",
    "two",
    "three",
    "four",
    "five",
    "six",
    "seven",
    "eight",
    "nine",
    "ten",
    "eleven",
    "twelve",
]


# -- the stored tables -------------------------------------------------------------------------------------------------


@cache
def analysis(folder: str) -> Analysis:
    """The stored analysis of a folder."""
    return stored(RESULTS / folder / "analysis.json")


@cache
def table(path: str) -> pd.DataFrame:
    """A table of results/ that no sweep has written."""
    return pd.read_parquet(RESULTS / path)


@cache
def episodes(folder: str) -> pd.DataFrame:
    """The test episodes of a folder in the simulator of the training.

    Columns: of the stored episodes; task, level, setting, kind, arm, policy and seed of their cell, and the `seconds`
    that an episode lasts.
    """
    records = pd.read_parquet(RESULTS / folder / "cells.parquet").set_index("cell")["record"].map(json.loads)
    keys = pd.DataFrame([{"cell": name, **record["key"]} for name, record in records.items()])
    keys["setting"] = keys["task"] + " " + keys["level_name"]
    keys["seconds"] = keys["env_config"].map(lambda config: float(config["duration"]))
    keys = keys[["cell", "kind", "task", "level", "setting", "arm", "policy", "seed", "seconds"]]
    path = RESULTS / folder / "episodes.parquet"
    wanted = ["cell", "traffic", "scenario", "crashed", "crash_time", "crash_type", "actions"]
    there = pq.read_schema(path).names  # earlier studies have no actions
    drives = pd.read_parquet(path, columns=[name for name in wanted if name in there]).merge(keys, on="cell")
    return chosen(drives, kind=("agent", "baseline"))


def tasks(folder: str) -> list[str]:
    """The tasks of a folder."""
    there = set(analysis(folder).effects["task"])
    return [task for task in TASKS if task in there]


def settings(folder: str) -> list[str]:
    """The settings of a folder, from the lightest to the densest of each task, in the order of the tasks."""
    effects = analysis(folder).effects
    rows = effects.assign(order=effects["task"].map(list(TASKS).index)).sort_values(["order", "level"])
    return list(dict.fromkeys(rows["task"] + " " + rows["level_name"]))


def in_scope(rows: pd.DataFrame, scope: str) -> pd.DataFrame:
    """Those of rows with a task and a level that a scope is about."""
    if scope == ALL:
        return rows
    if scope == LIGHTEST:
        return rows[rows["level"] == 1]
    if scope in TASKS:
        return rows[rows["task"] == scope]
    found = rows[rows["task"] + " " + rows["level_name"] == scope]
    if found.empty:
        raise LookupError(
            f"no rows of {scope!r}: give {ALL!r}, {LIGHTEST!r}, a task or a setting (u-turn 12)"
        )
    return found


# -- numbers as pages show them ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Number:
    """A number with its 95 % interval, in the unit in which it is shown: "−12.8 [−14.7, −11.0]"."""

    value: float
    low: float
    high: float
    digits: int = 1
    unit: str = ""
    signed: bool = True

    def __str__(self) -> str:
        return f"{self.estimate} {self.interval}"

    def shown(self, value: float) -> str:
        """One of the three as a text."""
        return plain(value, self.digits, self.signed)

    @property
    def estimate(self) -> str:
        """Without the interval: "−12.8"."""
        return self.shown(self.value)

    @property
    def marked(self) -> str:
        """Without the interval, bold where that excludes 0: "**−12.8**"."""
        return f"**{self.estimate}**" if self.low > 0 or self.high < 0 else self.estimate

    @property
    def interval(self) -> str:
        """The interval alone: "[−14.7, −11.0]"."""
        return f"[{self.shown(self.low)}, {self.shown(self.high)}]"

    @property
    def with_unit(self) -> str:
        """All of it: "−12.8 points [−14.7, −11.0]"."""
        return f"{self.estimate}{self.unit} {self.interval}"


@dataclass(frozen=True)
class Count:
    """How many of some things: "59 of 60"."""

    number: int
    of: int

    def __str__(self) -> str:
        return f"{self.number} of {self.of}"


def count(found: Any) -> Count:
    """How many of some values are true."""
    return Count(int(sum(found)), len(found))


def number(
    row: Mapping[str, Any], scale: float = 100, digits: int = 1, unit: str = " points", signed: bool = True
) -> Number:
    """A row with estimate, low and high, by default of a share in points."""
    return Number(scale * row["estimate"], scale * row["low"], scale * row["high"], digits, unit, signed)


def short(value: float, digits: int = 3) -> str:
    """A number below 1 without its zero: ".012"; a half is rounded away from 0."""
    exact = Decimal(f"{value:.12g}").quantize(Decimal(10) ** -digits, ROUND_HALF_UP)
    return plain(float(exact), digits).replace("0.", ".", 1)


def in_words(value: int) -> str:
    """A small number as a word: "eleven"."""
    return WORDS[value] if value < len(WORDS) else str(value)


# -- effects and rates of a study --------------------------------------------------------------------------------------


def row_of(
    folder: str,
    outcome: str,
    traffic: str,
    scope: str,
    arm: str = "treatment",
    tested_on: str | None = None,
    against: str = "control",
) -> dict[str, Any]:
    """The row of an effect, of the analysis' means or of its effects."""
    found = analysis(folder)
    home = found.effects["backend"].iloc[0]
    place = tested_on or home
    wanted = {"arm": arm, "against": against, "tested_on": place, "outcome": outcome, "term": traffic}
    wanted["scenarios"] = "own" if place == home else place
    if scope == LIGHTEST:
        return pooled(in_scope(chosen(found.effects, **wanted), scope))
    rows = chosen(found.means, **wanted, scope=scope)
    if rows.empty:
        rows = in_scope(chosen(found.effects, **wanted), scope)
    if len(rows) != 1:
        raise LookupError(f"results/{folder} has {len(rows)} effects of {wanted} in {scope!r}, expected one")
    return dict(rows.iloc[0])


def pooled(rows: pd.DataFrame) -> dict[str, Any]:
    """The mean of effects of one setting a task, with its t interval (Satterthwaite)."""
    sound = rows[rows["se"].notna()]  # where nothing varies there is no error to add
    variances = (sound["se"] / len(rows)) ** 2
    freedom = variances.sum() ** 2 / (variances**2 / sound["df"]).sum()
    estimate, half = rows["estimate"].mean(), stats.t.ppf(0.975, freedom) * variances.sum() ** 0.5
    return {"estimate": estimate, "low": estimate - half, "high": estimate + half}


def effect(
    folder: str,
    outcome: str,
    traffic: str,
    scope: str = ALL,
    arm: str = "treatment",
    tested_on: str | None = None,
    against: str = "control",
) -> Number:
    """An arm minus control, or another arm: the mean over a scope, with its interval.

    Args:
        tested_on: the simulator of the test, where it is not that of the training.
    """
    kind, found = OUTCOMES[outcome], row_of(folder, outcome, traffic, scope, arm, tested_on, against)
    scale, unit = (100, " points") if kind.percent else (1, UNITS.get(outcome, ""))
    return number(found, scale, kind.digits, unit)


@cache
def policies(folder: str) -> pd.DataFrame:
    """Means of every policy in every setting and traffic, with `who`: its arm, or its name if it does not learn."""
    rows = analysis(folder).policies
    return rows.assign(who=rows["arm"].where(rows["arm"] != "", rows["policy"]))


def mean_of(folder: str, column: str, who: str, traffic: str, scope: str = ALL) -> float:
    """The mean of a column of `policies`: every task alike, and in a task every level."""
    rows = in_scope(chosen(policies(folder), who=who, traffic=traffic), scope)
    return float(rows.groupby("task")[column].mean().mean())


def rate(folder: str, who: str, traffic: str, scope: str = ALL, digits: int = 0) -> str:
    """A crash rate in per cent: "34"."""
    return plain(100 * mean_of(folder, "crashed", who, traffic, scope), digits)


def who_drives(folder: str) -> dict[str, str]:
    """Who drives in every task of a folder, one agent or two together, and the words for it."""
    return tables.who_drives(policies(folder))


def returns(folder: str, who: str | Sequence[str], traffic: str) -> str:
    """The cells of a table's line: return and crash rate in the lightest setting of each task, "18.67 (.04) | ...".

    Of several policies that with the highest return.
    """
    rows = chosen(
        policies(folder), who=[who] if isinstance(who, str) else list(who), traffic=traffic, level=1
    )
    best = rows.sort_values("return").groupby("task").tail(1).set_index("task").loc[tasks(folder)]
    pairs = zip(best["return"], best["crashed"], strict=True)
    return " | ".join(f"{value:.2f} ({short(crashed, 2)})" for value, crashed in pairs)


def decided(folder: str, arm: str, traffic: str, fewer: bool = True) -> Count:
    """In how many settings the plan decides that an arm's agents crash less (or more) often than control agents."""
    home = analysis(folder).effects["backend"].iloc[0]
    wanted = {"arm": arm, "against": "control", "outcome": "crashed", "term": traffic, "scenarios": "own"}
    rows = chosen(analysis(folder).effects, **wanted, tested_on=home)
    return count((rows["p_adjusted"] < 0.05) & ((rows["estimate"] < 0) == fewer))


def row(folder: str, table: str, **values: str | int) -> dict[str, Any]:
    """The one row of a table of the analysis (claims, placebo, price, learner) that has these values."""
    rows = chosen(getattr(analysis(folder), table), **values)
    if len(rows) != 1:
        raise LookupError(f"results/{folder} has {len(rows)} rows of {table} with {values}, expected one")
    return dict(rows.iloc[0])


def price(folder: str, traffic: str, scope: str = ALL, **which: str) -> Number:
    """What mixed training loses of the gain (risky traffic) or adds to the harm (regular); `high` is one-sided.

    Args:
        which: under the fourth plan, arm and against: that difference, with a sign.
    """
    return number(row(folder, "price", term=traffic, scope=scope, **which), signed=bool(which))


def is_published(folder: str) -> bool:
    """Whether a folder has an analysis."""
    return (RESULTS / folder / "analysis.json").is_file()


# -- task by task -----------------------------------------------------------------------------------------------------


def markdown(frame: pd.DataFrame) -> str:
    """A frame of text as a table."""
    head, *lines = (
        f"| {' | '.join(map(str, line))} |" for line in [[*frame.columns], *frame.fillna("").values.tolist()]
    )
    return "\n".join([head, "|" + "---|" * frame.shape[1], *lines])


def task_table(folder: str, away: bool = False, columns: Sequence[str] = tuple(COLUMNS)) -> str:
    """The report's table of tasks: at home, or (away) without events and on another simulator."""
    home = analysis(folder).effects["backend"].iloc[0]
    found = by_task.by_task(analysis(folder), home, away=away, columns=columns, between=": ")
    return markdown(found).replace(" → ", "→")


def means_table(folder: str) -> str:
    """The report's table of the mean over tasks, and without each task in turn."""
    return markdown(by_task.means_of_tasks(analysis(folder), analysis(folder).effects["backend"].iloc[0]))


def change(folder: str, outcome: str, traffic: str, task: str, interval: bool = False) -> str:
    """A cell of a short table: control→treated, in bold where they differ ("38→**34**"), with their difference and its
    interval if asked for ("38→34: **−4.2** [−7.2, −1.1]").
    """
    found = row(
        folder, "by_task", scope=task, outcome=outcome, traffic=traffic, arm="treatment", tested_on="sumo"
    )
    scale, digits = (100 if COLUMNS[outcome].percent else 1), int(outcome == "mean_speed")
    control, treated = (plain(scale * found[name], digits) for name in ("mean_against", "mean_arm"))
    if interval:
        difference = number(found, unit="")
        return f"{control}→{treated}: {difference.marked} {difference.interval}"
    return f"{control}→**{treated}**" if by_task.differs(found) else f"{control}→{treated}"


def share_of(folder: str, outcome: str, traffic: str, task: str, who: str = "treatment") -> str:
    """A share of control or treated agents in a task in per cent: "57"."""
    found = row(
        folder, "by_task", scope=task, outcome=outcome, traffic=traffic, arm="treatment", tested_on="sumo"
    )
    return plain(100 * found["mean_against" if who == "control" else "mean_arm"], 0)


def mean_elsewhere(folder: str, traffic: str, scope: str = ALL, tested_on: str = "sumo") -> Number:
    """Crash rate of treated minus control agents, in any traffic and on any simulator that they were tested in."""
    wanted = {"scope": scope, "traffic": traffic, "tested_on": tested_on, "outcome": "crashed"}
    return number(row(folder, "by_task", arm="treatment", **wanted))


def without_pair(folder: str, against: str, traffic: str, task: str, seed: int) -> Number:
    """A bound of the plan over all tasks without one pair of agents; `low` and `high` are one-sided."""
    found = row(folder, "influence", against=against, term=traffic, left_task=task, left_seed=seed)
    return number(found)


def opening(folder: str, setting: str, traffic: str, arm: str, action: int, steps: int) -> str:
    """In how many per cent of the episodes an agent chooses an action in its first steps: "99"."""
    actions = drives(folder, setting, traffic, arm)["actions"].str[:steps]
    return plain(100 * float(actions.str.contains(str(action)).mean()), 0)


def kinds_of_crash(folder: str, setting: str, traffic: str, arm: str, kind: str) -> str:
    """In how many per cent of the episodes there is a crash of a kind ("frontal"): "45"."""
    return plain(100 * float((drives(folder, setting, traffic, arm)["crash_type"] == kind).mean()), 0)


def paper(folder: str) -> dict[str, int]:
    """In how many settings the paper's measure, the return summed over both traffics, is right, wrong and open."""
    found = row(folder, "claims", name="return rises", quantity="sum")
    return {name: int(found[name]) for name in ("right", "wrong", "open")}


# -- the agents of a study ---------------------------------------------------------------------------------------------


def agents(folder: str, arms: Sequence[str] = (), scope: str = ALL) -> pd.DataFrame:
    """The gates of a folder's agents."""
    gates = analysis(folder).gates
    return in_scope(chosen(gates, arm=tuple(arms)) if arms else gates, scope)


def passing(folder: str, arms: Sequence[str] = ("control", "treatment"), scope: str = ALL) -> Count:
    """How many agents pass every gate."""
    return count(agents(folder, arms, scope)["passed"].eq(True))


def passing_where(folder: str) -> str:
    """How many agents pass every gate, and where they fail: "157 of 195 (7 of 15 on two-way 5+2, ...)"."""
    found = by_task.failing(agents(folder, ["control", "treatment", "mixed"]))
    parts = [f"{passed} of {of} on {name}" for name, (passed, of) in found["named"].items()]
    parts.append(f"{found['rest'][0]} of {found['rest'][1]} elsewhere")
    return f"{found['passed']} of {found['of']} ({', '.join(parts)})"


def failing(folder: str, gate: str, arms: Sequence[str] = (), scope: str = ALL) -> Count:
    """How many agents fail a gate."""
    return count(agents(folder, arms, scope)[gate].eq(False))


def checks(folder: str) -> Count:
    """How many of the plan's checks of the learner are met."""
    return count(analysis(folder).learner["passed"].eq(True))


# -- episodes ----------------------------------------------------------------------------------------------------------


def drives(folder: str, setting: str, traffic: str, arm: str) -> pd.DataFrame:
    """Test episodes of an arm's agents."""
    return chosen(episodes(folder), kind="agent", setting=setting, traffic=traffic, arm=arm)


def late_crashes(folder: str, setting: str, arm: str = "treatment", traffic: str = "regular") -> Count:
    """How many of the crashes come in the last second of the test."""
    crashes = drives(folder, setting, traffic, arm).query("crashed")
    return count(crashes["crash_time"] > crashes["seconds"] - 1.0)


# -- tables beside the studies -----------------------------------------------------------------------------------------


def other_learners() -> Iterator[list[str]]:
    """Lines of a table: the learner, then by task the crash rate in risky traffic over its trainings."""
    stored = table("other-learners/trainings.parquet")
    trained = stored[~stored["learner"].isin([*CONSTANT, "idm", "careful"])]
    frame = chosen(trained, traffic="risky").groupby(["learner", "task"])["crashed"].mean().unstack("task")
    for learner, values in frame[[task for task in TASKS if task in frame]].iterrows():
        yield [str(learner), *(f"{value:.2f}" for value in values)]


def planner_scenarios() -> list[int]:
    """The scenarios that the planners have driven, the same in each traffic and task."""
    return sorted(set(table("copies/planners.parquet")["scenario"]))


def share(found: Count) -> str:
    """A share in per cent with Wilson's 95 % interval: "10% [4, 21]"."""
    interval = stats.binomtest(found.number, found.of).proportion_ci(method="wilson")
    return f"{found.number / found.of:.0%} [{100 * interval.low:.0f}, {100 * interval.high:.0f}]"


def avoidable() -> Iterator[list[str]]:
    """Lines of a table: the share of crashes of both arms that could still be avoided 2 s before."""
    crashes = table("copies/avoidable.parquet")
    for (task, level), own in crashes.groupby(["task", "level_name"]):
        late = own["contact"] - own["last"] <= 2
        yield [
            f"{task} {level}",
            *(share(count(late[own["arm"] == arm])) for arm in ("control", "treatment")),
        ]


@cache
def choice(*seeds: int) -> pd.DataFrame:
    """The trainings of the learner's choice: return at the end and its change over the last quarter, in units of its
    range, and the largest Q-value over the bound; a row a task, variant, arm and seed.
    """
    runs = chosen(table("choice/runs.parquet"), seed=seeds)
    ranges = analysis("second").plan["learner"]["ranges"]
    runs = runs.assign(
        value=runs["return"] / runs["task"].map(ranges), largest=runs["largest_q"] / runs["q_bound"]
    )
    by = ["task", "variant", "arm", "seed"]
    found = runs.pivot_table(index=by, columns="share", values="value")
    largest = runs.groupby(by)["largest"].max()
    return pd.DataFrame({"return": found[1.0], "change": found[1.0] - found[0.75], "largest": largest})


def variant(name: str, task: str) -> dict[str, float]:
    """Of two seeds of a variant of the learner: mean return and its change by arm, and the largest Q-value."""
    rows = choice(900, 901).xs((task, name), level=("task", "variant"))
    changes = rows.groupby("arm")["change"].mean()
    return {"score": rows["return"].mean(), "largest": rows["largest"].max(), **changes}


def validation(task: str | None = None) -> dict[str, int]:
    """How many checks of SUMO against highway-env there are (all), and how many are equivalent, within and missed."""
    verdict = json.loads((ROOT / "experiments" / "validation" / "verdict.json").read_text())
    counts = pd.DataFrame({name: own["counts"] for name, own in verdict.items()})
    sums = (counts.sum(axis=1) if task is None else counts[task]).to_dict()
    passed = sums["equivalent"] + sums["within"]
    return {"all": passed + sums["missed"], "passed": passed, **sums}


def missed(task: str, level: str, traffic: str, name: str, ego: str = "") -> dict[str, float]:
    """A check that is missed: the numbers of sumo and of the reference, and the margin."""
    verdict = json.loads((ROOT / "experiments" / "validation" / "verdict.json").read_text())
    wanted = {"level": level, "traffic": traffic, "name": name, "ego": ego}
    found: dict[str, float]
    (found,) = (item for item in verdict[task]["missed"] if wanted.items() <= item.items())
    return found


def road_units(task: str, unit: str, digits: int) -> str:
    """Three cells of a table: a unit of the road at dose 0, at dose 1 and among measured drivers."""
    values = chosen(table("road-units.parquet"), task=task).set_index("traffic")[unit]
    return " | ".join(plain(values[traffic], digits) for traffic in ("0", "1", "measured"))


# -- pages -------------------------------------------------------------------------------------------------------------

FUNCTIONS: list[Callable[..., Any]] = [
    avoidable, change, checks, decided, effect, failing, is_published, kinds_of_crash, late_crashes,
    mean_elsewhere, means_table, missed, opening, other_learners, paper, passing, passing_where, planner_scenarios,
    price, rate, returns, road_units, row, settings, share_of, task_table, tasks, validation, variant, who_drives,
    without_pair,
]  # fmt: skip


def page_of(template: Path) -> Path:
    """The page that a template becomes."""
    name = template.relative_to(TEMPLATES).with_suffix("")
    return ROOT / name if name == Path("README.md") else ROOT / "docs" / name


def filled(template: Path) -> str:
    """The text of the page that a template becomes."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    environment.globals.update({function.__name__: function for function in FUNCTIONS})
    environment.filters.update(plain=plain, short=short, in_words=in_words)
    text = environment.get_template(str(template.relative_to(TEMPLATES))).render()
    return NOTE.format(template=template.relative_to(ROOT)) + text


def templates() -> list[Path]:
    """All templates."""
    return sorted(TEMPLATES.rglob("*.md.j2"))


def main() -> int:
    """Write the pages, or with --check say which are not what their templates make; 1 if there is one."""
    stale = 0
    for template in templates():
        page, text = page_of(template), filled(template)
        if page.exists() and page.read_text(encoding="utf-8") == text:
            continue
        if "--check" in sys.argv:
            print(f"{page.relative_to(ROOT)} is not what its template makes: make pages", file=sys.stderr)
            stale = 1
        else:
            page.write_text(text, encoding="utf-8")
            print(page.relative_to(ROOT))
    return stale


if __name__ == "__main__":
    sys.exit(main())
