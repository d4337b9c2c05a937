"""YAML files to plain data that keeps the place of each value."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationInfo
from pydantic_core import PydanticCustomError
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode

from wovenfab.case.errors import (
    OVERRIDE,
    CaseError,
    CaseProblem,
    KeyPath,
    case_error,
    describe,
    dotted,
    joined,
    key_path,
    near_miss,
    one_of,
    reason,
    value_error,
)
from wovenfab.case.recorded import DEEPEST, LARGEST, MOST_VALUES
from wovenfab.forms.table import TABLE

#: Key of a value that names a file, wherever it stands in a case.
FILE = "file"
#: Key of the results directory whose last state a case starts from.
STATE = "from_state"
#: Key that chooses among the laws of an effect.
LAW = "law"


def _names_file(path: KeyPath) -> bool:
    """Return whether a text at a path may be the name of a file or folder."""
    return path[-1:] in ((FILE,), (STATE,)) or TABLE in path[2:3]


class FileName(str):
    """The name of a file, which remembers the folder of the file in which it stands."""

    folder: Path

    def __new__(cls, text: str, folder: Path) -> FileName:
        """Keep the folder beside the text."""
        name = super().__new__(cls, text)
        name.folder = folder
        return name

    def __getnewargs__(self) -> tuple[str, Path]:  # type: ignore[override]
        """Return what a copy in another process is made of."""
        return str(self), self.folder


def existing_file(value: Any, folder: Path, suffixes: tuple[str, ...]) -> Path:
    """Return the absolute path of a file that a case names, or of a folder without suffixes.

    ``folder`` is where the case lies, for a name that does not know its own folder.
    """
    folder = value.folder if isinstance(value, FileName) else folder
    if not isinstance(value, str) or not value:
        raise value_error(f"expected the name of a file, got {describe(value)}")
    if suffixes and Path(value).suffix.lower() not in suffixes:
        raise value_error(f"expected a file that ends in {one_of(suffixes)}, got {describe(value)}")
    path: Path | None = None
    with suppress(OSError, ValueError):  # such as a name that is too long
        found = (folder / value).resolve()
        if found.is_file() if suffixes else found.is_dir():
            path = found
    if path is None:
        kind = "file" if suffixes else "folder"
        where = "Names are relative to the case file, those of --set to the current folder."
        raise value_error(f"there is no {kind} {describe(value)}", where)
    if suffixes and path.suffix.lower() != Path(value).suffix.lower():
        # the name must say what is read: a .geo is a program
        what = f"{describe(value)} is a link to {describe(path.name)}"
        raise value_error(what, "Name that file itself.")
    return path


def folder_of(info: ValidationInfo) -> Path:
    """Return where the case lies that is being read, or the current folder."""
    folder: Path = (info.context or {}).get("folder", Path())
    return folder


_TEXT = ("tag:yaml.org,2002:str", "tag:yaml.org,2002:timestamp")
_OTHER_SCALARS = tuple(f"tag:yaml.org,2002:{t}" for t in ("int", "float", "bool", "null"))


class SourceLine(NamedTuple):
    """Where a value was written.

    Attributes:
        file: The file as the user named it, or ``--set``.
        line: Line of the file, from 1; None for ``--set``.
    """

    file: str
    line: int | None


@dataclass(frozen=True)
class Places:
    """Where the values of a case were written.

    Attributes:
        file: The file as the user named it; empty for a case that was built in Python.
        places: Where each value was written, by its path; that may be another file.
    """

    file: str
    places: Mapping[KeyPath, SourceLine]

    def locate(self, location: KeyPath, missing: bool = False) -> KeyPath:
        """Return the path in the data of a place in the case.

        The place may also name which form of a section was meant (``"cycles"``) and
        count items of a list whose brackets were left out; these are passed over. A last key
        that is ``missing`` is kept all the same.
        """
        path: KeyPath = ()
        for i, part in enumerate(location):
            if (*path, part) in self.places or (missing and i == len(location) - 1):
                path = (*path, part)
        return path

    def place(self, path: KeyPath) -> SourceLine:
        """Return where a value was written, or what should hold it."""
        holders = (path[:n] for n in range(len(path), -1, -1))
        return next(
            (self.places[p] for p in holders if p in self.places), SourceLine(self.file, None)
        )

    def problem(self, path: KeyPath, message: str, remedy: str = "") -> CaseProblem:
        """Return the problem of the value at ``path``, or of what should hold it."""
        return CaseProblem(*self.place(path), dotted(path), message, remedy)

    def in_order(self, problems: Iterable[CaseProblem]) -> list[CaseProblem]:
        """Return problems in the order in which this case is read: by file, then by line."""
        files = list(dict.fromkeys(place.file for place in self.places.values()))
        return sorted(problems, key=lambda p: (files.index(p.file), p.line) if p.line else (-1, 0))


@dataclass(frozen=True)
class Document(Places):
    """Plain data (dict, list, str, int, float, bool, None) and its origin.

    Attributes:
        data: What the text says.
    """

    data: Any

    @classmethod
    def of(cls, data: Any, origin: Places | None = None) -> Document:
        """Return data of Python, each value where its origin has it, or what holds it there."""
        origin = origin or Places("", {})
        return cls(origin.file, {p: origin.place(origin.locate(p)) for p in paths_in(data)}, data)


def paths_in(data: Any, above: KeyPath = ()) -> Iterator[KeyPath]:
    """Yield the paths of all values in plain data."""
    yield above
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from paths_in(value, (*above, key))


def read_document(path: Path) -> Document:
    """Return the contents of a YAML file.

    Raises:
        CaseError: The file cannot be read or is not plain YAML.
    """
    return parse_document(_text_of(path), str(path), path.parent)


def parse_document(text: str, file: str, folder: Path | None = None) -> Document:
    """Return what YAML text of a file says, as :func:`read_document` does.

    Files that it names are relative to ``folder``; to that of the case if None.
    """
    try:
        root = YAML(typ="safe", pure=True).compose(text)
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        problem = ", ".join(filter(None, (error.context, error.problem)))
        raise case_error(file, f"this is not valid YAML: {problem}", "", line) from error
    except (YAMLError, ValueError, OverflowError) as error:  # the last two of "\U00110000"
        raise case_error(file, "this is not text: it has control characters in it") from error
    except RecursionError as error:
        raise case_error(file, "lists or mappings are nested too deeply") from error
    if root is None:
        raise case_error(file, "the file is empty", "Start from one of those in configs/.")
    reader = _Reader(file, folder)
    data = reader.read(root, ())
    if reader.problems:
        raise CaseError(reader.problems)
    return Document(
        file, {path: SourceLine(file, line) for path, line in reader.lines.items()}, data
    )


def _text_of(path: Path) -> str:
    try:
        if path.is_dir():
            raise case_error(str(path), "this is a folder", "Name the case file in it.")
        if not path.is_file():
            what = "this is not an ordinary file" if path.exists() else "there is no such file"
            raise case_error(str(path), what)
        if path.stat().st_size > LARGEST:
            raise case_error(str(path), "this is too large to be a case file (more than 1 MB)")
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = path.read_bytes()[: error.start].count(b"\n") + 1
        what, remedy = "this is not UTF-8 text", "Save the file in UTF-8."
        raise case_error(str(path), what, remedy, line) from error
    except OSError as error:
        raise case_error(str(path), f"the file cannot be read: {error.strerror}") from error


class _Reader:
    """Walks the nodes of one document."""

    def __init__(self, file: str, folder: Path | None) -> None:
        self.file, self.folder = file, folder
        self.scalar = YAML(typ="safe", pure=True).constructor.construct_object
        self.lines: dict[KeyPath, int] = {}
        self.problems: list[CaseProblem] = []

    def read(self, node: Any, path: KeyPath) -> Any:
        line = node.start_mark.line + 1
        self.lines.setdefault(path, line)
        # An alias is read where it stands, and may even lead back to itself.
        if len(path) > DEEPEST or len(self.lines) > MOST_VALUES:
            raise case_error(self.file, "lists or mappings are nested too deeply", "", line)
        match node:
            case MappingNode():
                return dict(self._pairs(node, path))
            case SequenceNode():
                return [self.read(item, (*path, i)) for i, item in enumerate(node.value)]
            case ScalarNode() if node.tag in _OTHER_SCALARS:
                try:
                    return self.scalar(node)
                except (ValueError, LookupError):  # such as !!bool x, !!int ""
                    kind = "value" if node.tag.endswith("bool") else "number"
                    self._problem(line, path, f"this {kind} cannot be read")
                    return None
            case ScalarNode() if node.tag in _TEXT:
                if (text := joined(node.value)) is None:
                    self._problem(line, path, "half a character, as \\ud83d, is no text")
                elif self.folder is not None and _names_file(path):
                    return FileName(text, self.folder)
                return text
        self._problem(line, path, f"YAML tags such as {node.tag!r} mean nothing here")
        return None

    def _pairs(self, node: Any, path: KeyPath) -> Iterator[tuple[str, Any]]:
        first: dict[str, int] = {}
        for key, value in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, ScalarNode):
                self._problem(line, path, "a key must be a word, not a list or a mapping")
                continue
            here = (*path, key.value)
            if key.value in first:
                self._problem(line, here, f"this key is already given in line {first[key.value]}")
                continue
            first[key.value] = line
            self.lines[here] = line
            yield key.value, self.read(value, here)

    def _problem(self, line: int, path: KeyPath, *words: str) -> None:
        self.problems.append(CaseProblem(self.file, line, dotted(path), *words))


FROM = "from"
#: With ``LAW`` the keys that say what kind of mapping it is; another kind takes nothing over.
_TYPE, _SHAPE = "type", "shape"
_ABSENT = "there is nothing here to take out"


def resolved_document(path: Path, fabric: Path | None = None) -> Document:
    """Return the contents of a case file with all that it takes over from others.

    Mappings are merged key by key, everything else is replaced, and null takes a key out.

    Args:
        path: The case file.
        fabric: A file that is laid over it, as the last one of a list after ``from`` would be.

    Raises:
        CaseError: A file cannot be read, or what they say does not fit together.
    """
    case = _resolved(path, ())
    if fabric is None:
        return case
    both = _merged(case, _resolved(fabric, ()))
    return replace(both, file=case.file, places={**both.places, (): case.places[()]})


def _resolved(path: Path, below: tuple[Path, ...]) -> Document:
    """Return a file over those that it starts from; ``below`` start from it and may not return."""
    document, below = read_document(path), (*below, path.resolve())
    if not isinstance(document.data, dict) or FROM not in document.data:
        return document
    bases = [_resolved(base, below) for base in _bases_of(document, path, below)]
    upper = {key: value for key, value in document.data.items() if key != FROM}
    return reduce(_merged, (*bases, replace(document, data=upper)))


def _bases_of(document: Document, path: Path, known: tuple[Path, ...]) -> list[Path]:
    """Return the files that a document starts from; ``known`` are those that may not return."""
    given = document.data[FROM]
    if not isinstance(given, list):
        return [_base_of(document, given, (FROM,), path.parent, known)]
    if not given:
        what = "the list is empty"
        raise CaseError([document.problem((FROM,), what, "Name a case file, or several.")])
    names = enumerate(given)
    return [_base_of(document, name, (FROM, i), path.parent, known) for i, name in names]


def _base_of(
    document: Document, name: Any, key: KeyPath, folder: Path, known: tuple[Path, ...]
) -> Path:
    """Return the file that is named at a key of a document in a folder."""
    try:
        base = existing_file(name, folder, (".yaml", ".yml"))
    except PydanticCustomError as error:
        raise CaseError([document.problem(key, *reason(error))]) from error
    if base in known:
        loop = " from ".join(file.name for file in (*known[known.index(base) :], base))
        raise CaseError([document.problem(key, f"this goes round in a circle: {loop}")])
    return folder / str(name)


def _merged(base: Document, upper: Document) -> Document:
    """Return ``upper`` laid over ``base``."""
    if wrong := [part for part in (base, upper) if not isinstance(part.data, dict)]:
        raise CaseError(part.problem((), "expected keys with values") for part in wrong)
    changes = list(_changes(base.data, upper.data))
    if absent := [c for c in changes if c[1] is None and c[0][-1] not in c[2]]:
        raise CaseError(
            upper.problem(p, "there is nothing here to take out", near_miss(p[-1], known))
            for p, _, known in absent
        )
    gone = {path for path, *_ in changes}
    kept = {
        path: place
        for path, place in base.places.items()
        if path not in upper.places and not any(path[:n] in gone for n in range(len(path)))
    }
    return replace(upper, data=_laid_over(base.data, upper.data), places={**upper.places, **kept})


def _changes(
    base: Mapping[str, Any], upper: Mapping[str, Any], above: KeyPath = ()
) -> Iterator[tuple[KeyPath, Any, Mapping[str, Any]]]:
    """Yield what a mapping changes in the one below it: where, the new value, the old mapping."""
    for key, new in upper.items():
        if _merge(base.get(key), new):
            yield from _changes(base[key], new, (*above, key))
        else:
            yield (*above, key), new, base


def _laid_over(base: Mapping[str, Any], upper: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping with what another one changes in it."""
    new = {k: _laid_over(base[k], v) if _merge(base.get(k), v) else v for k, v in upper.items()}
    return {k: v for k, v in {**base, **new}.items() if k not in upper or v is not None}


