"""The report's tables: frames of text, made of the frames of the analysis, that one macro of the templates prints.

Numbers stand in them as people read them: digits, units, signs, points instead of shares.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.analysis import estimate
from experiments.analysis.analysis import Analysis
from experiments.analysis.by_task import OWN, SURROGATES
from experiments.analysis.competence import WORDS
from experiments.analysis.effects import ALL_TASKS, means
from experiments.analysis.gates import FAILURES
from experiments.analysis.plan import OUTCOMES, Outcome
from experiments.analysis.scores import in_order
from experiments.study.design.arms import ARMS
from experiments.study.design.levels import tasks_known
from experiments.study.design.traffic import TRAFFICS, UNSEEN

MINUS = "\N{MINUS SIGN}"
NONE = "\N{EN DASH}"  # where there is no number
BACKENDS = {"sumo": "SUMO", "replica": "highway-env's physics (replica)", "highway-env": "highway-env"}
TERMS = {"sum": "both (the paper's ATE)", "interaction": "risky − regular"}
ARM_NAMES = {"treatment": "treated"}  # as the pages call the agents of an arm
KINDS = OUTCOMES | OWN | SURROGATES


def plain(value: float | None, digits: int, signed: bool = False) -> str:
    """A number with a true minus ("-3.0"), or a dash where there is none; what rounds to 0 has no sign."""
    if value is None or not np.isfinite(value):
        return NONE
    value = float(f"{value:.12g}")  # as it is stored, so that a half is rounded alike
    text = f"{value:{'+' if signed else ''}.{digits}f}"
    if float(text) == 0:
        text = text.lstrip("+-")
    return text.replace("-", MINUS)


def kind_of(outcome: str | Outcome) -> Outcome:
    """An outcome of the report by its name, or one of the user's own."""
    return outcome if isinstance(outcome, Outcome) else KINDS[outcome]


def titled(outcome: Outcome) -> str:
    """What a column of an outcome is called: "crashes [%]"."""
    return " ".join(filter(None, [outcome.label, outcome.unit]))


def number(value: float | None, outcome: str | Outcome) -> str:
    """A mean of an outcome with the digits it deserves; shares in per cent ("12.5 %")."""
    text = points(value, outcome, signed=False)
    return text + (" %" if kind_of(outcome).percent and text != NONE else "")


def points(value: float | None, outcome: str | Outcome, signed: bool = True) -> str:
    """A difference with its sign; of shares in points ("-15.7")."""
    kind = kind_of(outcome)
    return plain(None if value is None else value * (100 if kind.percent else 1), kind.digits, signed)


def interval(row: Mapping[str, Any], outcome: str | Outcome) -> str:
    """The interval of a row, "[-7.0, +0.8]", or an empty text."""
    low, high = row["low"], row["high"]
    return "" if low is None or np.isnan(low) else f"[{points(low, outcome)}, {points(high, outcome)}]"


def effect(row: Mapping[str, Any], outcome: str | Outcome = "crashed") -> str:
    """An estimated difference and its interval, "-3.1 [-7.0, +0.8]"."""
    status = {"one seed": "(no interval)", "no information": "(everybody crashes)"}.get(row["status"], "")
    return " ".join(filter(None, [points(row["estimate"], outcome), interval(row, outcome) or status]))


def difference(row: Mapping[str, Any]) -> str:
    """The same of the crash rate with its unit, for a sentence: "-3.1 points [-7.0, +0.8]"."""
    return " ".join(filter(None, [points(row["estimate"], "crashed"), "points", interval(row, "crashed")]))


def pair(row: Mapping[str, Any], outcome: str | Outcome) -> str:
    """A mean effect's "12.5 % → 10.0 %", from who is compared with to the arm."""
    return " → ".join(number(row[side], outcome) for side in ("mean_against", "mean_arm"))


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


def main(frame: pd.DataFrame, backend: str) -> pd.DataFrame:
    """The rows of the plan's comparison."""
    return chosen(frame, backend=backend, arm="treatment", against="control")


def wide(
    rows: pd.DataFrame, names: Sequence[str], cells: Callable[[dict[Any, Any]], Mapping[str, str]]
) -> pd.DataFrame:
    """A table with a line for each value of some columns, in which every row fills cells of its own."""
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows.to_dict("records"):
        key = {name: str(row[name]) for name in names}
        lines.setdefault(tuple(key.values()), key).update(cells(row))
    return pd.DataFrame(list(lines.values()))


