"""What is wrong with a case file: where, what, and what would be right."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic_core import PydanticCustomError

#: Keys and list indices that lead to a value of the case.
Path = tuple[str | int, ...]


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a case.

    Attributes:
        file: The case file as the user named it, or the option, such as ``--set``.
        line: Line of the file, from 1; None where there is none.
        key: Dotted key, list indices from 0; empty for the file as a whole.
        message: What is wrong, without a full stop.
        remedy: What would be right, in full sentences; may be empty.
    """

    file: str
    line: int | None
    key: str
    message: str
    remedy: str = ""

    def __str__(self) -> str:
        """Return the problem as it is printed."""
        place = self.file if self.line is None else f"{self.file}:{self.line}"
        separator = " " if self.file.startswith("--") else ": "
        head = f"{place}{separator}{self.key}: " if self.key else f"{place}: "
        return f"{head}{self.message}. {self.remedy}".rstrip()


#: ``Problem.file`` of a value given on the command line.
OVERRIDE = "--set"


class CaseError(Exception):
    """A case that cannot be run, with all the reasons that were found.

    Attributes:
        problems: The reasons, in the order of the file.
    """

    def __init__(self, problems: Iterable[Problem]) -> None:
        """Keep each problem once."""
        self.problems = tuple(dict.fromkeys(problems))
        super().__init__(self.problems)

    def __str__(self) -> str:
        """Return one line for each problem."""
        return "\n".join(map(str, self.problems))


def refusal(
    file: str, message: str, remedy: str = "", line: int | None = None, key: str = ""
) -> CaseError:
    """Return the error of a case with one problem; arguments as in :class:`Problem`."""
    return CaseError([Problem(file, line, key, message, remedy)])


def wrong(message: str, remedy: str = "") -> PydanticCustomError:
    """Return the error to raise in a validator; arguments as in :class:`Problem`."""
    return PydanticCustomError("wrong", "{message}", {"message": message, "remedy": remedy})


def dotted(path: Path) -> str:
    """Return a path as it is written on the command line: ``effects.shear.stiffness``."""
    return ".".join(map(str, path))


def one_of(options: Sequence[str]) -> str:
    """Return ``'a', 'b' or 'c'``."""
    quoted = [f"'{o}'" for o in options]
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} or {quoted[-1]}"


def nearest(word: Any, options: Iterable[str]) -> str | None:
    """Return the option that was probably meant, or None if none is near."""
    return next(iter(difflib.get_close_matches(str(word), list(options), n=1)), None)


def near_miss(word: Any, options: Iterable[str]) -> str:
    """Return ``Did you mean '...'?``, or nothing if no option is near."""
    meant = nearest(word, options)
    return f"Did you mean '{meant}'?" if meant else ""


def describe(value: Any) -> str:
    """Return a value from a case file in a few words."""
    match value:
        case None:
            return "nothing"
        case bool():
            return str(value).lower()
        case dict():
            return "a mapping"
        case list():
            return "a list"
        case str():
            return repr(_short(value))
        case float() if "e" in f"{value:g}":
            return f"{value:g}"
        case _:
            return _short(str(value))


def in_brief(error: BaseException) -> str:
    """Return the kind of an error and what it says in one line."""
    said = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(":.")
    return said if len(said) <= 200 else f"{said[:197]}..."


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."
