"""The keys of a case file in Markdown, from the schema that checks them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

Schema = Mapping[str, Any]
#: Sections that are known by another title than their name, in the order of the page.
TITLES = {
    "Rectangle": "sheet: a rectangle",
    "SheetFile": "sheet: any shape",
    "EdgeCondition": "boundary: an edge",
    "Cycles": "program: cycles",
    "Ramp": "program: ramp",
    "Hold": "program: hold",
    "Table": "program: table",
}
_BOUNDS = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to"}
_PLAIN = {"string": "text", "integer": "a whole number", "boolean": "`true`, `false`"}


class CaseKeys:
    """Writes tables of keys.

    Args:
        schema: The JSON Schema of a whole case. The effects have a page of their own.
    """

    def __init__(self, schema: Schema) -> None:
        """Take the schema."""
        self._schema, self._sections = schema, schema["$defs"]

    def page(self) -> str:
        """Return a table for the case and for each of its sections."""
        parts = ["## The case\n", *self._table(schema=self._schema)]
        names = [name for name in self._sections if name[0].isupper() and name != "Effects"]
        for name in sorted(names, key=lambda n: [*TITLES, n].index(n)):
            section = self._sections[name]
            parts += [f"\n## {_title(name)}\n", _sentence(section.get("description", "")), ""]
            parts += self._table(section)
        return "\n".join(parts) + "\n"

    def _table(self, schema: Schema) -> Iterator[str]:
        """Yield the rows of a section; of one that may be written shorter its richest form."""
        forms = [form for form in schema.get("anyOf", [schema]) if "properties" in form]
        yield "| key | value | default | meaning |\n|---|---|---|---|"
        keys = {key: value for form in forms for key, value in form["properties"].items()}
        for key, value in keys.items():
            required = all(key in form.get("required", ()) for form in forms)
            default = "required" if required else _default(value.get("default"))
            section = self._sections.get(value.get("$ref", "").rpartition("/")[2], {})
            words = value.get("description") or section.get("description", "")
            cells = (f"`{key}`", self._value(value), default, _sentence(words))
            yield "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"

    def _value(self, schema: Schema) -> str:
        """Return in words what a value may be."""
        if "$ref" in schema:
            return _link(schema["$ref"].rpartition("/")[2])
        if "enum" in schema or "const" in schema:
            words = schema.get("enum") or [schema["const"]]
            return ", ".join(f"`{str(word).lower()}`" for word in words)
        if choices := schema.get("anyOf") or schema.get("oneOf"):
            return self._one_of([c for c in choices if c.get("type") != "null"])
        if schema.get("type") == "array":
            items = schema.get("prefixItems")
            return f"[a, b], each {self._value(items[0])}" if items else self._list(schema)
        if isinstance(several := schema.get("additionalProperties"), dict):
            return f"names with {self._value(several)}"
        return _plain(schema)

    def _list(self, schema: Schema) -> str:
        return f"a list of {self._value(schema['items'])}"

    def _one_of(self, choices: list[Schema]) -> str:
        words = [self._value(choice) for choice in choices]
        if len(words) == 2 and words[1] == f"a list of {words[0]}":
            return f"{words[0]}, or a list of such"
        return ", or ".join(dict.fromkeys(words))


def _plain(schema: Schema) -> str:
    kind, words = schema.get("type"), schema.get("description", "")
    if words.endswith(".") or "title" in schema or not words:  # the key's meaning, not the value's
        words = _PLAIN.get(str(kind), "a mapping" if kind == "object" else "a plain number")
    words = re.sub(r"^'(.*?)'", r"text such as `\1`", words)
    return words + "".join(f" {w} {schema[k]:,}" for k, w in _BOUNDS.items() if k in schema)


def _default(value: Any) -> str:
    if value is None or value == "" or isinstance(value, dict):
        return ""
    if isinstance(value, list):
        return "all" if len(value) > 2 else f"[{', '.join(map(str, value))}]"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{value:.4g}`" if isinstance(value, float) else f"`{value}`"


def _title(name: str) -> str:
    return TITLES.get(name) or re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()


def _link(name: str) -> str:
    if name == "Effects":
        return "[effects](../parameters.md)"
    anchor = re.sub(r"[^\w\- ]", "", _title(name)).replace(" ", "-")
    return f"[{_title(name)}](#{anchor})"


def _sentence(words: str) -> str:
    """Return words in one line, with a capital and a full stop."""
    line = " ".join(words.split()).rstrip(".")
    return f"{line[:1].upper()}{line[1:]}." if line else ""