def with_setting(frame: pd.DataFrame) -> pd.DataFrame:
    """The rows with their task and traffic level as "setting"."""
    return frame.assign(setting=frame["task"].astype(str) + " " + frame["level_name"].astype(str))


def rates(row: Mapping[str, Any]) -> dict[str, str]:
    """A mean effect as cells: `pair`, and the difference in the crash rate."""
    both = pair(row, row["outcome"])
    if row["outcome"] != "crashed":
        return {f"m/s in {row['term']} traffic": both}
    second = " " * (row["term"] == "regular")  # two columns of one name
    return {f"crashes in {row['term']} traffic": both, f"difference{second}": effect(row)}


def careful(analysis: Analysis, backend: str) -> pd.DataFrame:
    """The careful driver of fixed rules against the agents of both arms, in both traffics."""
    rows = chosen(analysis.means, backend=backend, arm=ARMS, against="careful", scope=ALL_TASKS)
    rows = chosen(rows, outcome=("crashed", "mean_speed"), term=TRAFFICS)
    return wide(rows.assign(agents=rows["arm"].replace(ARM_NAMES)), ["agents"], rates)


def by_setting(analysis: Analysis, backend: str, outcome: str) -> pd.DataFrame:
    """Effects of every setting with their 95 % intervals, and the p-values of what the plan tests.

    Beside effects on the return stand the scores of both arms.
    """

    def cells(row: Mapping[str, Any]) -> dict[str, str]:
        title = TERMS.get(row["term"], row["term"])
        if row["outcome"] == "score":
            return {f"score, {title}": pair(row, "score")} if row["term"] in TRAFFICS else {}
        tested = {f"{title}, p (Holm)": p_value(row["p_adjusted"])} if row["family"] else {}
        agents = f"{row['seeds_arm']}, {row['seeds_against']}"
        return {title: effect(row, outcome), **tested, "agents": agents}

    shown = [outcome, *(["score"] if outcome == "return" else [])]
    return wide(with_setting(chosen(main(analysis.effects, backend), outcome=shown)), ["setting"], cells)


def own(analysis: Analysis, backend: str, outcomes: Mapping[str, Outcome]) -> pd.DataFrame:
    """Outcomes of the user's own, from control to treated agents: by task, and over all tasks if they are poolable."""
    rows = chosen(main(analysis.means, backend), outcome=list(outcomes), term=list(TRAFFICS))
    rows = chosen(rows, scope=[ALL_TASKS, *tasks_known()])

    def cells(row: Mapping[str, Any]) -> dict[str, str]:
        kind = outcomes[row["outcome"]]
        return {f"{row['term']} traffic": pair(row, kind), f"difference, {row['term']}": effect(row, kind)}

    titles = {name: titled(one) for name, one in outcomes.items()}
    return (
        wide(rows, ["outcome", "scope"], cells).replace({"outcome": titles}).rename(columns={"scope": "task"})
    )


def further(analysis: Analysis, backend: str) -> pd.DataFrame:
    """Further arms, mean over the settings that have them."""
    rows = chosen(analysis.means, backend=backend, outcome="crashed")
    rows = rows[~rows["arm"].isin(list(ARMS)) & (rows["scope"] == ALL_TASKS)]
    return wide(rows, ("arm", "against", "settings"), rates)


def unseen(analysis: Analysis, backend: str) -> pd.DataFrame:
    """Crash rates of each arm's agents in risky traffic that nobody was trained in, and in that of the training."""
    rows = chosen(analysis.policies, backend=backend, traffic=["risky", *UNSEEN])
    rows = rows[(rows["arm"] != "") & rows["task"].isin(rows.loc[rows["traffic"] != "risky", "task"])]

    def cells(row: Mapping[str, Any]) -> dict[str, str]:
        error = number(row["crashed se"], "crashed").replace(" %", "")
        speed = plain(row["crash_closing_speed"], 1)
        return {row["arm"]: f"{number(row['crashed'], 'crashed')} ± {error}, {speed} m/s"}

    return wide(with_setting(rows), ("setting", "traffic"), cells)


