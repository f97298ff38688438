"""What data from a file must look like, as data; `check` says where a value does not."""

from __future__ import annotations

import json
import math
from types import UnionType
from typing import Any, NoReturn


class Wrong(ValueError):
    """Stored data that no version of this package has written; says where, and what is expected there."""


def parsed(text: str | bytes) -> Any:
    """A value of strict JSON. Raises ValueError, also for NaN, infinity, and what is nested too deeply."""

    def refuse(word: str) -> NoReturn:
        raise Wrong(f"it has the number {word}")

    def number(word: str) -> float:
        return value if math.isfinite(value := float(word)) else refuse(word)

    try:
        return json.loads(text, parse_constant=refuse, parse_float=number)
    except RecursionError:
        raise Wrong("it is nested too deeply") from None


def check(value: Any, expected: Any, where: str = "") -> None:
    """That a value of JSON is what is expected.

    Args:
        expected: a type or a union of types (a truth value is no number); a range of whole numbers, or a tuple of the
            values that are possible; a dict of the entries that are needed, and what is expected of each ("name?": it
            may be missing); a list with what is expected of each item, or of the items of a list of that length.
        where: the value's own place, for the message.

    Raises:
        Wrong: it is something else; the message names the place.
    """
    if isinstance(expected, dict):
        check(value, type(expected), where)
        for name, inner in expected.items():
            entry, place = name.removesuffix("?"), f"{where}.{name}".strip(".?")
            if entry in value:
                check(value[entry], inner, place)
            elif entry == name:
                raise Wrong(f"{place} is missing")
    elif isinstance(expected, list):
        check(value, list, where)
        if len(expected) > 1 and len(value) != len(expected):
            raise Wrong(f"{where} must have {len(expected)} items, not {len(value)}")
        for number, item in enumerate(value):
            check(item, expected[number % len(expected)], f"{where}[{number}]")
    elif isinstance(expected, type | UnionType):
        if not isinstance(value, expected) or (isinstance(value, bool) and expected is not bool):
            raise Wrong(f"{where} must be {getattr(expected, '__name__', expected)}, not {shortened(value)}")
    elif isinstance(expected, range):
        if type(value) is not int or value not in expected:
            raise Wrong(
                f"{where} must be a whole number from {expected[0]} to {expected[-1]}, not {shortened(value)}"
            )
    elif value not in expected:
        raise Wrong(f"{where} must be one of {', '.join(map(str, expected))}, not {shortened(value)}")


def shortened(value: Any) -> str:
    """A value for a message, whatever its size."""
    text = repr(value)
    return text if len(text) < 60 else f"{text[:60]} ..."
