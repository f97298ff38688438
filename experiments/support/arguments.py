"""The command line of every command: a dataclass of options, whose texts are the help."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import tyro

from experiments.support.errors import run_command

T = TypeVar("T")


def command(run: Callable[[T], int], options: type[T], about: str | None, resumes: bool = False) -> None:
    """Run a command with the options of its command line, and leave the process (`errors.run_command`)."""
    run_command(lambda: run(parsed(options, sys.argv[1:], about)), resumes)


def parsed(options: type[T], arguments: Iterable[str], about: str | None) -> T:
    """The options of a command line. about: the command, for the help."""
    words = split_arguments(arguments, options)
    return tyro.cli(options, args=words, description=about, config=(tyro.conf.FlagCreatePairsOff,))


def split_arguments(arguments: Iterable[str], options: type[Any]) -> list[str]:
    """`--tasks highway,u-turn`, `--policy A --policy B`, `--unseen` and `--no-unseen` as tyro takes them.

    That is with spaces, each option once, and a flag that may be None with its value.
    """
    hints = {f"--{name.replace('_', '-')}": hint for name, hint in get_type_hints(options).items()}
    lists = {
        name for name, hint in hints.items() if tuple in [get_origin(one) for one in (hint, *get_args(hint))]
    }
    values: dict[str, list[str]] = {}
    name = ""
    for word in arguments:
        if word.startswith("--"):
            name, *given = word.split("=", 1)
            flag = f"--{name.removeprefix('--').removeprefix('no-')}"
            if bool in get_args(hints.get(flag)):
                values[flag] = [str(flag == name)]
                continue
        else:
            given = [word] if name not in lists or set("/=") & set(word) else word.split(",")
        values.setdefault(name, []).extend(given)
    return [word for name, given in values.items() for word in ([name] if name else []) + given]
