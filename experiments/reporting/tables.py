"""The report's tables: frames of text, made of the frames of the analysis, that one macro of the templates prints.

Numbers stand in them as people read them: digits, units, signs, points instead of shares.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.analysis.analysis import Analysis
from experiments.analysis.effects import ALL_TASKS, mean_over
from experiments.analysis.gates import FAILURES
from experiments.analysis.plan import OUTCOMES, Plan
from experiments.analysis.scores import CRASH_KINDS, PLACE, TASK_ORDER
from experiments.study.arms import ARMS, TRAFFICS
from experiments.study.unseen import UNSEEN

MINUS = "\N{MINUS SIGN}"
NONE = "\N{EN DASH}"  # where there is no number
BACKENDS = {"sumo": "SUMO", "replica": "highway-env's physics (replica)", "highway-env": "highway-env"}
TERMS = {"sum": "both (the paper's ATE)", "interaction": "risky − regular"}
UNITS = {"mean_speed": " m/s", "crash_free_time": " s"}


def plain(value: float | None, digits: int, signed: bool = False) -> str:
    """A number with a true minus ("-3.0"), or a dash where there is none; what rounds to 0 has no sign."""
    if value is None or not np.isfinite(value):
        return NONE
    text = f"{value:{'+' if signed else ''}.{digits}f}"
    if float(text) == 0:
        text = text.lstrip("+-")
    return text.replace("-", MINUS)


def number(value: float | None, outcome: str) -> str:
    """A mean of an outcome with the digits it deserves; shares in per cent ("12.5 %")."""
    kind = OUTCOMES.get(outcome, OUTCOMES["crashed"])  # kinds of crashes are shares too
    text = plain(None if value is None else value * (100 if kind.percent else 1), kind.digits)
    return text + (" %" if kind.percent and text != NONE else "")


def points(value: float | None, outcome: str) -> str:
    """A difference with its sign; of shares in points ("-15.7")."""
    kind = OUTCOMES.get(outcome, OUTCOMES["crashed"])
    return plain(None if value is None else value * (100 if kind.percent else 1), kind.digits, signed=True)


def interval(row: Mapping[str, Any], outcome: str) -> str:
    """The interval of a row, "[-7.0, +0.8]", or an empty text."""
    low, high = row["low"], row["high"]
    return "" if low is None or np.isnan(low) else f"[{points(low, outcome)}, {points(high, outcome)}]"


def effect(row: Mapping[str, Any], outcome: str = "crashed") -> str:
    """An estimated difference and its interval, "-3.1 [-7.0, +0.8]"."""
    status = {"one seed": "(no interval)", "no information": "(everybody crashes)"}.get(row["status"], "")
    return " ".join(filter(None, [points(row["estimate"], outcome), interval(row, outcome) or status]))


def difference(row: Mapping[str, Any], outcome: str = "crashed") -> str:
    """The same with its unit, for a sentence: "-3.1 points [-7.0, +0.8]"."""
    kind = OUTCOMES[outcome]
    unit = " points" if kind.percent else UNITS.get(outcome, "")
    return " ".join(filter(None, [points(row["estimate"], outcome) + unit, interval(row, outcome)]))


def p_value(p: float | None) -> str:
    """A p-value with as many digits as matter."""
    if p is None or np.isnan(p):
        return NONE
    return "< .001" if p < 0.001 else f"{p:.3f}".removeprefix("0")


def listing(items: Sequence[str], most: int = 6) -> str:
    """ "a, b and c", cut after `most` items."""
    shown = [*items[:most], *([f"{len(items) - most} more"] if len(items) > most else [])]
    return " and ".join(filter(None, [", ".join(shown[:-1]), *shown[-1:]]))


def count(n: int, word: str) -> str:
    """ "1 agent", "3 agents"."""
    return f"{n} {word}{'' if n == 1 else 's'}"


def chosen(frame: pd.DataFrame, **values: Any) -> pd.DataFrame:
    """The rows with these values; a tuple or list means one of them."""
    for name, value in values.items():
        frame = frame[frame[name].isin(value) if isinstance(value, list | tuple) else frame[name] == value]
    return frame


def main(frame: pd.DataFrame, backend: str, arm: str = "treatment", against: str = "control") -> pd.DataFrame:
    """The rows of a comparison on the simulator of its training."""
    return chosen(frame, backend=backend, tested_on=backend, scenarios="own", arm=arm, against=against)


def first_page(analysis: Analysis, backend: str, arm: str = "treatment") -> pd.DataFrame:
    """The answer task by task: control -> the arm in both traffics, and the difference in the crash rate."""
    means = main(analysis.means, backend, arm)
    rows = []
    for scope in [*(task for task in TASK_ORDER if (means["scope"] == task).any()), ALL_TASKS]:
        line = {"task": "all tasks alike" if scope == ALL_TASKS else scope}
        for outcome, words in (("crashed", "crashes in {} traffic"), ("mean_speed", "m/s in {} traffic")):
            for term in ("risky", "regular"):
                found = chosen(means, scope=scope, outcome=outcome, term=term).to_dict("records")
                if not found:
                    continue
                pair = (number(found[0][side], outcome) for side in ("mean_against", "mean_arm"))
                line[words.format(term)] = " → ".join(pair)
                if outcome == "crashed":
                    line["difference" + " " * (term == "regular")] = effect(found[0], outcome)
        rows.append(line)
    return pd.DataFrame(rows) if len(rows) > 1 else pd.DataFrame()


def by_setting(analysis: Analysis, backend: str, outcome: str) -> pd.DataFrame:
    """Effects of every setting: each traffic with its 95 % interval, and what the plan tests at its family's level."""
    rows = chosen(main(analysis.effects, backend), outcome=outcome)
    lines: dict[str, dict[str, str]] = {}
    for row in rows.to_dict("records"):
        line = lines.setdefault(f"{row['task']} {row['level_name']}", {})
        title = TERMS.get(row["term"], row["term"])
        line[title] = effect(row, outcome)
        if row["family"]:
            level = effect({**row, "low": row["low_family"], "high": row["high_family"]}, outcome)
            line[f"{title}, family's level"] = level
            line[f"{title}, p (Holm)"] = p_value(row["p_adjusted"])
            if outcome == "crashed":
                line[f"{title}, detectable"] = number(row["detectable"], outcome).replace(" %", "")
        line["agents"] = f"{row['seeds_arm']}, {row['seeds_against']}"
    return _indexed(lines, "setting")


