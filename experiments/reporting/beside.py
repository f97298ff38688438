"""Two result directories side by side: what each answers, in one picture, and what the seeds of each can tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from experiments.analysis import statistics
from experiments.analysis.effects import Record
from experiments.analysis.plan import ALPHA, POWER
from experiments.analysis.statistics import OK
from experiments.analysis.wording import BACKENDS, NONE, count, difference, number, place
from experiments.reporting.figures import side_by_side

OUTCOME, TERM = "crashed", "risky"
PARTS = ("headlines", "claims", "ate", "pooled")


def beside(
    own: Mapping[str, Any], other: Mapping[str, Any], own_name: str, other_name: str
) -> list[dict[str, Any]]:
    """What the report shows of another directory, a section for each simulator of this one.

    Args:
        own, other: from `analysis.analyse`. own_name, other_name: how the two are called.

    Returns:
        Sections with id, name (of the simulator), names, answers (the first sentence of each), power (what the seeds of
        each can tell, in words), rows (place and the effect in each, in words), claims (claim and the verdicts of
        both), figure (SVG).
    """
    sections = []
    for backend in dict.fromkeys(r["backend"] for r in own["headlines"]):
        known = [r["backend"] for r in other["headlines"]]
        match = backend if backend in known else known[0]
        mine, theirs = _part(own, backend), _part(other, match)
        names = [own_name, other_name]
        if match != backend:
            names = [f"{n} ({BACKENDS.get(b, b)})" for n, b in zip(names, (backend, match), strict=True)]
        effects = [_effects(mine["ate"]), _effects(theirs["ate"])]
        sections.append(
            {
                "id": backend,
                "name": BACKENDS.get(backend, backend),
                "names": names,
                "answers": [part["headlines"][0]["text"][0] for part in (mine, theirs)],
                "power": [power(part, name) for name, part in zip(names, (mine, theirs), strict=True)],
                "rows": _rows(effects),
                "claims": _claims(mine["claims"], theirs["claims"]),
                "figure": Markup(
                    side_by_side(
                        [
                            [*found.values(), *_mean(part)]
                            for found, part in zip(effects, (mine, theirs), strict=True)
                        ],
                        names,
                        f"{backend}-beside",
                    )
                ),
            }
        )
    return sections


def _part(analysis: Mapping[str, Any], backend: str) -> dict[str, list[Record]]:
    return {part: [r for r in analysis[part] if r["backend"] == backend] for part in PARTS}


def _effects(ate: Sequence[Record]) -> dict[tuple[str, int], Record]:
    """Effects on the crash rate in risky traffic by task and level."""
    return {(r["task"], r["level"]): r for r in ate if (r["outcome"], r["term"]) == (OUTCOME, TERM)}


def _mean(part: Mapping[str, Sequence[Record]]) -> list[Record]:
    """The primary answer, as a row of the picture."""
    return [r for r in part["pooled"] if r["primary"]]


def _rows(effects: Sequence[Mapping[tuple[str, int], Record]]) -> list[Record]:
    rows = []
    for key in effects[0]:
        found = [by_place.get(key) for by_place in effects]
        words = [NONE if r is None else difference(r, OUTCOME) for r in found]
        rows.append({"place": place(effects[0][key]), "effects": words})
    return rows


def _claims(mine: Sequence[Record], theirs: Sequence[Record]) -> list[Record]:
    verdicts = {claim["claim"]: claim["verdict"] for claim in theirs}
    return [{**claim, "verdicts": [claim["verdict"], verdicts.get(claim["claim"], NONE)]} for claim in mine]


def power(part: Mapping[str, Sequence[Record]], name: str = "") -> str:
    """What the seeds of a directory can and cannot tell, in sentences that begin with its name.

    Args:
        part: ate and pooled of one simulator.
    """
    name = f"{name}: " if name else ""
    settings = [r for r in part["ate"] if (r["outcome"], r["term"]) == (OUTCOME, TERM)]
    seeds = sorted({min(r["seeds"]) for r in settings})
    if not seeds or seeds[-1] < 2:
        return f"{name}One training seed in an arm cannot tell anything about training."
    found = f"{name}{seeds[0]}" + (f" to {seeds[-1]}" if seeds[-1] > seeds[0] else "")
    text = f"{found} training seeds in each arm, {count(len(settings), 'setting')}."
    means, single = (
        sorted(statistics.detectable(r["se"], r["df"], ALPHA, POWER) for r in rows if r["status"] == OK)
        for rows in (_mean(part), settings)
    )
    if means and means[0] >= 1.0:
        text += " They do not find even the largest difference that crash rates can have."
    elif means:
        least, middle = (
            number(size, OUTCOME).removesuffix(" %")
            for size in (means[0], (single or means)[len(single) // 2])
        )
        text += (
            f" They find a mean difference in crash rate of {least} points or more in {100 * POWER:.0f} % of "
            f"repetitions, and one of {middle} points in a single setting. A smaller effect they can neither show nor "
            "exclude."
        )
    return text
