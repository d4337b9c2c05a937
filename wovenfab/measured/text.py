"""The text of a measured file, whatever its encoding."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from wovenfab.case.errors import case_error

#: Largest file (bytes).
LARGEST = 50_000_000
#: First bytes of files that are no text, and what they are.
OTHERS = {
    b"PK\x03\x04": "a workbook (XLSX, ODS) or an archive",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook (XLS)",
    b"%PDF": "a PDF",
}
#: Marks of an encoding at the start of a file; those of UTF-32 begin with those of UTF-16.
MARKS = {
    b"\xff\xfe\0\0": "utf-32",
    b"\0\0\xfe\xff": "utf-32",
    b"\xff\xfe": "utf-16",
    b"\xfe\xff": "utf-16",
    b"\xef\xbb\xbf": "utf-8-sig",
}
#: Share of zero bytes in every second place above which a file without a mark is UTF-16.
ZEROS = 0.7


@dataclass(frozen=True)
class DecodedText:
    """The lines of a file.

    Attributes:
        lines: All lines; the first one has the number 1.
        encoding: How they were decoded.
        cut: Whether the last line has no end, as in a file whose writing was interrupted.
    """

    lines: tuple[str, ...]
    encoding: str
    cut: bool


def read_text(path: Path) -> DecodedText:
    """Return the text of a file.

    Raises:
        CaseError: It cannot be read, is too large or is no text.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
        if len(raw) > LARGEST:
            raise case_error(str(path), "this is too large for a measured file (more than 50 MB)")
    except OSError as error:
        raise case_error(str(path), f"the file cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise case_error(str(path), "the file cannot be read: its name is not possible") from error
    for start, kind in OTHERS.items():
        if raw.startswith(start):
            remedy = "Save the table as CSV (in Excel: Save As, CSV UTF-8), and name that file."
            raise case_error(str(path), f"this is not text, but {kind}", remedy)
    encoding = _encoding(raw)
    text = raw.decode(encoding, errors="replace").lstrip("\ufeff")
    if "\0" in text:
        remedy = "Export it as text, such as CSV: spreadsheets and machines can."
        raise case_error(str(path), "this is not text", remedy)
    if not text.strip():
        raise case_error(str(path), "the file is empty")
    lines = re.split(r"\r\n|\n|\r", text)
    cut = bool(lines[-1].strip())
    return DecodedText(tuple(lines), encoding, cut)


def _encoding(raw: bytes) -> str:
    for mark, encoding in MARKS.items():
        if raw.startswith(mark):
            return encoding
    for first, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        half = raw[first::2]
        if half and half.count(0) > ZEROS * len(half):
            return encoding
    for encoding in ("utf-8", "cp1252"):
        try:
            raw.decode(encoding)
        except UnicodeDecodeError:
            continue
        return encoding
    return "latin-1"