def _merge(base: Any, upper: Any) -> bool:
    """Return whether a value is merged with the one below it, rather than put in its place."""
    if not isinstance(base, dict) or not isinstance(upper, dict):
        return False
    other_kind = FILE in upper if FILE not in base else _SHAPE in upper
    if other_kind and None not in upper.values():  # what takes keys out is merged
        return False
    same_law = upper.get(LAW, base.get(LAW)) == base.get(LAW)  # without one it is the usual one
    return same_law and (_TYPE not in base or base[_TYPE] == upper.get(_TYPE, base[_TYPE]))


def override(document: Document, text: str) -> Document:
    """Return the document with one value replaced, by ``dotted.key=value`` with the value in YAML.

    ``null`` takes the key out.

    Raises:
        CaseError: The text is malformed, or the key leads through a plain value.
    """
    key, equals, value = text.partition("=")
    path = key_path(key)
    if not equals or "" in path:
        remedy = "For example --set time.steps_per_cycle=160."
        raise case_error(OVERRIDE, f"expected 'key=value', got {text!r}", remedy)
    try:
        given = parse_document(value if value.strip() else "null", OVERRIDE)
    except CaseError as error:
        raise CaseError(replace(p, line=None, key=key.strip()) for p in error.problems) from error
    path = _without_index(path, document.data)
    data = _with(document.data, path, given.data)
    places = {p: at for p, at in document.places.items() if p[: len(path)] != path}
    paths = [path[:n] for n in range(1, len(path))] + [path + p for p in given.places]
    return replace(
        document, data=data, places=dict.fromkeys(paths, SourceLine(OVERRIDE, None)) | places
    )


