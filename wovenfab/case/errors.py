"""What is wrong with a case: where, what, and what would be right."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError
from pydantic_core import PydanticCustomError

if TYPE_CHECKING:
    from wovenfab.case.document import Document

#: Keys and list indices that lead to a value of the case.
KeyPath = tuple[str | int, ...]


@dataclass(frozen=True)
class CaseProblem:
    """One thing that is wrong with a case.

    Attributes:
        file: The case file as the user named it, or the option, such as ``--set``;
            empty for a case that was built in Python.
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
        if not self.file:
            head = f"{self.key}: " if self.key else ""
            return f"{head}{self.message}. {self.remedy}".rstrip()
        place = self.file if self.line is None else f"{self.file}:{self.line}"
        separator = " " if self.file.startswith("--") else ": "
        head = f"{place}{separator}{self.key}: " if self.key else f"{place}: "
        return f"{head}{self.message}. {self.remedy}".rstrip()


#: ``Problem.file`` of a value given on the command line.
OVERRIDE = "--set"


class CaseError(Exception):
    """A case that cannot be run, with all the reasons for that.

    Attributes:
        problems: The reasons, in the order of the file.
    """

    def __init__(self, problems: Iterable[CaseProblem]) -> None:
        """Keep each problem once."""
        self.problems = tuple(dict.fromkeys(problems))
        super().__init__(self.problems)

    def __str__(self) -> str:
        """Return one line for each problem."""
        return "\n".join(map(str, self.problems))

    def __repr__(self) -> str:
        """Return the same, as it is shown in a list."""
        return f"CaseError({str(self)!r})"


def case_error(
    file: str, message: str, remedy: str = "", line: int | None = None, key: str = ""
) -> CaseError:
    """Return the error of a case with one problem; arguments as in :class:`Problem`."""
    return CaseError([CaseProblem(file, line, key, message, remedy)])


class FormulaError(ValueError):
    """A text that is no formula, or one that makes no sense.

    Attributes:
        remedy: What would be right, in full sentences; may be empty.
    """

    def __init__(self, message: str, remedy: str = "") -> None:
        """Keep both."""
        super().__init__(message)
        self.remedy = remedy


#: What the tags of laws begin with: in the path of an error, a tag is then no key of the section.
_TAG = "law="


def tagged(law: str) -> str:
    """Return the tag of a law of an effect among the models of its values."""
    return f"{_TAG}{law}"


def value_error(message: str, remedy: str = "") -> PydanticCustomError:
    """Return the error to raise in a validator; arguments as in :class:`Problem`."""
    return PydanticCustomError("wrong", "{message}", {"message": message, "remedy": remedy})


def reason(error: PydanticCustomError) -> tuple[str, str]:
    """Return message and remedy of an error made by :func:`wrong`."""
    return error.context["message"], error.context["remedy"]  # type: ignore[index]


def dotted(path: KeyPath) -> str:
    """Return a path as it is written on the command line: ``effects.shear.stiffness``."""
    return ".".join(map(str, path))


def key_path(key: str) -> KeyPath:
    """Return the path of a dotted key."""
    return tuple(int(k) if k.isdecimal() else k for k in key.strip().split("."))


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


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."


def problems_in(
    error: ValidationError, document: Document, schema: Mapping[str, Any]
) -> Iterator[CaseProblem]:
    """Yield a problem for each error of pydantic for the document's data.

    ``schema`` is the JSON Schema of the case, for the keys that there are.
    """
    misspelt: set[KeyPath] = set()
    # What is missing may be there under a misspelt key, so that this comes first.
    for item in sorted(error.errors(include_url=False), key=lambda e: e["type"] == "missing"):
        missing = item["type"] == "missing"
        path = document.locate(item["loc"], missing)
        keys = _keys(schema, document.data, path[:-1])
        if path in misspelt or (item["type"] == "too_short" and item["input"]):
            continue  # the items of the list are wrong, which is text there
        if item["type"] == "extra_forbidden":
            misspelt.add((*path[:-1], nearest(path[-1], keys) or ""))
        message, remedy = _words(dict(item), path, keys)
        if item["type"].startswith("union_tag"):
            path = (*path, item["ctx"]["discriminator"].strip("'()"))
        if missing and isinstance(path[-1], int):
            path = path[:-1]
        yield document.problem(path, message, remedy)


