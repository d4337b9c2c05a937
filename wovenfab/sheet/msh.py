"""Reads meshes that gmsh wrote (.msh, versions 2.2 and 4.1, as text and binary).

The file is data: nothing in it is executed, and no other file is opened. Format:
https://gmsh.info/doc/texinfo/gmsh.html#File-formats
"""

from __future__ import annotations

import re
import warnings
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wovenfab.sheet.errors import GeometryError
from wovenfab.sheet.file_mesh import Array, FileMesh, Group, Rows

#: How a file begins.
HEAD = b"$MeshFormat"
#: Nodes of an element of each type.
NODES = {
    1: 2, 2: 3, 3: 4, 4: 4, 5: 8, 6: 6, 7: 5, 8: 3, 9: 6, 10: 9, 11: 10, 12: 27, 13: 18, 14: 14,
    15: 1, 16: 8, 17: 20, 18: 15, 19: 13, 20: 9, 21: 10, 22: 12, 23: 15, 24: 15, 25: 21, 26: 4,
    27: 5, 28: 6, 29: 20, 30: 35, 31: 56, 36: 16, 37: 25, 38: 36, 62: 7, 63: 8, 64: 9, 65: 10,
    66: 11, 92: 64, 93: 125,
}  # fmt: skip
#: Types of lines, triangles and quadrilaterals; their corners come first.
LINES = {1, 8, 26, 27, 28, 62, 63, 64, 65, 66}
TRIANGLES = {2, 9, 20, 21, 22, 23, 24, 25}
QUADRILATERALS = {3, 10, 16, 36, 37, 38}
#: Kinds of whole numbers: int and size_t of C.
Kind = Literal["i", "s"]
REMEDY = "write it anew: gmsh FILE.geo -2 -format msh41 -o FILE.msh"
#: Bytes that are read at a time to find a section.
CHUNK = 1 << 20


