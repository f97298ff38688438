"""Values: small classes that nobody changes once they are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

Class = TypeVar("Class")


@dataclass_transform(frozen_default=True)
def value(made: type[Class]) -> type[Class]:
    """A dataclass with slots that type checkers, and not Python itself, keep from being changed.

    For what is made often: with twelve fields a frozen one takes 1.0 us to make and this one 0.13, and a scenario of
    the highway makes 50 to 150 of them.
    """
    return dataclass(slots=True, unsafe_hash=True)(made)


__all__ = ["value"]