def means(frame: pd.DataFrame, columns: Sequence[str] = ("scope",)) -> pd.DataFrame:
    """Means over settings, a row for each value of some columns; crash rates of both sides and the difference."""
    lines: dict[tuple[Any, ...], dict[str, str]] = {}
    for row in frame.to_dict("records"):
        if row["outcome"] not in (*OUTCOMES, *CRASH_KINDS):
            continue
        names = {name: str(row[name]) for name in columns}
        line = lines.setdefault(tuple(names.values()), names)
        pair = (number(row[side], row["outcome"]) for side in ("mean_against", "mean_arm"))
        line[f"{row['term']} traffic"] = " → ".join(pair)
        line["difference" + " " * (row["term"] == "regular")] = effect(row, row["outcome"])
    return pd.DataFrame(list(lines.values()))


def policies(analysis: Analysis, backend: str) -> pd.DataFrame:
    """How every policy drives, in every setting and both traffics."""
    rows = chosen(analysis.policies, backend=backend, traffic=list(TRAFFICS))
    lines: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows.to_dict("records"):
        key = (f"{row['task']} {row['level_name']}", row["arm"] or row["policy"])
        line = lines.setdefault(key, {"setting": key[0], "policy": key[1]})
        for outcome, title in (("return", "return"), ("crashed", "crashes"), ("mean_speed", "m/s")):
            error = row[f"{outcome} se"]
            spread = f" ± {number(error, outcome).replace(' %', '')}" if pd.notna(error) else ""
            line[f"{title}, {row['traffic']}"] = number(row[outcome], outcome) + spread
    return pd.DataFrame(list(lines.values()))


