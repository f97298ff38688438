"""Numbers of outcomes as people read them: digits, units, signs, points instead of shares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.analysis.plan import OUTCOMES

MINUS = "\N{MINUS SIGN}"
NONE = "\N{EN DASH}"  # where there is no number
BACKENDS = {"sumo": "SUMO", "replica": "highway-env's physics (replica)", "highway-env": "highway-env"}
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


FILTERS = {f.__name__: f for f in (number, points, difference, p_value, listing, count)}