def _without_index(path: KeyPath, data: Any) -> KeyPath:
    """Return a path less what counts the only item of a list whose brackets are left out."""
    found: KeyPath = ()
    for part, after in zip_longest(path, path[1:]):
        if part == 0 and isinstance(data, dict) and "0" not in data and after in data:
            continue
        found = (*found, part)
        if isinstance(data, dict):
            data = data.get(str(part))
        elif isinstance(data, list) and isinstance(part, int) and part < len(data):
            data = data[part]
    return found


def _with(data: Any, path: KeyPath, value: Any, above: KeyPath = ()) -> Any:
    """Return ``data`` with the value at ``path`` below ``above`` replaced, taken out if None."""
    first, *rest = path
    here = (*above, first)
    if isinstance(data, list):
        if not isinstance(first, int) or first >= len(data):
            raise _no_place(here, f"a list of {len(data)}, counted from 0")
        new = _with(data[first], tuple(rest), value, here) if rest else value
        return [*data[:first], new, *data[first + 1 :]]
    if not isinstance(data, dict | None):
        raise _no_place(here, "a plain value")
    others = {k: v for k, v in (data or {}).items() if k != str(first)}
    if not rest and value is None:
        return others
    old = (data or {}).get(str(first))
    return others | {str(first): _with(old, tuple(rest), value, here) if rest else value}


def _no_place(path: KeyPath, holder: str) -> CaseError:
    above = dotted(path[:-1]) or "the case"
    return case_error(OVERRIDE, f"there is no such key, for {above} is {holder}", key=dotted(path))
