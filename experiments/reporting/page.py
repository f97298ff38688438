"""What the templates show: frames of text, figures and films of one folder; no decisions, no words."""

from base64 import b64encode
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from experiments.analysis.analysis import Analysis
from experiments.analysis.effects import ALL_TASKS
from experiments.analysis.estimate import OK, SATURATED
from experiments.analysis.gates import GATES
from experiments.analysis.plan import ALPHA, Outcome, Plan, plan_of
from experiments.analysis.scores import with_outcomes
from experiments.reporting import arrows, by_task, figures, tables, takeover
from experiments.reporting.tables import BACKENDS, FILTERS, chosen, main
from experiments.study.compute.progress import duration
from experiments.study.design.arms import ARMS, DOSE_ARMS
from experiments.study.design.levels import tasks_known
from experiments.study.design.traffic import TRAFFICS
from experiments.study.design.verdict import verdicts
from experiments.study.results.loaded import Results
from experiments.study.results.store import Store
from sumo_env.unsupported import DOCUMENTATION

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"


def page(
    results: Results,
    analysis: Analysis,
    others: Mapping[str, tuple[Analysis, pd.DataFrame]],
    own: Mapping[str, Outcome] | None = None,
) -> dict[str, Any]:
    """The templates' variables.

    Args:
        others: analyses of further folders to compare with this one, by name, and how their effects differ
            (`effects.between`). own: outcomes of the user's own in it.
    """
    names = list(dict.fromkeys(analysis.policies["backend"]))
    pairs = skill(results.directory)
    moments = pairs.get("table", pd.DataFrame())
    return {
        "smoke": "smoke" in analysis.provenance["presets"],
        "backends": [backend(name, results, analysis, moments, own or {}) for name in names],
        "films": films(results.directory),
        "skill": pairs,
        "side_by_side": tables.side_by_side(
            {str(results.directory): analysis, **{name: one for name, (one, _) in others.items()}},
            {name: differences for name, (_, differences) in others.items()},
        ),
        "notes": analysis.notes,
        "checks": checks(results),
        "directory": str(results.directory),
        "commands": [sweep["command"] for sweep in Store(results.directory).sweeps()],
        "gate_texts": GATES,
        "seconds": duration(analysis.provenance["seconds"]),
        "computed": computed(results),
        "address": DOCUMENTATION,
        **{name: getattr(analysis, name) for name in ("plan", "plan_hash", "provenance")},
    }


def skill(directory: Path) -> dict[str, Any]:
    """Skill and caution, where pairs of agents were driven from equal moments (docs/takeover.md)."""
    if (rows := takeover.recorded(directory)) is None:
        return {}
    table, figure = takeover.skill_or_caution(rows), takeover.danger_figure(rows)
    denser = takeover.recorded(directory, lightest=False)
    return {
        "table": table,
        "decided": takeover.decided(table),
        "figure": Markup(figure),
        "denser": pd.DataFrame() if denser is None else takeover.skill_or_caution(denser, "p"),
    }


def films(directory: Path) -> dict[str, str]:
    """The films that lie in a folder, by name, so that the page has them in itself."""
    return {path.name: b64encode(path.read_bytes()).decode() for path in sorted(directory.glob("*.gif"))}


def computed(results: Results) -> dict[str, Any]:
    """When the newest cell was finished, and at which commits."""
    cells = results.cells.values()
    finished = {str(cell.get("timing", {}).get("finished", "")) for cell in cells}
    commits = {str((cell.get("provenance") or {}).get("git") or "")[:7] for cell in cells}
    return {
        "date": max(finished, default="")[:10],
        "commits": sorted(commits - {""}),
    }


def backend(
    name: str, results: Results, analysis: Analysis, moments: pd.DataFrame, own: Mapping[str, Outcome]
) -> dict[str, Any]:
    """All that is shown of one simulator. moments: of `takeover.skill_or_caution`. own: outcomes of the user's own."""
    return {
        "name": BACKENDS.get(name, name),
        "key": name,
        **answer(name, analysis),
        "claims": chosen(analysis.claims, backend=name).to_dict("records"),
        "figures": drawn(name, results, analysis),
        "signs": by_task.signs(analysis, name, moments),
        "tasks": by_task.levels(analysis, name),
        "away": by_task.levels(analysis, name, away=True),
        "in_full": [by_task.by_task(analysis, name, away) for away in (False, True)],
        "means": by_task.means_of_tasks(analysis, name),
        "competent": by_task.levels(replace(analysis, by_task=analysis.competent), name),
        **{part: make(analysis, name) for part, make in tables.TABLES.items()},
        "own": tables.own(analysis, name, own),
        "placebo": chosen(analysis.placebo, backend=name).to_dict("records"),
    }


