"""Texts from outside, such as titles, paths and names, as a terminal or a picture may have them."""

from __future__ import annotations

import unicodedata

#: Characters that a text may have although they control the output.
_LAYOUT = "\n\t"
#: Control characters, surrogates, and separators of lines and paragraphs.
_CONTROLS = {"Cc", "Cs", "Zl", "Zp"}
#: Characters that turn the direction of the text after them.
_TURNS = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}


def is_printable(character: str) -> bool:
    """Return whether a character shows as itself and changes nothing else on a terminal."""
    return (
        unicodedata.category(character) not in _CONTROLS
        and unicodedata.bidirectional(character) not in _TURNS
    )


def printable(text: str) -> str:
    r"""Return a text in which control characters are spelled out, ESC as ``\x1b``.

    Line ends and tabulators stay.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        c if c in _LAYOUT or is_printable(c) else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


def one_line(text: str) -> str:
    """Return a text as :func:`printable` does, with line ends and tabulators as single spaces."""
    return printable(" ".join(text.split()))


def in_brief(error: BaseException) -> str:
    """Return the kind of an error and what it says in one line."""
    text = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(":.")
    return text if len(text) <= 200 else f"{text[:197]}..."