def gates(analysis: Analysis, backend: str) -> pd.DataFrame:
    """How many agents of each setting and arm pass the gates, and what the others fail."""
    lines = []
    rows = with_setting(chosen(analysis.gates, backend=backend))
    for (setting, arm), own in rows.groupby(["setting", "arm"], sort=False):
        failed = [gate for names in own["failed"] for gate in names.split()]
        words = ", ".join(f"{failed.count(gate)} {FAILURES[gate]}" for gate in dict.fromkeys(failed))
        passed = f"{int((own['passed'].astype(object) != False).sum())} of {len(own)}"  # noqa: E712
        lines.append({"setting": setting, "arm": arm, "text": f"{passed} ({words})" if words else passed})
    return wide(pd.DataFrame(lines), ["setting"], lambda row: {row["arm"]: row["text"]})


def side_by_side(analyses: Mapping[str, Analysis], differences: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Effects on the crash rate in several folders, by name, over the settings that all of them have.

    By task also how those of another folder differ from the first one's: `differences`, from `effects.between`.
    """
    frames = [
        chosen(
            main(one.effects, one.effects["backend"].iloc[0]), outcome="crashed", term=list(TRAFFICS)
        ).assign(backend=name)
        for name, one in analyses.items()
        if len(one.effects)
    ]
    if len(frames) < 2:
        return pd.DataFrame()
    rows = pd.concat(frames, ignore_index=True)
    rows = rows[rows.groupby(["task", "level"])["backend"].transform("nunique") == len(frames)]
    found = chosen(means(rows), scope=ALL_TASKS).rename(columns={"scope": "task"})
    first, *others = rows["backend"].unique()
    weights = estimate.equal_task_weights(rows, ["backend", "task", "term"])
    of_tasks = [estimate.combine(rows, ["backend", "task", "term"], weights)]
    for other in others:
        both = differences[other].merge(rows[["task", "level"]].drop_duplicates())
        if both.empty:
            continue
        apart = estimate.combine(both, ["task", "term"], estimate.equal_task_weights(both, ["task", "term"]))
        of_tasks.append(apart.assign(backend=f"{other} {MINUS} {first}"))
    each = in_order(pd.concat(of_tasks), "task", "term")
    return wide(
        pd.concat([found.sort_values("term", kind="stable"), each]).rename(columns={"backend": "folder"}),
        ["task", "folder", "settings"],
        lambda row: {f"{row['term']} traffic": difference(row)},
    )


LEARNER = {
    "change": "return, change over the last quarter",
    "diverged": "agents whose values diverge",
    "gates": "share that passes all gates",
    "last second": "crash rate, last second over those before",
}
PASSED = {True: "as asked", False: "not as asked", None: "open"}


def learner(analysis: Analysis, backend: str) -> pd.DataFrame:
    """What is asked of the learner before anything is compared; empty where the plan asks nothing."""
    lines = []
    for row in chosen(analysis.learner, backend=backend).to_dict("records"):
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


def competence(analysis: Analysis, backend: str) -> pd.DataFrame:
    """How the control agents of each setting that has marks drive in regular traffic, and what they lack."""

    def cells(row: Mapping[str, Any]) -> dict[str, str]:
        best = f"{row['rule']} {number(row['rule_return'], 'return')}"
        lacks = ", ".join(WORDS[name] for name in row["failed"].split())
        return {
            "score": number(row["score"], "score"),
            "crashes": number(row["crashed"], "crashed"),
            "return": number(row["return"], "return"),
            "best rule": best + ", SUMO's driver not asked" * row["unfair"],
            "competent": lacks or "yes",
        }

    return wide(with_setting(chosen(analysis.competence, backend=backend)), ["setting"], cells)


def frontier(analysis: Analysis, backend: str) -> pd.DataFrame:
    """Crash rate of each arm's agents above that of drivers of fixed rules at the same progress."""

    def cells(row: Mapping[str, Any]) -> dict[str, str]:
        above = effect({**row, "status": ""}) if row["inside"] else NONE
        agents = f"{row['inside']} of {row['agents']}"
        return {f"{row['traffic']} traffic": above, f"agents, {row['traffic']}": agents}

    return wide(with_setting(chosen(analysis.frontier, backend=backend)), ("setting", "arm"), cells)


TABLES: dict[str, Callable[[Analysis, str], pd.DataFrame]] = {  # of one simulator, by the templates' names
    "careful": careful,
    "crashes": partial(by_setting, outcome="crashed"),
    "returns": partial(by_setting, outcome="return"),
    "further": further,
    "unseen": unseen,
    "gates": gates,
    "learner": learner,
    "frontier": frontier,
    "competence": competence,
}
FILTERS = {f.__name__: f for f in (number, points, difference, listing, count)}
