"""Something that lives in another process; imports nothing, so that the process starts quickly."""

from __future__ import annotations

import os


class Counter:
    def __init__(self, start: int) -> None:
        self.value = start

    def add(self, amount: int) -> int:
        self.value += amount
        return self.value

    def process(self) -> int:
        return os.getpid()

    def fail(self) -> None:
        raise ValueError("no such thing")

    def die(self) -> None:
        os._exit(3)
