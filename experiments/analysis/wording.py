"""Numbers and counts as people read them: signs, digits, units, percentages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from experiments.analysis.plan import OUTCOMES

MINUS = "\N{MINUS SIGN}"
NONE = "\N{EN DASH}"  # where there is no number
BACKENDS = {"sumo": "SUMO", "replica": "the replica"}


def number(value: float | None, outcome: str, signed: bool = False) -> str:
    """A value of an outcome with the digits it deserves; shares as percentages ("12.5 %", signed "-3.0")."""
    if value is None:
        return NONE
    kind = OUTCOMES[outcome]
    text = f"{value * (100 if kind.percent else 1):{'+' if signed else ''}.{kind.digits}f}"
    if float(text) == 0:
        text = text.replace("-", "").replace("+", "")
    text = text.replace("-", MINUS)
    return f"{text} %" if kind.percent and not signed else text


def signed(value: float, digits: int) -> str:
    """A number with its sign ("-0.92", with a true minus)."""
    return f"{value:+.{digits}f}".replace("-", MINUS)


def difference(record: Mapping[str, Any], outcome: str) -> str:
    """An estimated difference: "-3.1 points [-7.0, +0.8]", "-3.1 points (no interval)"."""
    estimate = number(record["estimate"], outcome, signed=True)
    if record["estimate"] is None:
        return estimate
    unit = " points" if OUTCOMES[outcome].percent else ""
    if record["low"] is None:
        return f"{estimate}{unit} (no interval)"
    return f"{estimate}{unit} {interval(record, outcome)}"


def interval(record: Mapping[str, Any], outcome: str) -> str:
    """The interval of a record, "[-7.0, +0.8]", or an empty text."""
    if record["low"] is None:
        return ""
    low, high = (number(record[bound], outcome, signed=True) for bound in ("low", "high"))
    return f"[{low}, {high}]"


def adjusted(record: Mapping[str, Any], outcome: str) -> str:
    """The interval at the level of the record's family, or a dash."""
    if record.get("low_adjusted") is None:
        return NONE
    low, high = (number(record[f"{bound}_adjusted"], outcome, signed=True) for bound in ("low", "high"))
    return f"[{low}, {high}]"


def p_value(p: float | None) -> str:
    """A p-value with as many digits as matter."""
    if p is None:
        return NONE
    return "< .001" if p < 0.001 else f"{p:.3f}".removeprefix("0")


def place(record: Mapping[str, Any]) -> str:
    """The task and traffic level of a record ("highway 50"), or its task alone."""
    return f"{record['task']} {record['level_name']}" if "level_name" in record else str(record["task"])


def count(n: int, word: str) -> str:
    """ "1 agent", "3 agents"."""
    return f"{n} {word}{'' if n == 1 else 's'}"


def listing(items: Sequence[str], most: int = 6) -> str:
    """ "a, b and c", cut after `most` items."""
    shown = [*items[:most], *([f"{len(items) - most} more"] if len(items) > most else [])]
    return " and ".join(filter(None, [", ".join(shown[:-1]), *shown[-1:]]))
