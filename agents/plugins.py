"""Things by name: those that there are, and objects from a user's own file, "FILE:NAME"."""

import difflib
import hashlib
import importlib.util
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


def split(name: str) -> tuple[Path, str]:
    """File and name in it. Raises ValueError when it has another form or there is no such file."""
    file, colon, attribute = name.rpartition(":")
    if not (colon and file and attribute.isidentifier()):
        example = f"my_file.py:{name}" if name.isidentifier() else "my_file.py:MyNetwork"
        raise ValueError(f"Expected FILE:NAME, for example {example}, got {name!r}.")
    path = Path(file)
    if not path.is_file():
        raise ValueError(f"There is no file {file} (from {name!r}).")
    return path, attribute


def sha256(path: Path) -> str:
    """Fingerprint of a file. Raises ValueError when it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        raise ValueError(f"there is no file {path}") from None


def foreign(name: str) -> tuple[str, str]:
    """Label and fingerprint of something in a user's file, "FILE:NAME" or "model.zip".

    The label names the file without its folder, so that it is called the same wherever the file lies.

    Raises ValueError when there is no such file.
    """
    path, attribute = (Path(name), "") if name.endswith(".zip") else split(name)
    return f"{path.name}:{attribute}" if attribute else path.name, sha256(path)


def unknown(kind: str, name: str, known: Iterable[str], whose: str = "") -> ValueError:
    """The error for a name that does not exist, with the nearest known one."""
    names = list(known)
    near = difflib.get_close_matches(name.lower(), names, 1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return ValueError(f"unknown {kind} {name!r}{whose}: {hint}known are {', '.join(names)}")


def named(kind: str, name: str, known: Mapping[str, T]) -> T:
    """What this name means, or "FILE:NAME". Raises ValueError where there is no such thing."""
    if name in known:
        return known[name]
    if ":" not in name:
        raise unknown(kind, name, [*known, "FILE:NAME"])
    return load_object(name)


def load_object(name: str) -> Any:
    """Run the file of "FILE:NAME" as a module of its own and return the object of that name.

    Raises ValueError when there is no such file or name, or when the file cannot be run.
    """
    path, attribute = split(name)
    label = f"user_{path.stem}_{sha256(path)[:8]}"
    description = importlib.util.spec_from_file_location(label, path)
    if description is None or description.loader is None:
        raise ValueError(f"{path} is no Python file.")
    module = importlib.util.module_from_spec(description)
    sys.modules[label] = module  # dataclasses look their module up
    try:
        description.loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"{path} cannot be run: {type(error).__name__}: {error}") from error
    if not hasattr(module, attribute):
        raise ValueError(f"{path} defines no {attribute}.")
    return getattr(module, attribute)
