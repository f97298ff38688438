"""What the report's template shows, put into rows and words: from an analysis, with no number of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from experiments.analysis.effects import Record
from experiments.analysis.gates import FAILURES, GATES
from experiments.analysis.plan import ALPHA, OUTCOMES, TERMS
from experiments.analysis.pooling import ALL_TASKS
from experiments.analysis.statistics import MISSING
from experiments.analysis.tables import CONFIRMATORY, TASK_ORDER, split
from experiments.analysis.wording import BACKENDS, count, listing, place
from experiments.reporting.arm_figures import further_arms
from experiments.reporting.beside import power
from experiments.reporting.card import card
from experiments.reporting.report_figures import backend_figures
from experiments.reporting.showcase import KINDS
from experiments.study.arms import ARMS
from experiments.study.estimate import duration
from experiments.study.grid import MARKS
from experiments.study.results import Results
from experiments.study.store import read_sweeps
from experiments.study.verdict import of_results
from experiments.support.files import canonical_json

# Parts of an analysis that are lists of records of one simulator each.
PARTS = (
    "headlines", "claims", "ate", "pooled", "slopes", "placebo", "gates", "policies", "failures", "sensitivity",
    "second_batch",
)  # fmt: skip
NOT_VALIDATED = "not validated"
HOW_TO_VALIDATE = (
    "How close these SUMO tasks are to highway-env was not measured; "
    "python experiments/validate.py --out DIR, with this directory, does it."
)


def page(results: Results, analysis: Mapping[str, Any], films: Mapping[str, Any]) -> dict[str, Any]:
    """The template's variables.

    Args:
        results: all stored cells. analysis: from `analysis.analyse` of them. films: from `showcase.showcase`.
    """
    backends = list(dict.fromkeys(record["backend"] for record in analysis["policies"]))
    left_out = {entry["cell"] for entry in analysis["left_out"]}
    _, further = split(results)
    more = {name: cell for name, cell in further.cells.items() if name not in left_out}
    left_out |= set(further.cells)
    return {
        "analysis": analysis,
        "smoke": "smoke" in analysis["provenance"]["presets"],
        "warnings": warnings(analysis),
        "run": run(analysis, results, left_out),
        "showcase": player(films, results.directory),
        "card": card(analysis, {k: v for k, v in results.cells.items() if k not in left_out}),
        "validation": validation(results.directory, backends),
        "backends": [backend_section(backend, results, analysis, left_out) for backend in backends],
        "more": further_rows(more),
        "marks": MARKS,
        "gate_texts": GATES,
        "terms": TERMS,
        "outcomes": OUTCOMES,
    }


def warnings(analysis: Mapping[str, Any]) -> list[str]:
    """What keeps these results from being complete, a sentence each."""
    words = []
    if missing := analysis["missing"]:
        words.append(
            f"{count(len(missing), 'cell')} that a sweep has asked for {'is' if len(missing) == 1 else 'are'} missing: "
            "run the command again to go on."
        )
    if failed := analysis["failed"]:
        words.append(
            f"{count(len(failed), 'cell')} failed: " + listing([f"{k} ({v})" for k, v in failed.items()], 3)
        )
    if damaged := analysis["damaged"]:
        words.append(
            f"{count(len(damaged), 'cell')} cannot be read and {'is' if len(damaged) == 1 else 'are'} not counted: "
            + listing(list(damaged.values()), 3)
        )
    if incomplete := analysis["incomplete"]:
        named = [f"{entry['cell']} ({entry['reason']})" for entry in incomplete]
        words.append(
            f"{count(len(incomplete), 'cell')} with incomplete tables not counted: {listing(named, 3)}"
        )
    for names in analysis["duplicates"]:
        words.append(f"The same agent is stored under {count(len(names), 'name')}: {listing(names, 3)}.")
    if left_out := analysis["left_out"]:
        first = left_out[0]
        words.append(
            f"{count(len(left_out), 'cell')} of other settings in this directory were left out and never mixed in; "
            f"for example {first['cell']}: {first['reason']}."
        )
    policies = analysis["policies"]
    if not any(record["arm"] for record in policies):
        words.append("No trained agents: nothing can be said about training.")
    for arm in ARMS:
        if any(record["arm"] for record in policies) and not any(record["arm"] == arm for record in policies):
            words.append(f"No {arm} agents: there is nothing to compare the others with.")
    if not any(record["arm"] is None for record in policies):
        words.append("No baselines: whether the agents beat constant policies was not checked.")
    counts = [min(r["seeds"]) for r in analysis["ate"] if r["status"] != MISSING]
    if counts and min(counts) == 1:
        words.append(
            "Only one training seed in an arm: differences are shown without intervals and prove nothing."
        )
    return words


def player(films: Mapping[str, Any], directory: Path) -> dict[str, Any]:
    """What the player shows: groups of films by task and level, their data as JSON, and why some are missing."""
    groups: list[Record] = []
    number = 0
    titles = {kind: title for kind, title, _ in KINDS.values()}
    for entry in films["places"]:
        if not entry["films"]:
            continue
        name = " on ".join([place(entry), BACKENDS.get(entry["backend"], entry["backend"])])
        group = {
            "name": name,
            "seed": entry["seed"],
            "cells": entry["cells"],
            "counts": entry["counts"],
            "films": [],
        }
        for film in entry["films"]:
            traffic, scenario = film["traffic"], film["scenario"]
            arm = film["kind"] if film["kind"] in ARMS else "control"
            case = directory / "cells" / entry["cells"][arm]
            group["films"].append(
                {
                    "traffic": traffic,
                    "scenario": scenario,
                    "number": number,
                    "title": f"{place(entry)}: {titles[film['kind']].lower()} ({traffic} scenario {scenario})",
                    "endings": {arm: film[arm]["ending"] for arm in ARMS},
                    "case": f"{case}:{traffic}:{scenario}",
                }
            )
            number += 1
        groups.append(group)
    shown = [
        {key: value for key, value in entry.items() if key not in ("made_of", "counts", "failed", "cells")}
        for entry in films["places"]
        if entry["films"]
    ]
    # A "<" could end the script element in which the data stand.
    data = canonical_json(shown).replace("<", "\\u003c")
    return {
        "films": number,
        "groups": groups,
        "rule": films["rule"],
        "notes": films["notes"],
        "data": Markup(data),
    }


def run(analysis: Mapping[str, Any], results: Results, left_out: set[str]) -> dict[str, Any]:
    """What was run, for people."""
    origin = analysis["provenance"]
    shown = [name for name in results.cells if name not in left_out]
    keys = [results.cells[name]["key"] for name in shown]
    agents = [key for key in keys if key["kind"] == "agent"]
    settings: dict[str, dict[str, list[str]]] = {}
    for key in agents:
        for name, value in key["profile"].items():
            values = settings.setdefault(name, {}).setdefault(str(value), [])
            if key["task"] not in values:
                values.append(key["task"])
    return {
        "presets": origin["presets"],
        "commands": [sweep["command"] for sweep in read_sweeps(results.directory)],
        "directory": str(results.directory),
        "agents": len(agents),
        "weights": sum(results.weights(name) is not None for name in shown),
        "baselines": len(keys) - len(agents),
        "tests": sorted({key["eval"]["episodes"] for key in keys}),
        "seconds": duration(origin["seconds"]),
        "finished": origin["finished"],
        "versions": origin["versions"],
        "hash": origin["hash"],
        # One value for all tasks, or each value with its tasks.
        "settings": {
            name: next(iter(values))
            if len(values) == 1
            else "; ".join(f"{v} ({', '.join(t)})" for v, t in values.items())
            for name, values in sorted(settings.items())
            if name != "preset"
        },
    }


def validation(directory: Path, backends: Sequence[str]) -> Record:
    """What was known before training of how close SUMO's tasks are to highway-env's.

    Returns:
        relevant (whether SUMO was used at all), source (what the verdict comes from), note (a sentence, None if there
        is a verdict on every task), tasks (task, verdict and reason each).
    """
    found = of_results(directory)
    tasks = {} if found is None else found["tasks"]
    rows = [{"task": task, **_verdict(tasks.get(task))} for task in TASK_ORDER]
    open_ = [row["task"] for row in rows if row["verdict"] == NOT_VALIDATED]
    return {
        "relevant": "sumo" in backends,
        "source": "" if found is None else found["source"],
        "note": f"Not validated: {listing(open_)}. {HOW_TO_VALIDATE}" if open_ else None,
        "tasks": rows,
    }


def _verdict(found: Mapping[str, Any] | None) -> dict[str, str]:
    """Verdict on a task, and in words how many checks there were and which margins were missed."""
    if found is None or found["passed"] is None:
        return {"verdict": NOT_VALIDATED, "reason": ""}
    checks, missed = sum(found["counts"].values()), len(found["missed"])
    names = [" ".join(filter(None, (item["name"], item["ego"]))) for item in found["missed"]]
    reason = f"{checks - missed} of {count(checks, 'check')} within their margins"
    reason += f"; not: {listing(list(dict.fromkeys(names)), 6)}" if names else ""
    return {"verdict": "passed" if found["passed"] else "failed", "reason": reason}


def backend_section(
    backend: str, results: Results, analysis: Mapping[str, Any], left_out: set[str]
) -> dict[str, Any]:
    """Everything that is shown for one simulator."""
    own = {part: [record for record in analysis[part] if record["backend"] == backend] for part in PARTS}
    cells = {
        name: cell
        for name, cell in results.cells.items()
        if name not in left_out and cell["key"]["backend"] == backend
    }
    exploratory = {
        part: [record for record in records if record["backend"] == backend]
        for part, records in analysis["exploratory"].items()
    }
    return {
        "id": backend,
        "name": BACKENDS.get(backend, backend),
        "headline": own["headlines"][0],
        "power": power(own) if own["ate"] else "",
        "claims": own["claims"],
        "effects": {outcome: effect_rows(own["ate"], outcome) for outcome in OUTCOMES},
        "confirmatory": CONFIRMATORY,
        "tested": {r["outcome"] for r in own["ate"] if r["family"]} | set(CONFIRMATORY),
        "pooled": {outcome: pooled_rows(own["pooled"], outcome) for outcome in CONFIRMATORY},
        "slopes": [r for r in own["slopes"] if r["quantity"] == "effect"],
        "trends": [r for r in own["slopes"] if r["quantity"] == "mean"],
        "placebo": own["placebo"],
        "failures": own["failures"],
        "sensitivity": own["sensitivity"],
        "second_batch": own["second_batch"],
        "heterogeneity": [r for r in own["pooled"] if r["outcome"] == "crashed" and r["term"] == "risky"],
        "overall": ALL_TASKS,
        "gates": gate_rows(own["gates"]),
        "agents": own["gates"],
        "policies": policy_rows(own["policies"]),
        "exploratory": exploratory,
        "arms": Markup(further_arms(own["ate"], exploratory["arms"])) if exploratory["arms"] else None,
        "figures": backend_figures(results, own, cells),
        "cells": cell_rows(cells, own["gates"]),
    }


def effect_rows(ate: Sequence[Record], outcome: str) -> list[Record]:
    """One row a task and level: the records of its terms, and what to say of them."""
    rows: dict[str, Record] = {}
    for record in ate:
        if record["outcome"] == outcome:
            row = rows.setdefault(
                place(record), {"place": place(record), "terms": {}, "anchor": anchor(record)}
            )
            row["terms"][record["term"]] = record
    for row in rows.values():
        total = row["terms"]["sum"]
        tested = next((r for r in row["terms"].values() if r["family"]), None)
        # The terms of a row share most of their reasons; each is said once, those of the sum first.
        texts = [text for r in (total, *row["terms"].values()) for text in (r["gates"], r["reason"]) if text]
        reasons = dict.fromkeys(part for text in texts for part in text.split("; "))
        row |= {
            "status": total["status"],
            "seeds": total["seeds"],
            "reasons": list(reasons),
            "muted": total["status"] == MISSING,
            "tested": tested,
            "cells": total["cells"],
        }
        regular = row["terms"]["regular"]
        p = regular.get("equivalence_p_adjusted")
        row["equivalent"] = p is not None and p < ALPHA
    return list(rows.values())


def pooled_rows(pooled: Sequence[Record], outcome: str) -> list[Record]:
    """One row a scope, without those that average a single comparison."""
    rows: dict[str, Record] = {}
    for record in pooled:
        if record["outcome"] == outcome:
            row = rows.setdefault(record["scope"], {"scope": record["scope"], "terms": {}})
            row["terms"][record["term"]] = record
    for row in rows.values():
        total = row["terms"]["sum"]
        row |= {"comparisons": total["comparisons"], "cells": total["cells"], "anchor": anchor(total)}
    return [row for row in rows.values() if row["comparisons"][1] > 1]


def gate_rows(verdicts: Sequence[Record]) -> list[Record]:
    """One row a task and level: how many agents of each arm pass, and what the others fail."""
    rows: dict[str, Record] = {}
    for verdict in verdicts:
        row = rows.setdefault(
            place(verdict), {"place": place(verdict), "anchor": anchor(verdict), "arms": {}}
        )
        arm = row["arms"].setdefault(verdict["arm"], {"agents": 0, "passed": 0, "unchecked": 0, "failed": {}})
        arm["agents"] += 1
        arm["passed"] += verdict["passed"] is True
        arm["unchecked"] += verdict["passed"] is None
        for gate in verdict["failed"]:
            arm["failed"][FAILURES[gate]] = arm["failed"].get(FAILURES[gate], 0) + 1
    return list(rows.values())


def policy_rows(policies: Sequence[Record]) -> list[Record]:
    """One entry a task with one row a level and policy."""
    tasks: dict[str, Record] = {}
    for record in policies:
        rows = tasks.setdefault(record["task"], {"task": record["task"], "rows": {}})["rows"]
        key = (record["level"], record["policy"], record["arm"])
        row = rows.setdefault(
            key, {"level": record["level_name"], "policy": record["policy"], "arm": record["arm"]}
        )
        row |= {"n": record["n"], "unit": record["unit"], "anchor": anchor(record), "cells": record["cells"]}
        row[record["traffic"]] = record
    return [{**entry, "rows": list(entry["rows"].values())} for entry in tasks.values()]


def cell_rows(cells: Mapping[str, Mapping[str, Any]], verdicts: Sequence[Record]) -> list[Record]:
    """One entry a task and level with its cells, so that every number can be followed to its files."""
    passed = {verdict["cell"]: verdict["passed"] for verdict in verdicts}
    entries: dict[tuple[int, int], Record] = {}
    for name, cell in sorted(cells.items()):
        key = cell["key"]
        order = (TASK_ORDER[key["task"]], key["level"])
        entry = entries.setdefault(
            order, {"place": place(key), "anchor": anchor(key), "task": key["task"], "cells": []}
        )
        entry["cells"].append(
            {
                "name": name,
                "policy": f"{key['arm']}, seed {key['seed']}" if key["arm"] else key["policy"],
                "passed": passed.get(name),
                "is_agent": key["kind"] == "agent",
                "episodes": 2 * key["eval"]["episodes"],
                "sha256": cell["files"]["episodes.parquet"],
            }
        )
    return [entries[order] for order in sorted(entries)]


def further_rows(cells: Mapping[str, Mapping[str, Any]]) -> list[Record]:
    """The cells of further arms and tests."""
    rows = []
    for name, cell in sorted(cells.items()):
        key = cell["key"]
        test_on = key.get("test_on")
        what = f"tested on {test_on['backend']}, {', '.join(test_on['traffics'])}" if test_on else "trained"
        rows.append({"name": name, "place": place(key), "arm": key["arm"], "seed": key["seed"], "what": what})
    return rows


def anchor(record: Mapping[str, Any]) -> str:
    """Where the cells of a record are listed."""
    if "level" in record:
        return f"cells-{record['backend']}-{record['task']}-{record['level']}"
    if record.get("scope", record.get("task")) in TASK_ORDER:
        return f"cells-{record['backend']}-{record.get('scope', record.get('task'))}"
    return f"cells-{record['backend']}"
