"""What the report's template shows, put into rows and words: from an analysis, with no number of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.analysis.effects import UNINFORMATIVE, Record
from experiments.analysis.gates import FAILURES, GATES
from experiments.analysis.statistics import ALPHA, MISSING
from experiments.analysis.tables import CONFIRMATORY, OUTCOMES, TASK_ORDER, TERMS
from experiments.analysis.wording import BACKENDS, count, listing, place
from experiments.reporting.report_figures import backend_figures
from experiments.study.estimate import duration
from experiments.study.grid import ARMS
from experiments.study.store import Results
from experiments.validation import status

NOT_VALIDATED = "not validated"
HOW_TO_VALIDATE = (
    "How close these SUMO tasks are to highway-env was not measured; "
    "python experiments/validate.py --out DIR, with this directory, does it."
)


def page(results: Results, analysis: Mapping[str, Any]) -> dict[str, Any]:
    """The template's variables.

    Args:
        results: all stored cells. analysis: from `analysis.analyse` of them.
    """
    backends = list(dict.fromkeys(record["backend"] for record in analysis["policies"]))
    left_out = {entry["cell"] for entry in analysis["left_out"]}
    return {
        "analysis": analysis,
        "smoke": "smoke" in analysis["provenance"]["presets"],
        "warnings": warnings(analysis),
        "run": run(analysis, results, left_out),
        "validation": validation(results.directory, backends),
        "backends": [backend_section(backend, results, analysis, left_out) for backend in backends],
        "gate_texts": GATES,
        "terms": TERMS,
        "outcomes": OUTCOMES,
    }


def warnings(analysis: Mapping[str, Any]) -> list[str]:
    """What keeps these results from being complete, a sentence each."""
    words = []
    if missing := analysis["missing"]:
        words.append(
            f"{count(len(missing), 'cell')} of the last sweep {'is' if len(missing) == 1 else 'are'} not there yet; "
            "run the same command again to go on."
        )
    if failed := analysis["failed"]:
        words.append(
            f"{count(len(failed), 'cell')} failed: " + listing([f"{k} ({v})" for k, v in failed.items()], 3)
        )
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


def run(analysis: Mapping[str, Any], results: Results, left_out: set[str]) -> dict[str, Any]:
    """What was run, for people."""
    origin = analysis["provenance"]
    keys = [cell["key"] for name, cell in results.cells.items() if name not in left_out]
    agents = [key for key in keys if key["kind"] == "agent"]
    settings: dict[str, dict[str, list[str]]] = {}
    for key in agents:
        for name, value in key["profile"].items():
            values = settings.setdefault(name, {}).setdefault(str(value), [])
            if key["task"] not in values:
                values.append(key["task"])
    return {
        "presets": origin["presets"],
        "agents": len(agents),
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
    found = status.of_results(directory)
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
    own = {
        part: [record for record in analysis[part] if record["backend"] == backend]
        for part in ("headlines", "claims", "ate", "pooled", "slopes", "placebo", "gates", "policies")
    }
    cells = {
        name: cell
        for name, cell in results.cells.items()
        if name not in left_out and cell["key"]["backend"] == backend
    }
    return {
        "id": backend,
        "name": BACKENDS.get(backend, backend),
        "headline": own["headlines"][0],
        "claims": own["claims"],
        "effects": {outcome: effect_rows(own["ate"], outcome) for outcome in OUTCOMES},
        "confirmatory": CONFIRMATORY,
        "pooled": {outcome: pooled_rows(own["pooled"], outcome) for outcome in CONFIRMATORY},
        "slopes": [r for r in own["slopes"] if r["quantity"] == "effect"],
        "trends": [r for r in own["slopes"] if r["quantity"] == "mean"],
        "placebo": own["placebo"],
        "gates": gate_rows(own["gates"]),
        "agents": own["gates"],
        "policies": policy_rows(own["policies"]),
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
        # The terms of a row share most of their reasons; each is said once, those of the sum first.
        texts = [r["reason"] for r in (total, *row["terms"].values()) if r["reason"]]
        reasons = dict.fromkeys(part for text in texts for part in text.split("; "))
        row |= {
            "status": total["status"],
            "seeds": total["seeds"],
            "reasons": list(reasons),
            "muted": total["status"] in (UNINFORMATIVE, MISSING),
            "p": total["p_adjusted"],
            "cells": total["cells"],
        }
        regular = row["terms"]["regular"]
        row["equivalent"] = (regular.get("equivalence_p") or 1.0) < ALPHA
    return list(rows.values())


def pooled_rows(pooled: Sequence[Record], outcome: str) -> list[Record]:
    """One row a scope and selection, without those that average a single comparison or repeat another row."""
    rows: dict[tuple[str, str], Record] = {}
    for record in pooled:
        if record["outcome"] == outcome:
            key = (record["scope"], record["selection"])
            row = rows.setdefault(key, {"scope": key[0], "selection": key[1], "terms": {}})
            row["terms"][record["term"]] = record
    for row in rows.values():
        row["comparisons"] = row["terms"]["sum"]["comparisons"]
        row["cells"] = row["terms"]["sum"]["cells"]
        row["anchor"] = anchor(row["terms"]["sum"])
    for (scope, selection), row in rows.items():
        sound = rows[scope, "informative"]["comparisons"]
        row["muted"] = selection == "all" and row["comparisons"] != sound
    return [
        row
        for (scope, selection), row in rows.items()
        if row["comparisons"][1] > 1
        and (selection == "all" or row["comparisons"] != rows[scope, "all"]["comparisons"])
    ]


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


def anchor(record: Mapping[str, Any]) -> str:
    """Where the cells of a record are listed."""
    if "level" in record:
        return f"cells-{record['backend']}-{record['task']}-{record['level']}"
    if record.get("scope", record.get("task")) in TASK_ORDER:
        return f"cells-{record['backend']}-{record.get('scope', record.get('task'))}"
    return f"cells-{record['backend']}"
