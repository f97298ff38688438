"""Result directories side by side: what each answers, in one picture, and what the seeds of each can tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from experiments.analysis import statistics
from experiments.analysis.effects import Record, as_record
from experiments.analysis.plan import ALPHA, OUTCOMES, POWER
from experiments.analysis.pooling import ALL_TASKS, task_weights
from experiments.analysis.statistics import MISSING, OK, Mean
from experiments.analysis.tables import PLACE, TASK_ORDER
from experiments.analysis.wording import BACKENDS, NONE, count, difference, number, place
from experiments.reporting.figures import side_by_side

# The tables, and how they are called; the first one is drawn.
QUESTIONS = {
    ("crashed", "risky"): "crash rate in risky traffic",
    ("crashed", "regular"): "crash rate in regular traffic",
    ("return", "sum"): "return, sum over both traffics",
}
PARTS = ("headlines", "claims", "ate", "pooled")
Setting = tuple[str, int]  # task and level


@dataclass(frozen=True)
class Side:
    """What is shown of one directory: its name, and the records of one simulator in it."""

    name: str
    parts: Mapping[str, Sequence[Record]]


def beside(named: Sequence[tuple[str, Mapping[str, Any]]]) -> list[dict[str, Any]]:
    """What the report shows of other directories, a section for each simulator of its own.

    Args:
        named: what each directory is called, and its analysis; the report's own comes first.

    Returns:
        Sections with id, name (of the simulator), names (of the sides), others (name, answer and power of each other
        side, in words), tables (question, and rows: place and the effect on each side, in words), claims (claim and the
        verdict of each side), figure (SVG). The rows are the settings of this report that another one has too, and
        their mean, every task weighted alike.
    """
    (own_name, own), *others = named
    sections = []
    for backend in dict.fromkeys(r["backend"] for r in own["headlines"]):
        sides = [_side(own_name, own, backend), *(_side(name, other, backend) for name, other in others)]
        tables, drawn = [], []
        for (outcome, term), question in QUESTIONS.items():
            columns = _columns(
                [_effects(side.parts, outcome, term) for side in sides], OUTCOMES[outcome].poolable
            )
            tables.append({"question": question, "rows": _rows(columns, outcome)})
            drawn.append(columns)
        if not tables[0]["rows"]:
            continue
        names = [side.name for side in sides]
        sections.append(
            {
                "id": backend,
                "name": BACKENDS.get(backend, backend),
                "names": names,
                "others": [
                    {
                        "name": side.name,
                        "answer": side.parts["headlines"][0]["text"][0],
                        "power": power(side.parts),
                    }
                    for side in sides[1:]
                ],
                "tables": tables,
                "claims": _claims(sides),
                "figure": Markup(side_by_side(drawn[0], names, f"{backend}-beside")),
            }
        )
    return sections


def _side(name: str, analysis: Mapping[str, Any], backend: str) -> Side:
    """The part of an analysis on this simulator or, where it is not there, on the first that is."""
    known = [r["backend"] for r in analysis["headlines"]]
    match = backend if backend in known else known[0]
    parts = {part: [r for r in analysis[part] if r["backend"] == match] for part in PARTS}
    simulator = BACKENDS.get(match, match)
    return Side(name if match == backend or simulator in name else f"{name} ({simulator})", parts)


def _effects(parts: Mapping[str, Sequence[Record]], outcome: str, term: str) -> dict[Setting, Record]:
    """The effects that are known, by setting."""
    return {
        (r["task"], r["level"]): r
        for r in parts["ate"]
        if (r["outcome"], r["term"]) == (outcome, term) and r["status"] != MISSING
    }


def _columns(
    effects: Sequence[Mapping[Setting, Record]], poolable: bool
) -> list[dict[Setting | None, Record]]:
    """For each side the effects in the shared settings and, under None, their mean where it has all of them."""
    own, *others = effects
    shared = sorted((s for s in own if any(s in other for other in others)), key=_order)
    columns: list[dict[Setting | None, Record]] = []
    for side in effects:
        column: dict[Setting | None, Record] = {s: side[s] for s in shared if s in side}
        if poolable and len(shared) > 1 and len(column) == len(shared):
            records = list(column.values())
            weights = task_weights({tuple(r[c] for c in PLACE): {} for r in records})
            mean = statistics.interval(statistics.combine([_mean(r) for r in records], weights))
            column[None] = {**as_record(mean), "task": ALL_TASKS}
        columns.append(column)
    return columns


def _order(setting: Setting) -> tuple[int, int]:
    return TASK_ORDER[setting[0]], setting[1]


def _mean(record: Record) -> Mean:
    n = tuple(record["seeds"])
    parts = ((record["se"] ** 2, record["df"]),) if record["status"] == OK else ()
    return Mean(record["estimate"], parts, n, min(n))


def _rows(columns: Sequence[Mapping[Setting | None, Record]], outcome: str) -> list[Record]:
    rows = []
    for key in dict.fromkeys(key for column in columns for key in column):
        found = [column.get(key) for column in columns]
        words = [NONE if r is None else difference(r, outcome) for r in found]
        rows.append({"place": place(next(filter(None, found))), "effects": words})
    return rows


def _claims(sides: Sequence[Side]) -> list[Record]:
    verdicts = [{claim["claim"]: claim["verdict"] for claim in side.parts["claims"]} for side in sides]
    return [
        {"claim": claim, "verdicts": [known.get(claim, NONE) for known in verdicts]} for claim in verdicts[0]
    ]


def power(part: Mapping[str, Sequence[Record]]) -> str:
    """What the seeds of a directory can and cannot tell, in words.

    Args:
        part: ate and pooled of one simulator.
    """
    settings = list(_effects(part, "crashed", "risky").values())
    seeds = sorted({min(r["seeds"]) for r in settings})
    if not seeds or seeds[-1] < 2:
        return "One training seed in an arm cannot tell anything about training."
    found = f"{seeds[0]}" + (f" to {seeds[-1]}" if seeds[-1] > seeds[0] else "")
    text = f"{found} training seeds in each arm, {count(len(settings), 'setting')}."
    means, single = (
        sorted(statistics.detectable(r["se"], r["df"], ALPHA, POWER) for r in rows if r["status"] == OK)
        for rows in ([r for r in part["pooled"] if r["primary"]], settings)
    )
    if means and means[0] >= 1.0:
        text += " They do not find even the largest difference that crash rates can have."
    elif means:
        least, middle = (
            number(size, "crashed").removesuffix(" %")
            for size in (means[0], (single or means)[len(single) // 2])
        )
        text += (
            f" They find a mean difference in crash rate of {least} points or more in {100 * POWER:.0f} % of "
            f"repetitions, and one of {middle} points in a single setting. A smaller effect they can neither show nor "
            "exclude."
        )
    return text