def read_msh(path: Path) -> FileMesh:
    """Return what is in a mesh file.

    Args:
        path: The file.

    Raises:
        GeometryError: It cannot be read, or is no whole mesh of a known version.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise GeometryError(f"cannot be read: {error.strerror}") from error
    sections = _sections(data)
    form = _Format.of(sections)
    groups = _names(sections.get("PhysicalNames", b""))
    tags, points = form.nodes(sections)
    order = np.argsort(tags, kind="stable")
    if len(tags) and (np.diff(tags[order]) == 0).any():
        raise _broken("Nodes", "has two nodes of the same number")
    if not np.isfinite(points).all():
        raise _broken("Nodes", "has a coordinate that is not a number")
    cells: dict[tuple[int, int], list[Rows]] = defaultdict(list)
    members: dict[tuple[int, int], set[int]] = defaultdict(set)
    other = False
    for block in form.elements(sections):
        dim = 1 if block.kind in LINES else 2
        other |= block.kind in QUADRILATERALS
        if block.kind in LINES | TRIANGLES:
            cells[dim, block.entity].append(_rows(tags, order, block.nodes[:, : dim + 1]))
        if block.kind in LINES | TRIANGLES | QUADRILATERALS:
            for group in block.groups:
                members[dim, group].add(block.entity)
    curves, surfaces = (
        {e: _once(parts) for (d, e), parts in sorted(cells.items()) if d == dim} for dim in (1, 2)
    )
    lines, areas = (
        tuple(
            Group(groups.get((dim, number), ""), tuple(sorted(entities)))
            for (d, number), entities in sorted(members.items())
            if d == dim
        )
        for dim in (1, 2)
    )
    return FileMesh(points, curves, surfaces, lines, areas, other)


def stated_points(path: Path) -> int:
    """Return how many points a mesh says it has, or 0 if its head does not tell.

    Only the part of the file before its nodes is read.
    """
    start, mark = b"", b"\n$Nodes"
    with path.open("rb") as file:
        if not (start := file.readline(80)).startswith(HEAD):
            return 0
        form = file.readline(80).split()
        start = b""
        while mark not in start:
            if not (more := file.read(CHUNK)):
                return 0
            start = start[-len(mark) :] + more
        head = start.partition(mark)[2].lstrip(b"\r") + file.read(80)
    content = head.partition(b"\n")[2]
    if form[:2] == [b"4.1", b"1"]:
        return int(np.frombuffer(content, "u8", 2)[1]) if len(content) >= 16 else 0
    numbers = content.split(b"\n")[0].split()[:2]  # blocks and points; points in version 2
    return int(numbers[-1]) if numbers and numbers[-1].isdigit() else 0


@dataclass(frozen=True)
class _Block:
    """Elements of one type and entity: their nodes by number, and their physical groups."""

    kind: int
    entity: int
    groups: tuple[int, ...]
    nodes: Rows


class _Numbers:
    """The numbers of a section, one after the other."""

    def __init__(self, name: str, content: bytes, binary: str) -> None:
        """Begin.

        Args:
            name: Of the section.
            content: All of it.
            binary: The order of bytes, as numpy names it, or nothing if it is text.
        """
        self.name, self._content, self._at = name, content, 0
        self._types = {"i": f"{binary}i4", "s": f"{binary}i8", "d": f"{binary}f8"}
        self._text: Array | None = None if binary else _parsed(name, content)

    def reals(self, count: int) -> Array:
        """Return the next real numbers, shape (count,)."""
        return self._next("d", count).astype(np.float64)

    def integers(self, kind: Kind, count: int) -> Rows:
        """Return the next whole numbers of a kind, shape (count,)."""
        part = self._next(kind, count)
        exact = self._text is None or (np.abs(part) < 2.0**53).all()
        if not exact or (part != np.round(part)).any():
            raise _broken(self.name, "has a number that must be whole, and is not")
        return part.astype(np.int64)

    def _next(self, kind: str, count: int) -> NDArray[Any]:
        if self._text is not None:
            left, size = len(self._text) - self._at, 1
        else:
            size = np.dtype(self._types[kind]).itemsize
            left = (len(self._content) - self._at) // size
        if not 0 <= count <= left:
            raise _broken(self.name, "is cut short, or states wrong numbers of what it has")
        start, self._at = self._at, self._at + count * size
        if self._text is None:
            return np.frombuffer(self._content, self._types[kind], count, start)
        return self._text[start : self._at]

    def whole(self, kind: Kind, count: int = 1) -> list[int]:
        """Return the next whole numbers."""
        return [int(number) for number in self.integers(kind, count)]

    def rest(self) -> NDArray[np.int64]:
        """Return all that is left, whole numbers."""
        if self._text is not None:
            return self.integers("i", len(self._text) - self._at)
        return self.integers("i", (len(self._content) - self._at) // 4)

    def records(self, kind: np.dtype[np.void], count: int) -> NDArray[np.void]:
        """Return the next records of a binary section."""
        if count * kind.itemsize > len(self._content) - self._at:
            raise _broken(self.name, "is cut short, or states wrong numbers of what it has")
        start, self._at = self._at, self._at + count * kind.itemsize
        return np.frombuffer(self._content, kind, count, start)

    def line(self) -> int:
        """Return the number in the first line, which is text in any file of version 2."""
        first, _, rest = self._content.partition(b"\n")
        if self._text is not None:
            return self.whole("s")[0]
        if not first.strip().isdigit():
            raise _broken(self.name, "does not begin with a number")
        self._content = rest
        return int(first)

    def end(self) -> None:
        """Refuse what is left over."""
        left = self._content[self._at :].strip() if self._text is None else self._text[self._at :]
        if len(left):
            raise _broken(self.name, "has more than it says")


@dataclass(frozen=True)
class _Format:
    """The version of a file and its order of bytes, as numpy names it; none for text."""

    version: str
    binary: str

    @classmethod
    def of(cls, sections: dict[str, bytes]) -> _Format:
        head, _, rest = sections["MeshFormat"].lstrip().partition(b"\n")
        words = head.decode("latin-1").split()
        version, kind, size = (*words, "", "", "")[:3]
        if version not in ("2.2", "4.1") or kind not in ("0", "1") or size != "8":
            known = f"its version is {version!r}, and 2.2 and 4.1 can be read"
            raise GeometryError(f"{known}; {REMEDY}")
        if kind == "0":
            return cls(version, "")
        orders = {(1).to_bytes(4, "little"): "<", (1).to_bytes(4, "big"): ">"}
        if (order := orders.get(rest[:4])) is None:
            raise _broken("MeshFormat", "does not tell the order of bytes")
        return cls(version, order)

    def numbers(self, sections: dict[str, bytes], name: str) -> _Numbers:
        """Return the numbers of a section that there must be."""
        if name not in sections:
            raise GeometryError(f"it has no section ${name}; {REMEDY}")
        return _Numbers(name, sections[name], self.binary)

    def nodes(self, sections: dict[str, bytes]) -> tuple[Rows, Array]:
        """Return the numbers of nodes, shape (n,), and their coordinates, shape (n, 3)."""
        values = self.numbers(sections, "Nodes")
        if self.version == "2.2":
            count = values.line()
            if self.binary:
                kind = np.dtype([("tag", f"{self.binary}i4"), ("x", f"{self.binary}f8", 3)])
                found = values.records(kind, count)
                values.end()
                return found["tag"].astype(np.int64), found["x"].astype(np.float64)
            rows = values.reals(4 * count).reshape(-1, 4)
            values.end()
            return rows[:, 0].astype(np.int64), rows[:, 1:]
        tags: list[Rows] = [np.zeros(0, np.int64)]
        points: list[Array] = [np.zeros((0, 3))]
        blocks, *_ = values.whole("s", 4)
        for _ in range(blocks):
            dim, _, parametric = values.whole("i", 3)
            (count,) = values.whole("s")
            tags.append(values.integers("s", count))
            width = 3 + (dim if parametric else 0)
            points.append(values.reals(width * count).reshape(-1, width)[:, :3])
        values.end()
        return np.concatenate(tags), np.concatenate(points)

    def elements(self, sections: dict[str, bytes]) -> Iterator[_Block]:
        """Yield the elements, those of one type and entity together."""
        values = self.numbers(sections, "Elements")
        if self.version == "2.2":
            yield from _elements_2(values, is_binary=bool(self.binary))
            return
        groups = self._groups(sections)
        blocks, *_ = values.whole("s", 4)
        for _ in range(blocks):
            dim, entity, kind = values.whole("i", 3)
            (count,) = values.whole("s")
            width = 1 + _nodes_of(kind)
            rows = values.integers("s", width * count).reshape(-1, width)
            yield _Block(kind, entity, groups.get((dim, entity), ()), rows[:, 1:])
        values.end()

    def _groups(self, sections: dict[str, bytes]) -> dict[tuple[int, int], tuple[int, ...]]:
        """Return the physical groups of each entity, given by dimension and number."""
        if "Entities" not in sections:
            return {}
        values = self.numbers(sections, "Entities")
        groups = {}
        for dim, count in enumerate(values.whole("s", 4)):
            for _ in range(count):
                (number,) = values.whole("i")
                values.reals(6 if dim else 3)
                found = values.whole("i", values.whole("s")[0])
                groups[dim, number] = tuple(abs(group) for group in found)
                if dim:
                    values.integers("i", values.whole("s")[0])
        values.end()
        return groups


def _elements_2(values: _Numbers, is_binary: bool) -> Iterator[_Block]:
    """Yield the elements of version 2.2, which name their physical group and entity.

    A text has number, type, tags and nodes of each. A binary section has blocks: type, count and
    number of tags, and then number, tags and nodes of each.
    """
    left, numbers, at = values.line(), values.rest(), 0
    together = 1  # elements that are read at once: twice as many as long as they are alike
    words = slice(0, 3) if is_binary else slice(1, 3)
    found: dict[tuple[int, int, int], list[Rows]] = defaultdict(list)
    while left > 0:
        head = numbers[at : at + 3]
        if len(head) < 3 or not 2 <= head[2] <= len(numbers) or (is_binary and head[1] < 1):
            raise _broken("Elements", "is cut short, or has elements without physical groups")
        kind, tags = int(head[words][0]), int(head[2])
        each = tags + _nodes_of(kind) + is_binary
        width = 3 + each * (int(head[1]) if is_binary else 1)
        blocks = numbers[at : at + min(together, (len(numbers) - at) // width) * width]
        blocks = blocks.reshape(-1, width)
        same = (blocks[:, words] == head[words]).all(axis=1)
        count = len(blocks) if same.all() else int(same.argmin())
        together = 2 * together if count == len(blocks) else 1
        rows = blocks[:count, 3:].reshape(-1, each)[:, int(is_binary) :]
        if not 0 < len(rows) <= left:
            raise _broken("Elements", "is cut short, or states a wrong number of elements")
        at, left = at + count * width, left - len(rows)
        for pair in np.unique(rows[:, :2], axis=0):
            own = (rows[:, :2] == pair).all(axis=1)
            found[kind, abs(int(pair[0])), int(pair[1])].append(rows[own, tags:])
    if at < len(numbers):
        raise _broken("Elements", "has more than it says")
    for (kind, group, entity), parts in found.items():
        yield _Block(kind, entity, (group,) if group else (), np.concatenate(parts))


def _sections(data: bytes) -> dict[str, bytes]:
    """Return the content of each section by its name; of two with one name, the first."""
    if not data.startswith(HEAD):
        begins = data[:20].decode("latin-1")
        raise GeometryError(f"it is no mesh of gmsh: it begins with {begins!r}; {REMEDY}")
    sections: dict[str, bytes] = {}
    at = 0
    while (start := data.find(b"$", at)) >= 0:
        line, _, _ = data[start : start + 80].partition(b"\n")
        name = line[1:].strip().decode("latin-1")
        begin = start + len(line) + 1
        end = data.find(b"$End" + name.encode("latin-1"), begin)
        if not name or end < 0:
            raise _broken(name, "has no end: the file is cut short")
        sections.setdefault(name, data[begin:end])
        at = end + len(name) + 4
    return sections


def _names(content: bytes) -> dict[tuple[int, int], str]:
    """Return the name of each physical group, by dimension and number."""
    text = content.decode("utf-8", errors="replace")
    found = re.findall(r'^\s*(\d{1,9})\s+(\d{1,9})\s+"(.*)"\s*$', text, re.MULTILINE)
    return {(int(dim), int(number)): name for dim, number, name in found}


def _parsed(name: str, content: bytes) -> Array:
    """Return the numbers of a section in text."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)
            return np.asarray(np.fromstring(content.decode("latin-1"), np.float64, sep=" "))
    except (DeprecationWarning, ValueError) as error:
        raise _broken(name, "has something that is not a number") from error


def _nodes_of(kind: int) -> int:
    if kind not in NODES:
        raise _broken("Elements", f"has elements of type {kind}, which is not known")
    return NODES[kind]


def _rows(tags: Rows, order: Rows, wanted: Rows) -> Rows:
    """Return the rows of nodes that are given by their numbers."""
    places = np.minimum(np.searchsorted(tags[order], wanted), max(len(tags) - 1, 0))
    if not len(tags) or (tags[order][places] != wanted).any():
        raise _broken("Elements", "has an element with a node that is not there")
    return np.asarray(order[places])


def _once(parts: list[Rows]) -> Rows:
    """Return elements that stand in several physical groups once."""
    if len(parts) == 1:
        return parts[0]
    rows = np.concatenate(parts)
    _, first = np.unique(np.sort(rows, axis=1), axis=0, return_index=True)
    return np.asarray(rows[np.sort(first)])


def _broken(section: str, what: str) -> GeometryError:
    return GeometryError(f"its section ${section} {what}; {REMEDY}")
