"""Caution and skill: who gets into danger, and who gets out of it (docs/takeover.md).

The record (`study.compute.takeover.COLUMNS`) has a row a pair of drivers, leader ("a" or "b") and scenario. An episode
is in danger if it has a critical moment, or a sudden crash: one without such a moment. *Caution* is the share of these,
b leading minus a leading. *Skill* is the share of critical moments from which a driver crashes within WINDOW, b minus
a, over each leader's moments, then the mean of both leaders. Below 0, b is more careful or more skilled.

The unit is the pair, and scenarios are a sample too (`estimate.linear`). Of one pair alone the unit is the scenario:
the interval is about these two drivers, not about a way of training. Ratios of sums are linearised.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.analysis import estimate
from experiments.analysis.estimate import SATURATED, Estimate, Scores
from experiments.analysis.plan import ALPHA
from experiments.study.compute.evaluate import limits
from experiments.study.compute.takeover import OTHERS, PAIR, WINDOW

TOO_FEW = "too few"
MOMENTS, PAIRS = 50, 4  # that skill needs: moments of each leader, and pairs that they come from (of several)
EVERYWHERE = 0.95  # share of dangerous episodes of both drivers above which caution is not told apart
CAUTION, SKILL = "caution", "skill"
ADJECTIVES = {CAUTION: "careful", SKILL: "skilled"}
FAMILY = 20  # primary answers of the study: both questions in five tasks, in two traffics
PLACE = ["pair", "scenario"]


def answers(rows: pd.DataFrame) -> pd.DataFrame:
    """Both questions, and what stands beside them, for one setting, traffic and bound.

    Returns:
        A row a question: a and b (what is compared), the columns of `Estimate` for b minus a, and count (moments, or
        episodes of a). Where nothing can be claimed, status is `SATURATED` (of caution) or `TOO_FEW` (of skill), and p
        is 1.
    """
    rows = rows.assign(
        danger=rows["moment"].notna() | rows["sudden"],
        critical=rows["moment"].notna(),
        **{name: rows[f"crash_{name}"] <= WINDOW for name in PAIR},
    )
    places = pd.MultiIndex.from_product([np.unique(rows[name]) for name in PLACE], names=PLACE)
    led = [rows[rows["leader"] == name] for name in PAIR]
    found: dict[str, dict[str, Any]] = {}
    if all(map(len, led)):
        found[CAUTION] = _by_leader(led, places, "danger")
        if min(found[CAUTION][name] for name in PAIR) > EVERYWHERE:
            found[CAUTION] |= {"p": 1.0, "status": SATURATED}
        found["critical moments"] = _by_leader(led, places, "critical")
        found["sudden crashes"] = _by_leader(led, places, "sudden")
        found["dangers per km"] = _by_leader(led, places, "danger", "km")
    moments = [part[part["critical"]] for part in led if len(part)]
    found[SKILL] = _from_moments(moments, places)
    for part in moments:
        for leader in part["leader"].unique():
            found[f"{SKILL}, {leader} leads"] = _from_moments([part], places)
    if len(whole := pd.concat(moments)):
        for third, part in whole.groupby(pd.qcut(whole["speed"], 3, labels=False, duplicates="drop")):
            speeds = f"{part['speed'].min():.1f} to {part['speed'].max():.1f} m/s"
            found[f"{SKILL}, speed {third + 1}: {speeds}"] = _from_moments([part], places)
    frame = pd.DataFrame.from_dict(found, orient="index").rename_axis("question").reset_index()
    return frame.astype({**dict.fromkeys(Estimate._fields, "float64"), "status": "str"})


def each(rows: pd.DataFrame, by: list[str], of: Callable[[pd.DataFrame], pd.DataFrame]) -> pd.DataFrame:
    """An analysis of each group of rows by itself, with the columns of the groups."""
    found = {at: of(part) for at, part in rows.groupby(by, sort=False)}
    return pd.concat(found, names=by).reset_index(level=by).reset_index(drop=True)


def of_tasks(rows: pd.DataFrame) -> pd.DataFrame:
    """The answers in every task and traffic, from a record of several tasks and of one bound.

    Returns:
        As `answers`, with task and traffic, and p_holm of the two questions: p adjusted by Holm's procedure over
        FAMILY, of which those that are not there count as undecided.
    """
    found = each(rows, ["task", "traffic"], answers)
    asked = found["question"].isin([CAUTION, SKILL])
    p = found.loc[asked, "p"].fillna(1.0)
    found.loc[asked, "p_holm"] = estimate.adjusted([*p, *[1.0] * (FAMILY - len(p))])[: len(p)]
    return found


def _scores(rows: pd.DataFrame, places: pd.MultiIndex, values: pd.Series, per: pd.Series | None) -> Scores:
    """An array (pairs, scenarios) of sums, or with the mean sum(values) / sum(per)."""

    def sums(column: pd.Series) -> Scores:
        by_place = column.astype(float).groupby([rows[name] for name in PLACE]).sum()
        return by_place.reindex(places, fill_value=0.0).to_numpy().reshape(len(places.levels[0]), -1)

    top = sums(values)
    if per is None:
        return top
    below = sums(per)
    ratio = top.sum() / below.sum()
    return ratio + (top - ratio * below) / below.mean()


def _answer(scores: Scores, a: float, b: float, count: int, floor: float = 0.0) -> dict[str, Any]:
    units = scores if len(scores) > 1 else scores.T
    found = estimate.interval(estimate.linear([(units, 1.0)], floor))
    return {"a": a, "b": b, **found._asdict(), "count": count}


def _by_leader(
    led: Sequence[pd.DataFrame], places: pd.MultiIndex, column: str, per: str = ""
) -> dict[str, Any]:
    """What b meets as the leader, minus what a meets."""
    a, b = (_scores(part, places, part[column], part[per] if per else None) for part in led)
    floor = 0.0 if per else estimate.binomial_floor([a, b])
    return _answer(b - a, a.mean(), b.mean(), len(led[0]), floor)


def _from_moments(parts: Sequence[pd.DataFrame], places: pd.MultiIndex) -> dict[str, Any]:
    """What b crashes, minus what a crashes, from the moments of each part; the mean of the parts."""
    if not all(map(len, parts)):
        return {"a": np.nan, "b": np.nan, **Estimate(np.nan, p=1.0, status=TOO_FEW)._asdict(), "count": 0}
    scores, floor = np.zeros(()), 0.0
    for part in parts:
        one = pd.Series(1.0, part.index)
        scores = scores + _scores(part, places, part["b"].astype(float) - part["a"], one) / len(parts)
        crashed = [part[[name]].to_numpy(dtype=float) for name in PAIR]
        floor += estimate.binomial_floor(crashed) / len(parts) ** 2
    a, b = (float(np.mean([part[name].mean() for part in parts])) for name in PAIR)
    found = _answer(scores, a, b, sum(map(len, parts)), floor)
    fewest = PAIRS if len(scores) > 1 else 1
    if any(len(part) < MOMENTS or part["pair"].nunique() < fewest for part in parts):
        found |= {"p": 1.0, "status": TOO_FEW}
    return found


def claims(found: pd.DataFrame, names: Sequence[str], p: str = "p") -> dict[str, str]:
    """What is said of driver b. names: of a and b. p: the column that decides, such as one that Holm has adjusted."""
    by_question = found.set_index("question")
    said = {}
    for question, word in ADJECTIVES.items():
        if question not in by_question.index:
            continue
        row = by_question.loc[question]
        sides = {
            np.sign(by_question.loc[f"{SKILL}, {leader} leads", "estimate"])
            for leader in PAIR
            if question == SKILL and f"{SKILL}, {leader} leads" in by_question.index
        }
        if row["status"] in (SATURATED, TOO_FEW):
            said[question] = row["status"]
        elif row["estimate"] == 0.0:
            said[question] = "no difference"
        elif len(sides) > 1:
            said[question] = "depends on whose moments"
        elif row[p] >= ALPHA:
            said[question] = "not decided"
        else:
            more, less = names[::-1] if row["estimate"] < 0 else names
            said[question] = f"{more} is more {word} than {less}"
    return said


def rates(rows: pd.DataFrame) -> pd.DataFrame:
    """Of each leader's critical moments, the share from which each driver crashes.

    Returns:
        A row a leader and driver: moments, crashed (within WINDOW) with the ends of its 95 % interval (low, high), and
        to_the_end, in which the caution of who goes on is, too (missing for who drives on for WINDOW alone).
    """
    found = []
    for leader, name in ((leader, name) for leader in PAIR for name in (*PAIR, *OTHERS)):
        times = rows.loc[rows["leader"] == leader, f"crash_{name}"].dropna()
        if len(times):
            share = dict(zip(("crashed", "low", "high"), limits(times <= WINDOW, is_share=True), strict=True))
            end = float((times < np.inf).mean()) if name in PAIR else np.nan
            found.append(
                {"leader": leader, "driver": name, "moments": len(times), **share, "to_the_end": end}
            )
    return pd.DataFrame(
        found, columns=["leader", "driver", "moments", "crashed", "low", "high", "to_the_end"]
    )


def overall(rows: pd.DataFrame) -> pd.DataFrame:
    """What each of the two meets as the leader, and what becomes of it in the moments of both.

    Returns:
        A row a driver: danger (share of episodes) and crashed (share of moments), with the ends of their 95 % intervals
        over episodes and over moments (_low, _high).
    """
    found = []
    for name in PAIR:
        own = rows[rows["leader"] == name]
        times = rows[f"crash_{name}"].dropna()
        row: dict[str, Any] = {"driver": name}
        for outcome, values in (
            ("danger", own["moment"].notna() | own["sudden"]),
            ("crashed", times <= WINDOW),
        ):
            ends = zip(("", "_low", "_high"), limits(values, is_share=True), strict=True)
            row |= {f"{outcome}{end}": value for end, value in ends}
        found.append(row)
    return pd.DataFrame(found)


def own_crashes(rows: pd.DataFrame) -> pd.DataFrame:
    """When the leader crashes that goes on itself, as shares of its crashes.

    Returns:
        A row a leader: crashes, and the shares in_time (within WINDOW after the moment), later, and sudden.
    """
    found = []
    for leader, own in rows.groupby("leader"):
        times = own[f"crash_{leader}"]
        kinds = {
            "in_time": times <= WINDOW,
            "later": (times > WINDOW) & (times < np.inf),
            "sudden": own["sudden"],
        }
        crashes = sum(int(kind.sum()) for kind in kinds.values())
        shares = {name: kind.sum() / crashes if crashes else np.nan for name, kind in kinds.items()}
        found.append({"leader": leader, "crashes": crashes, **shares})
    return pd.DataFrame(found)