def answer(name: str, analysis: Analysis) -> dict[str, Any]:
    """What holds in which task and where, how many settings are on which side, and what limits it."""
    means = chosen(main(analysis.means, name), outcome="crashed", term="risky", scope=ALL_TASKS)
    risky = dict(means.iloc[0]) if len(means) else {}
    single = chosen(main(analysis.effects, name), outcome="crashed", term=list(TRAFFICS))
    asked = by_task.places(analysis, name)
    plan = plan_of(analysis.provenance["presets"])
    own = chosen(analysis.gates, backend=name, arm=list(ARMS))
    return {
        "answered": bool(risky) and risky["status"] == OK,
        "risky": risky,
        "settings": risky.get("settings", 0),
        "exploratory": [] if risky else [task for task in tasks_known() if task in set(single["task"])],
        "where": [
            {
                **{"words": words, "simulator": place[0], "traffic": place[1]},
                "crashed": by_task.sides(analysis, name, "crashed", place),
            }
            for place, words in asked.items()
        ],
        "failing": by_task.failing(own),
        "hopeless": by_task.hopeless(analysis, name),
        "undrivable": analysis.notes["undrivable"],
        "beside": [task for task in tasks_known() if task in set(single["task"]) - set(plan.tasks)],
        "missing": missing(single, plan),
        "saturated": single.loc[single["status"] == SATURATED, ["task", "level"]].drop_duplicates().shape[0],
        **sides(single),
    }


def missing(single: pd.DataFrame, plan: Plan) -> list[str]:
    """The levels of each task that a plan for all its settings has no effects of: "highway 100 and 150"."""
    there = set(zip(single["task"], single["level_name"], strict=True))
    lacking: dict[str, list[str]] = {}
    for task, name in plan.settings if plan.stages else ():
        if (task, name) not in there:
            lacking.setdefault(task, []).append(name)
    return [f"{task} {tables.listing(names)}" for task, names in lacking.items()]


def sides(single: pd.DataFrame) -> dict[str, dict[str, list[str]]]:
    """The settings in which the plan decides that there are fewer or more crashes, by traffic."""
    decided = tables.with_setting(single[single["p_adjusted"] < ALPHA] if len(single) else single)
    return {
        side: {
            term: list(chosen(decided[sign * decided["estimate"] > 0], term=term)["setting"])
            for term in TRAFFICS
        }
        for side, sign in (("fewer", -1), ("more", 1))
    }


def lightest(drivers: pd.DataFrame) -> pd.DataFrame:
    """The drivers of each task's lightest setting, of tasks in which there are both arms."""
    first = drivers[drivers["level"] == drivers.groupby("task")["level"].transform("min")]
    arms = chosen(first, driver=list(ARMS)).groupby("task")["driver"].nunique()
    return chosen(first, task=list(arms.index[arms == len(ARMS)]))


def drawn(name: str, results: Results, analysis: Analysis) -> dict[str, Markup | None]:
    """The figures of one simulator; None where its results do not allow one."""
    policies = chosen(analysis.policies, backend=name, traffic=list(TRAFFICS))
    effects = main(analysis.effects, name)
    doses = policies["arm"].isin(set(DOSE_ARMS) - set(ARMS)).any()
    drives = with_outcomes(results)
    drives = chosen(drives, kind="agent", backend=name, arm=list(figures.COLOURS))
    agents = {cell: results.cells[cell] for cell in drives["cell"].unique()}
    compared = lightest(chosen(analysis.drivers, backend=name))
    found = {
        "traffic": figures.against_traffic(policies, name),
        "speed": arrows.crashes_against_speed(compared, name) if len(compared) else None,
        "effects": figures.effects_by_setting(effects, name) if len(effects) else None,
        "doses": figures.dose_response(policies, name) if doses else None,
        "learning": figures.learning_curves(agents, name) if agents else None,
        "seconds": figures.crashes_by_second(drives, name) if agents else None,
    }
    return {key: Markup(svg) if svg else None for key, svg in found.items()}


def checks(results: Results) -> dict[str, Any]:
    """How many checks of SUMO against highway-env there are, and whose estimates are outside of their margins."""
    on_sumo = [cell for cell in results.cells.values() if cell["key"]["backend"] == "sumo"]
    tasks = verdicts(on_sumo)
    total = sum(sum(verdict["counts"].values()) for verdict in tasks.values())
    outside = [{"task": task, **item} for task, verdict in tasks.items() for item in verdict["outside"]]
    return {"relevant": bool(on_sumo), "total": total, "outside": outside}


@cache
def templates(autoescape: bool) -> Environment:
    """All templates, each compiled once: of HTML, or of plain text."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=autoescape,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= FILTERS
    return environment


def render(variables: Mapping[str, Any], template: str) -> str:
    """One of the templates as a text."""
    return templates(template.endswith(".html.j2")).get_template(template).render(variables)
