"""YAML text to plain data that remembers where each value was written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, NamedTuple

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode

from .files import FILE, FileName
from .problems import CaseError, Path, Problem, dotted, refusal

_LARGEST_FILE = 1_000_000
_DEEPEST = 20
_MOST_VALUES = 100_000
_TEXT = ("tag:yaml.org,2002:str", "tag:yaml.org,2002:timestamp")
_OTHER_SCALARS = tuple(f"tag:yaml.org,2002:{t}" for t in ("int", "float", "bool", "null"))


class Place(NamedTuple):
    """Where a value was written.

    Attributes:
        file: The file as the user named it, or ``--set``.
        line: Line of the file, from 1; None for ``--set``.
    """

    file: str
    line: int | None


@dataclass(frozen=True)
class Document:
    """Plain data (dict, list, str, int, float, bool, None) and its origin.

    Attributes:
        data: What the text says.
        file: The file as the user named it.
        places: Where each value was written, by its path; that may be another file.
    """

    data: Any
    file: str
    places: Mapping[Path, Place]

    def locate(self, location: Path, missing: bool = False) -> Path:
        """Return the path in the data of a place in the case.

        The place may also name which form of a section was meant (``"cycles"``) and
        count items of a list whose brackets were left out; these are passed over.

        Args:
            location: Place in the case.
            missing: Whether the last key is not there, and is kept all the same.
        """
        path: list[str | int] = []
        data = self.data
        for i, part in enumerate(location):
            if _holds(data, part):
                data = data[part]
            elif not (missing and i == len(location) - 1):
                continue
            path.append(part)
        return tuple(path)

    def problem(self, path: Path, message: str, remedy: str = "") -> Problem:
        """Return the problem of the value at ``path``, or of what should hold it."""
        holders = (path[:n] for n in range(len(path), -1, -1))
        known = next((self.places[p] for p in holders if p in self.places), Place(self.file, None))
        return Problem(*known, dotted(path), message, remedy)

    def in_order(self, problems: Iterable[Problem]) -> list[Problem]:
        """Return problems in the order in which this case is read: by file, then by line."""
        files = list(dict.fromkeys(place.file for place in self.places.values()))
        return sorted(problems, key=lambda p: (files.index(p.file), p.line) if p.line else (-1, 0))


def read_document(path: FilePath) -> Document:
    """Return the contents of a YAML file.

    Raises:
        CaseError: The file cannot be read or is not plain YAML.
    """
    return parse_document(_text_of(path), str(path), path.parent)


def parse_document(text: str, file: str, folder: FilePath | None = None) -> Document:
    """Return what YAML text says, as :func:`read_document` does.

    Args:
        text: The YAML.
        file: Where it is from, for messages.
        folder: What the files that it names are relative to; the case's folder if None.
    """
    try:
        root = YAML(typ="safe", pure=True).compose(text)
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        said = ", ".join(filter(None, (error.context, error.problem)))
        raise refusal(file, f"this is not valid YAML: {said}", "", line) from error
    except YAMLError as error:
        raise refusal(file, "this is not text: it has control characters in it") from error
    except RecursionError as error:
        raise refusal(file, "lists or mappings are nested too deeply") from error
    if root is None:
        raise refusal(file, "the file is empty", "Start from one of those in configs/.")
    reader = _Reader(file, folder)
    data = reader.read(root, ())
    if reader.problems:
        raise CaseError(reader.problems)
    return Document(data, file, {path: Place(file, line) for path, line in reader.lines.items()})


def _holds(data: Any, part: str | int) -> bool:
    if isinstance(data, list):
        return part in range(len(data))
    return isinstance(data, dict) and part in data


def _text_of(path: FilePath) -> str:
    try:
        if path.is_dir():
            raise refusal(str(path), "this is a folder", "Name the case file in it.")
        if not path.is_file():
            what = "this is not an ordinary file" if path.exists() else "there is no such file"
            raise refusal(str(path), what)
        if path.stat().st_size > _LARGEST_FILE:
            raise refusal(str(path), "this is too large to be a case file (more than 1 MB)")
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = path.read_bytes()[: error.start].count(b"\n") + 1
        raise refusal(
            str(path), "this is not UTF-8 text", "Save the file in UTF-8.", line
        ) from error
    except OSError as error:
        raise refusal(str(path), f"the file cannot be read: {error.strerror}") from error


class _Reader:
    """Walks the nodes of one document."""

    def __init__(self, file: str, folder: FilePath | None) -> None:
        self.file, self.folder = file, folder
        self.scalar = YAML(typ="safe", pure=True).constructor.construct_object
        self.lines: dict[Path, int] = {}
        self.problems: list[Problem] = []

    def read(self, node: Any, path: Path) -> Any:
        line = node.start_mark.line + 1
        self.lines.setdefault(path, line)
        # An alias is read where it stands, and may even lead back to itself.
        if len(path) > _DEEPEST or len(self.lines) > _MOST_VALUES:
            raise refusal(self.file, "lists or mappings are nested too deeply", "", line)
        match node:
            case MappingNode():
                return dict(self._pairs(node, path))
            case SequenceNode():
                return [self.read(item, (*path, i)) for i, item in enumerate(node.value)]
            case ScalarNode() if node.tag in _OTHER_SCALARS:
                try:
                    return self.scalar(node)
                except ValueError:
                    self._problem(line, path, "this number cannot be read")
                    return None
            case ScalarNode() if node.tag in _TEXT:
                if self.folder is not None and path[-1:] == (FILE,):
                    return FileName(node.value, self.folder)
                return node.value
        self._problem(line, path, f"YAML tags such as {node.tag!r} mean nothing here")
        return None

    def _pairs(self, node: Any, path: Path) -> Iterator[tuple[str, Any]]:
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

    def _problem(self, line: int, path: Path, message: str) -> None:
        self.problems.append(Problem(self.file, line, dotted(path), message))
