"""The SUMO of an environment, wherever it runs: libsumo's functions by their names."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

# Functions that would end the episode behind the environment's back.
REFUSED = {
    *("load", "start", "close", "simulationStep", "step"),
    *("executeMove", "loadState", "init", "setOrder", "switch"),
}


class Sumo:
    """``sumo.vehicle.getSpeed("ego")``: as libsumo, in the simulation of one environment.

    Args:
        call: of a function by its name (``vehicle.getSpeed``), its arguments and those by name.
    """

    def __init__(self, call: Callable[[str, tuple[Any, ...], dict[str, Any]], Any], path: str = "") -> None:
        self._call, self._path = call, path

    def __getattr__(self, name: str) -> "Sumo":
        if name.startswith("_"):
            raise AttributeError(name)
        if name in REFUSED and self._path in ("", "simulation"):
            raise AttributeError(f"{name!r} is the environment's own: call its reset(), step() or close()")
        return Sumo(self._call, f"{self._path}.{name}".lstrip("."))

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call the function of this name; its result has SUMO's values, of plain types."""
        return self._call(self._path, arguments, named)

    def __repr__(self) -> str:
        return f"<libsumo{'.' if self._path else ''}{self._path} of an environment>"


def plain(value: Any) -> Any:
    """What libsumo returns, as values that can be sent to another process."""
    if isinstance(value, tuple | list):
        return tuple(map(plain, value))
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if value is None or isinstance(value, str | int | float):
        return value
    names = [name for name in dir(value) if not name.startswith("_") and name not in ("this", "thisown")]
    return SimpleNamespace(
        **{name: plain(item) for name in names if not callable(item := getattr(value, name))}
    )