def unseen(analysis: Analysis, backend: str) -> pd.DataFrame:
    """Crash rates of each arm's agents in risky traffic that nobody was trained in, and in that of the training."""
    rows = chosen(analysis.policies, backend=backend, traffic=["risky", *UNSEEN])
    rows = rows[rows["arm"] != ""]
    lines: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows[rows["task"].isin(rows.loc[rows["traffic"] != "risky", "task"])].to_dict("records"):
        key = (f"{row['task']} {row['level_name']}", row["traffic"])
        line = lines.setdefault(key, dict(zip(("setting", "traffic"), key, strict=True)))
        error = number(row["crashed se"], "crashed").replace(" %", "")
        line[row["arm"]] = f"{number(row['crashed'], 'crashed')} ± {error}"
    return pd.DataFrame(list(lines.values()))


def gates(analysis: Analysis, backend: str) -> pd.DataFrame:
    """How many agents of each setting and arm pass the gates, and what the others fail."""
    lines: dict[str, dict[str, str]] = {}
    rows = chosen(analysis.gates, backend=backend)
    for (task, name, arm), own in rows.groupby(["task", "level_name", "arm"], sort=False):
        failed = [gate for names in own["failed"] for gate in names.split()]
        words = ", ".join(f"{failed.count(gate)} {FAILURES[gate]}" for gate in dict.fromkeys(failed))
        passed = int((own["passed"].astype(object) != False).sum())  # noqa: E712
        lines.setdefault(f"{task} {name}", {})[str(arm)] = f"{passed} of {len(own)}" + (
            f" ({words})" if words else ""
        )
    return _indexed(lines, "setting").fillna("")


def variants(analysis: Analysis, backend: str) -> pd.DataFrame:
    """The effect on the crash rate over other settings and agents."""
    rows = chosen(main(analysis.means, backend), outcome="crashed", term=("risky", "regular"))
    return means(rows[~rows["scope"].isin(list(TASK_ORDER))])


def further(analysis: Analysis, backend: str) -> pd.DataFrame:
    """Further arms, mean over the settings that have them."""
    rows = chosen(analysis.means, backend=backend, tested_on=backend, scenarios="own", outcome="crashed")
    rows = rows[~rows["arm"].isin(list(ARMS)) & (rows["scope"] == ALL_TASKS)]
    return means(rows, ("arm", "against", "settings"))


def transfer(analysis: Analysis, backend: str) -> pd.DataFrame:
    """The same agents on the same scenarios of other simulators and at home."""
    rows = analysis.means[analysis.means["scenarios"] != "own"]
    rows = chosen(rows, backend=backend).assign(tested_on=lambda d: d["tested_on"].map(BACKENDS))
    found = means(chosen(rows, scope=ALL_TASKS), ("scenarios", "tested_on"))
    return found.drop(columns="scenarios", errors="ignore")


def crash_kinds(analysis: Analysis, backend: str) -> pd.DataFrame:
    """Effects on the share of episodes that end in each kind of crash, tasks alike."""
    rows = chosen(main(analysis.means, backend), scope=ALL_TASKS, outcome=CRASH_KINDS)
    return means(rows, ("outcome",)).rename(columns={"outcome": "kind of crash"})


def slopes(analysis: Analysis, backend: str) -> pd.DataFrame:
    """Change per traffic level, of the effect and of the outcome."""
    lines: dict[str, dict[str, str]] = {}
    for row in chosen(analysis.slopes, backend=backend).to_dict("records"):
        title = f"{OUTCOMES[row['outcome']].label}, {'effect' if row['quantity'] == 'effect' else 'mean'}"
        text = f"{effect(row, row['outcome'])}, p {p_value(row['p_adjusted'])}"
        lines.setdefault(row["task"], {})[title] = text
    return _indexed(lines, "task")


LEARNER = {
    "change": "return, change over the last quarter",
    "diverged": "agents whose values diverge",
    "gates": "share that passes all gates",
    "last second": "crash rate, last second over those before",
}
PASSED = {True: "as asked", False: "not as asked", None: "open"}