def _words(item: Mapping[str, Any], path: KeyPath, keys: Mapping[str, Any]) -> tuple[str, str]:
    """Return message and remedy of one error; ``keys`` are those beside its own."""
    given, context = item["input"], item.get("ctx", {})
    match item["type"]:
        case "wrong":
            return context["message"], context["remedy"]
        case "missing" if isinstance(path[-1], int):
            return f"expected two values, got {path[-1]}", ""
        case "missing" if path == ("effects",):
            return "missing", "A test takes them from a fabric, by --fabric or 'from'."
        case "missing":
            return "missing", _for_example(str(path[-1]), keys)
        case "extra_forbidden":
            if given is None and str(path[-1])[:1].isdecimal():
                return "unknown key", "Within { } a text with commas is in quotes: '20, 40 mm'."
            noun = "effect" if path[:-1] == ("effects",) else "key"
            meant = near_miss(path[-1], keys)
            known = f"The {noun}s are {', '.join(keys)}."
            custom = f"One of your own takes its file: '{path[-1]}: {{file: {path[-1]}.py}}'."
            if noun == "effect":
                return "unknown effect", f"{meant or known} {known if meant else custom}"
            law = None if "default" in (of := keys.get("law", {})) else of.get("const")
            return f"unknown key with the law '{law}'" if law else "unknown key", meant or known
        case "literal_error" | "union_tag_invalid":
            text = context.get("expected") or context["expected_tags"]
            options = text.replace("'", "").replace(_TAG, "").replace(" or ", ", ").split(", ")
            given = context.get("tag", given)
            given = given.removeprefix(_TAG) if isinstance(given, str) else given
            return f"expected {one_of(options)}, got {describe(given)}", near_miss(given, options)
        case "union_tag_not_found":
            return "missing", "For example 'type: ramp'."
        case "too_short":
            return "the list is empty", ""
        case "too_long":
            return f"expected two values, got {context['actual_length']}", ""
        case "model_type" | "model_attributes_type" | "dict_type" | "mapping_type":
            return f"expected keys with values, got {describe(given)}", ""
        case "tuple_type" | "list_type":
            return f"expected a list, got {describe(given)}", ""
        case "string_type":
            return f"expected text, got {describe(given)}", "Put it in quotes."
        case "bool_type":
            return f"expected true or false, got {describe(given)}", ""
    return str(item["msg"]), ""


def _for_example(key: str, keys: Mapping[str, Any]) -> str:
    examples = keys.get(key, {}).get("examples")
    return f"For example '{key}: {_flow(examples[0])}'." if examples else ""


def _flow(value: Any) -> str:
    """Return a value as YAML in one line."""
    match value:
        case dict():
            return "{" + ", ".join(f"{k}: {_flow(v)}" for k, v in value.items()) + "}"
        case list():
            return "[" + ", ".join(map(_flow, value)) + "]"
    return str(value)


def _keys(schema: Mapping[str, Any], data: Any, path: KeyPath) -> Mapping[str, Any]:
    """Return the schemas of the keys that may stand in the mapping at ``path``."""
    places = list(_forms(schema, schema, data))
    for part in path:
        data = data[part]
        places = [f for p in places for s in _inner(p, part) for f in _forms(schema, s, data)]
    return {k: v for p in places for k, v in p.get("properties", {}).items()}


def _forms(
    root: Mapping[str, Any], schema: Mapping[str, Any], data: Any
) -> Iterator[Mapping[str, Any]]:
    """Yield the alternatives of a schema, less those for another ``type`` or ``law``."""
    if "$ref" in schema:
        yield from _forms(root, root["$defs"][schema["$ref"].split("/")[-1]], data)
    for alternative in (*schema.get("anyOf", ()), *schema.get("oneOf", ())):
        yield from _forms(root, alternative, data)
    for key in ("type", "law") if isinstance(data, dict) else ():
        kind = schema.get("properties", {}).get(key, {}).get("const")
        usual = None if key == "law" and key in schema.get("required", ()) else kind
        if kind and data.get(key, usual) != kind:
            return
    if schema.get("type") in ("object", "array"):
        yield schema


def _inner(schema: Mapping[str, Any], part: str | int) -> Iterator[Mapping[str, Any]]:
    """Yield the schemas of one value in a mapping or a list."""
    if part in schema.get("properties", {}):
        yield schema["properties"][part]
    elif isinstance(schema.get("additionalProperties"), dict):
        yield schema["additionalProperties"]
    elif "items" in schema and isinstance(part, int):
        yield schema["items"]


def joined(text: str) -> str | None:
    """Return text with characters in one piece that JSON writes as two; None if half of one."""
    try:
        return text.encode("utf-16", "surrogatepass").decode("utf-16")
    except UnicodeDecodeError:
        return None
