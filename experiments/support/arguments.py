"""The command line of every command: a dataclass of options, whose texts are the help."""

import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Annotated, Any, TypeVar, get_origin, get_type_hints

import tyro

from experiments.support.errors import UserError, run_command

T = TypeVar("T")
SWITCH = {"true": True, "yes": True, "false": False, "no": False}  # what a flag takes
ALIKE = {"--task": "--tasks", "--tasks": "--task"}  # some commands drive one task, others several
Flag = Annotated[bool, tyro.conf.arg(help_behavior_hint="")]


def argument(metavar: str, none: str = "none", help: str | None = None) -> Any:
    """How an option is shown in the help text. none: its default in words where that is empty."""

    def hint(default: str) -> str:
        return f"(default: {none if default in ('', 'None') else default})"

    return tyro.conf.arg(metavar=metavar, help_behavior_hint=hint, help=help)


def command(
    run: Callable[[T], int],
    options: type[T],
    about: str | None,
    resumes: bool = False,
    default: Callable[[Sequence[str]], T] | None = None,
) -> None:
    """Run a command with the options of its command line, and leave the process (`errors.run_command`).

    default: see `parsed`.
    """
    run_command(lambda: run(parsed(options, sys.argv[1:], about, default)), resumes)


def as_typed(name: str, arguments: Iterable[str]) -> str:
    """How a command of `experiments` is typed with these arguments."""
    return shlex.join(["python", f"experiments/{name}.py", *arguments])


def parsed(
    options: type[T],
    arguments: Iterable[str],
    about: str | None,
    default: Callable[[Sequence[str]], T] | None = None,
) -> T:
    """The options of a command line.

    Args:
        about: the command, for the help. default: what is not said, from the command line (by default the class's own).

    Raises:
        UserError: a flag has another value than true, false, yes or no; a value begins with a dash; or what is named
            without an option is not there, perhaps taken as one more value of an option.
    """
    words = split_arguments(arguments, options)
    hints = get_type_hints(options, include_extras=True)
    marks: list[Any] = [getattr(hint, "__metadata__", ()) for hint in hints.values()]
    unnamed = [own[-1].metavar for own in marks if tyro.conf.Positional in own]
    if unnamed and words and words[0].startswith("--") and not {"-h", "--help"} & set(words):
        raise UserError(f"{unnamed[0]} is missing: name it before the options")
    usual = default(words) if default else tyro.MISSING_NONPROP
    config = (tyro.conf.FlagCreatePairsOff,)
    return tyro.cli(options, args=words, default=usual, description=about, config=config)


def split_arguments(arguments: Iterable[str], options: type[Any]) -> list[str]:
    """`--tasks highway,u-turn`, `--policy A --policy B`, `--unseen=no` and `--no-unseen` as tyro takes them.

    That is with spaces, each option once, of flags those that are on, and `--task` as the command calls it. Raises as
    `parsed` does.
    """
    hints = {f"--{name.replace('_', '-')}": hint for name, hint in get_type_hints(options).items()}
    lists = {name for name, hint in hints.items() if get_origin(hint) is tuple}
    flags = {name for name, hint in hints.items() if hint is bool}

    def parts(word: str) -> list[str]:
        return [word] if name not in lists or set("/=") & set(word) else word.split(",")

    values: dict[str, list[str]] = {"": []}
    switched: dict[str, bool] = {}
    name = ""
    for word in arguments:
        if word.startswith("--"):
            name, *given = word.split("=", 1)
            name = name if name in hints else ALIKE.get(name, name)
            flag = f"--{name.removeprefix('--').removeprefix('no-')}"
            if flag in flags:
                switched[flag] = (flag == name) == _switch(name, *given)
                name = flag
            else:
                values.setdefault(name, []).extend(one for word in given for one in parts(word))
                name = "" if given and name not in lists else name
            continue
        _check_word(word)
        if name in flags:  # its value, or an argument behind it
            if word.lower() in SWITCH:
                switched[name] = _switch(name, word)
            else:
                values[""].append(word)
            name = ""
            continue
        values[name].extend(parts(word))
        if name not in lists:  # has one value: what follows is no other one
            name = ""
    found = [word for name, given in values.items() for word in ([name] if name else []) + given]
    return [*found, *(name for name, is_on in switched.items() if is_on)]


def _switch(name: str, word: str = "true") -> bool:
    """What a flag is set to. Raises UserError for another word than those of SWITCH."""
    if word.lower() not in SWITCH:
        raise UserError(f"{name} is true, false, yes or no, not {word!r}")
    return SWITCH[word.lower()]


def _check_word(word: str) -> None:
    """Raise UserError for a word that begins with a dash and is no number: no option has one letter."""
    with suppress(ValueError):
        float(word)
        return
    if word.startswith("-") and word != "-h":
        raise UserError(f"there is no option {word}; a file or folder of this name is written ./{word}")
