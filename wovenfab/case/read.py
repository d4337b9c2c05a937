"""Case files in, case files out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import reduce
from io import StringIO
from pathlib import Path
from typing import Annotated, Any

from pydantic import TypeAdapter, ValidationError
from pydantic.json_schema import GenerateJsonSchema
from ruamel.yaml import YAML

from forms.effect import Effect

from .derived import FROM, resolved_document
from .document import Document
from .effects import own_schemas
from .overrides import override
from .own_effects import OwnEffect, own_effects
from .problems import CaseError, Problem
from .rules import findings
from .schema import Case, possible_fields
from .sheet import Rectangle
from .translate import problems_in

_FROM_SCHEMA = {
    "type": "string",
    "description": "Case file to start from, relative to this one, which says what differs.",
    "examples": ["base.yaml"],
}


def read_case(path: Path, overrides: Sequence[str] = ()) -> Case:
    """Return the case that a file describes.

    Args:
        path: A YAML file.
        overrides: Values that replace those of the file, ``"effects.shear.stiffness=500 N/m"``.

    Returns:
        The case in SI units, all defaults filled in.

    Raises:
        CaseError: With everything that was found wrong.
    """
    document = _document(path, overrides)
    own = own_effects(document.data, path.parent)
    context = {"folder": path.parent, "name": path.stem, "own": own}
    try:
        case = Case.model_validate(document.data, context=context)
    except ValidationError as error:
        effects = [e.effect for e in own.values() if isinstance(e, OwnEffect)]
        found = list(problems_in(error, document, json_schema(effects)))
        found += _combinations(_valid_sections(document.data, context), document)
        raise CaseError(document.in_order(found)) from error
    if found := list(_combinations({k: getattr(case, k) for k in Case.model_fields}, document)):
        raise CaseError(document.in_order(found))
    return _with_defaults(case)


def case_data(path: Path, overrides: Sequence[str] = ()) -> Any:
    """Return what a case file says with all that it takes over, as it is written there.

    Args:
        path: The case file.
        overrides: As given to :func:`read_case`.

    Raises:
        CaseError: A file cannot be read.
    """
    return _document(path, overrides).data


def problem_at(
    path: Path, overrides: Sequence[str], key: str, message: str, remedy: str = ""
) -> Problem:
    """Return a problem that was found later, with the line of its key.

    Args:
        path: The case file.
        overrides: As given to :func:`read_case`.
        key: Dotted key.
        message: What is wrong, without a full stop.
        remedy: What would be right.
    """
    parts = tuple(int(k) if k.isdecimal() else k for k in key.split("."))
    return _document(path, overrides).problem(parts, message, remedy)


def json_schema(own: Sequence[Effect] = ()) -> dict[str, Any]:
    """Return the JSON Schema of a whole case.

    Args:
        own: The user's own effects, to be described beside those of forms/.
    """
    schema = Case.model_json_schema(schema_generator=_InOrder)
    schema["properties"] = {FROM: _FROM_SCHEMA} | schema["properties"]
    schema["$defs"]["Effects"]["properties"] |= own_schemas(own)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema


def dump_case(case: Case) -> str:
    """Return a case as YAML that reads as an equal case, with units and every default."""
    yaml: Any = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False
    yaml.width = 100
    stream = StringIO()
    left: Any = {} if case.accuracy is None else CHOSEN
    yaml.dump(case.model_dump(mode="json", by_alias=True, exclude_none=True, exclude=left), stream)
    return stream.getvalue()


#: What is found by the program, and not said by the case, where an accuracy is asked for.
CHOSEN = {"discretisation": {"degree", "mesh_size"}, "time": {"steps_per_cycle", "tolerance"}}


class _InOrder(GenerateJsonSchema):
    """Keeps the keys in the order in which they are best read."""

    def sort(self, value: Any, parent_key: str | None = None) -> Any:
        """Return the value as it is."""
        return value


def _document(path: Path, overrides: Sequence[str]) -> Document:
    return reduce(override, overrides, resolved_document(path))


def _combinations(sections: dict[str, Any], document: Document) -> Iterator[Problem]:
    for location, message, remedy in findings(sections):
        yield document.problem(document.locate(location), message, remedy)


#: Cells across a rectangle unless the case says more: along the fibres few are enough.
CELLS = {"fibres": 4, "crossed": 10, "right": 10, "unstructured": 10}


def _valid_sections(data: Any, context: dict[str, Any]) -> dict[str, Any]:
    """Return the sections that are valid by themselves."""
    sections = {}
    for name, field in Case.model_fields.items() if isinstance(data, dict) else ():
        key = field.alias or name
        if key not in data:
            if not field.is_required():
                sections[name] = field.default
            continue
        more = tuple(field.metadata)
        kind: Any = Annotated[field.annotation, *more] if more else field.annotation
        with suppress(ValidationError):
            sections[name] = TypeAdapter(kind).validate_python(data[key], context=context)
    return sections


def _with_defaults(case: Case) -> Case:
    """Fill in what depends on other sections."""
    mesh, output = case.discretisation, case.output
    if isinstance(case.sheet, Rectangle):
        kind = mesh.mesh or "fibres"
        size = mesh.mesh_size or min(case.sheet.length, case.sheet.width) / CELLS[kind]
        mesh = mesh.model_copy(update={"mesh_size": size, "mesh": kind})
    if "fields" not in output.model_fields_set:
        output = output.model_copy(update={"fields": possible_fields(case.needs)})
    return case.model_copy(update={"discretisation": mesh, "output": output})