def learner(analysis: Analysis, backend: str) -> pd.DataFrame:
    """What is asked of the learner before anything is compared; empty where the plan asks nothing."""
    rows = [] if analysis.learner is None else chosen(analysis.learner, backend=backend).to_dict("records")
    lines = []
    for row in rows:
        digits = {"change": 3, "diverged": 0}.get(row["check"], 2)
        found, low, high, least, most = (
            plain(row[name], digits) for name in ("estimate", "low", "high", "least", "most")
        )
        whose = filter(None, [str(row["agents"]), row["task"], row["arm"]])
        line = {"check": LEARNER[row["check"]], "agents": " ".join(whose)}
        line["found"] = found if low == NONE else f"{found} [{low}, {high}]"
        line["asked"] = least if least == most else f"{least} to {most}"
        lines.append({**line, "outcome": PASSED[row["passed"]]})
    return pd.DataFrame(lines)


def frontier(analysis: Analysis, backend: str) -> pd.DataFrame:
    """Crash rate of each arm's agents above that of drivers of fixed rules at the same progress."""
    rows = [] if analysis.frontier is None else chosen(analysis.frontier, backend=backend).to_dict("records")
    lines: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows:
        key = (f"{row['task']} {row['level_name']}", row["arm"])
        line = lines.setdefault(key, dict(zip(("setting", "arm"), key, strict=True)))
        line[f"{row['traffic']} traffic"] = effect({**row, "status": ""}) if row["inside"] else NONE
        line[f"agents, {row['traffic']}"] = f"{row['inside']} of {row['agents']}"
    return pd.DataFrame(list(lines.values()))


def side_by_side(named: Sequence[tuple[str, Analysis]]) -> pd.DataFrame:
    """This folder beside others: effects on the crash rate over the settings that each shares with the first.

    Args:
        named: title and analysis of each folder; the first one is compared with all others.
    """
    (_, first), *others = named
    rows = []
    for title, other in others:
        sides = {"there": _crashes(other), "here": _crashes(first)}
        shared = set.intersection(*(set(_settings(frame)) for frame in sides.values()))
        if not shared:
            continue
        agents = chosen(other.gates, arm=list(ARMS))
        passed = f"{(agents['passed'].astype(object) == True).sum()} of {len(agents)}"  # noqa: E712
        line = {"folder": title, "settings": str(len(shared)), "agents that pass": passed}
        for term in ("risky", "regular"):
            for side, frame in sides.items():
                own = chosen(frame, term=term)
                common = own[[setting in shared for setting in _settings(own)]]
                line[f"{term}, {side}"] = difference(mean_over(common, Plan()))
        rows.append(line)
    return pd.DataFrame(rows)


def _crashes(analysis: Analysis) -> pd.DataFrame:
    """Effects on the crash rate in each setting, on the first simulator of an analysis."""
    backend = analysis.effects["backend"].iloc[0] if len(analysis.effects) else ""
    return chosen(main(analysis.effects, backend), outcome="crashed", term=("risky", "regular"))


def _settings(frame: pd.DataFrame) -> list[tuple[str, int]]:
    return list(zip(frame["task"], frame["level"], strict=True))


def _indexed(lines: Mapping[str, Mapping[str, str]], name: str) -> pd.DataFrame:
    frame = pd.DataFrame.from_dict(lines, orient="index")
    return frame.rename_axis(name).reset_index() if lines else frame


def cells(results: Any, analysis: Analysis) -> pd.DataFrame:
    """The cells behind the numbers, with the checksum of their episodes."""
    files = analysis.provenance["cells"]
    rows = [
        {
            "cell": name,
            "setting": " ".join(str(results.cells[name]["key"][part]) for part in PLACE if part != "level"),
            "arm or policy": results.cells[name]["key"]["arm"] or results.cells[name]["key"]["policy"],
            "SHA-256 of the episodes": str(checksums["episodes.parquet"])[:16],
        }
        for name, checksums in files.items()
    ]
    return pd.DataFrame(rows)


TABLES: dict[str, Callable[[Analysis, str], pd.DataFrame]] = {  # of one simulator, by the templates' names
    "tasks": first_page,
    "crashes": partial(by_setting, outcome="crashed"),
    "returns": partial(by_setting, outcome="return"),
    "slopes": slopes,
    "variants": variants,
    "kinds": crash_kinds,
    "further": further,
    "transfer": transfer,
    "policies": policies,
    "unseen": unseen,
    "gates": gates,
    "learner": learner,
    "frontier": frontier,
}
FILTERS = {f.__name__: f for f in (number, points, difference, p_value, listing, count)}
