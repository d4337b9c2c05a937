"""The case: what a case file or a program says, validated and in SI units."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cache, reduce
from io import StringIO
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    PrivateAttr,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
)
from pydantic.json_schema import GenerateJsonSchema
from ruamel.yaml import YAML

from wovenfab import forms
from wovenfab.case.boundary import EdgeConditions
from wovenfab.case.checks import doubts, findings
from wovenfab.case.document import (
    FROM,
    Document,
    Places,
    existing_file,
    folder_of,
    override,
    paths_in,
    resolved_document,
)
from wovenfab.case.effects import (
    CustomEffect,
    CustomEffects,
    EffectsSection,
    Scene,
    Values,
    custom_files,
    custom_schemas,
    needs_of_scene,
    quantity,
)
from wovenfab.case.errors import CaseError, CaseProblem, KeyPath, key_path, problems_in
from wovenfab.case.program import SECOND, Segments, SegmentSection, TableSection, planned_steps
from wovenfab.case.quantities import OneOr, Quantity, Section, outside, plain, unusual
from wovenfab.case.schema import (
    Discretisation,
    Fabric,
    OutputSection,
    Rectangle,
    Sheet,
    Solver,
    Time,
    possible_fields,
)
from wovenfab.case.specimen import TestName
from wovenfab.forms.effect import Effect, Needs

#: Values that replace those of a case: "key=value" each, or values by dotted key.
Overrides = Sequence[str] | Mapping[str, Any]

#: Cells across a rectangle unless the case says more: along the fibres few are enough.
CELLS = {"fibres": 4, "crossed": 10, "right": 10, "unstructured": 10}
#: What the program chooses where an accuracy is asked for.
CHOSEN = {"discretisation": {"degree", "mesh_size"}, "time": {"steps_per_cycle", "tolerance"}}


#: Keys of sections whose values depend on other sections unless they are given.
_DERIVED = {"discretisation": ("mesh", "mesh_size"), "output": ("fields",)}


@dataclass(frozen=True)
class _Origin:
    """Where a case is from, which says nothing on whether two cases are equal."""

    places: Places = dataclass_field(compare=False)
    files: tuple[Path, ...] = dataclass_field(default=(), compare=False)
    overrides: tuple[str, ...] = dataclass_field(default=(), compare=False)


def _folder(value: Any, info: ValidationInfo) -> Path | None:
    return None if value is None else existing_file(value, folder_of(info), ())


class Case(Section):
    """A case of wovenfab. A value is a plain number in SI units or a text with its unit.

    Its sections are all there is to it; of the file it keeps where each value was written.
    """

    title: str = Field(default="", examples=["Bias extension 1:3"])
    """One line for people."""

    fabric: Fabric | None = None
    """What the effects describe, and where their values are from."""

    sheet: Sheet
    """Shape and fibre directions."""

    scene: Annotated[Scene, EffectsSection()] = Field(alias="effects")
    """What the sheet resists and dissipates; what is not listed is not simulated."""

    boundary: Mapping[str, EdgeConditions] = Field(
        examples=[{"left": "clamp", "right": {"displacement": ["program", 0]}}]
    )
    """Condition on each named edge; edges that are not named are free."""

    program: Segments = Field(min_length=1, examples=[{"type": "ramp", "to": "40 mm", "steps": 20}])
    """Displacement against time: one segment, or a list of them."""

    second_program: Annotated[Segments, Field(min_length=1)] | None = Field(
        default=None, examples=[{"type": "ramp", "to": "5 mm", "duration": "1 s"}]
    )
    """Another displacement against the same time, for edges that follow second_program."""

    from_state: Annotated[
        Path | None,
        BeforeValidator(_folder, json_schema_input_type=str | None),
        PlainSerializer(lambda path: path and str(path)),
    ] = Field(default=None, examples=["../results/pretension"])
    """Results directory of a run whose last state is the first of this one: displacements, work
    and dissipated energy count from there."""

    accuracy: Annotated[float | None, Quantity(above=0, most=0.2)] = Field(
        default=None, examples=["1 %"]
    )
    """Largest relative error of the peak force, or the largest displacement where the force is
    prescribed, and of the dissipated energy; degree, size of cells and steps are then found by
    the program."""

    discretisation: Discretisation = Discretisation()
    """Elements in space."""

    time: Time = Time()
    """Steps in time."""

    solver: Solver = Solver()
    """Newton's method."""

    output: OutputSection = OutputSection()
    """What is written besides the history."""

    figures: Annotated[tuple[TestName, ...], OneOr()] = Field(default=(), examples=["kes-shear"])
    """The standard tests that this is, whose figures are written."""

    _origin: _Origin = PrivateAttr()

    def __init__(self, /, **data: Any) -> None:
        """Check sections given as objects or as a case file has them, and fill in defaults.

        Raises:
            CaseError: With everything that is wrong, by key.
        """
        self._read(Document.of(plain(data)))

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @property
    def name(self) -> str:
        """Name of the case file without its suffix; of a test and a fabric those of both."""
        return "-".join(file.stem for file in self.files) or "case"

    @property
    def files(self) -> tuple[Path, ...]:
        """The case file, or those of a test and a fabric; none for a case built in Python."""
        return self._origin.files

    @property
    def path(self) -> Path | None:
        """The case file, that of a test; None for a case that was built in Python."""
        return next(iter(self.files), None)

    @property
    def overrides(self) -> tuple[str, ...]:
        """What replaces values of the case file, as ``"key=value"``."""
        return self._origin.overrides

    @property
    def data(self) -> dict[str, Any]:
        """What the case says with all that it takes over, as plain data, without defaults."""
        return self._written(exclude_unset=True)

    @property
    def needs(self) -> Needs:
        """What the effects need together: placements, second gradient, rate."""
        return needs_of_scene(self.scene)

    @property
    def effects(self) -> Mapping[str, Values]:
        """Values by the name of the effect, in the order of the scene."""
        return {e.name: e.values for e in self.scene}

    @property
    def planned_steps(self) -> int:
        """Number of planned load steps; about the most with two programs or extra times."""
        planned = planned_steps(chain(*self.programs.values()), self.time.steps_per_cycle)
        return planned + len(self.time.extra_times)

    @property
    def programs(self) -> Mapping[str, tuple[SegmentSection, ...]]:
        """The segments of each program by its key."""
        second = {} if self.second_program is None else {SECOND: self.second_program}
        return {"program": self.program} | second

    def problem(self, key: str, message: str, remedy: str = "") -> CaseProblem:
        """Return a problem with the file and line of its key; arguments as in ``Problem``."""
        return self._origin.places.problem(key_path(key), message, remedy)

    def changed(self, *overrides: str | Mapping[str, Any]) -> Case:
        """Return the same case with further overrides, checked again.

        Raises:
            CaseError: With everything that is wrong with it.
        """
        more = tuple(text for one in overrides for text in _listed(one))
        document = reduce(_overridden, more, Document.of(self.data, self._origin.places))
        return _case(document, self.files, (*self.overrides, *more))

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return the same case with other sections, as given: unlike ``changed`` it checks nothing.

        What the copy says is what its sections are, also to ``changed``.
        """
        update = {name: _as_given(name, value) for name, value in (update or {}).items()}
        copy = super().model_copy(update=update, deep=deep)
        if update:
            keys = {type(self).model_fields[name].alias or name for name in update}
            origin, data = self._origin, copy.data
            known = {p: at for p, at in origin.places.places.items() if not keys & {*p[:1]}}
            given = (f"{key}={json.dumps(data.get(key))}" for key in sorted(keys))
            places = Places(origin.places.file, known)
            copy._origin = _Origin(places, origin.files, (*origin.overrides, *given))
        return copy

    def remarks(self) -> list[str]:
        """Return what is probably not meant, and how tables were thinned, in a sentence each."""
        sections: dict[KeyPath, Section] = {
            ("sheet",): self.sheet,
            ("discretisation",): self.discretisation,
        }
        for name, segments in self.programs.items():
            sections |= {(name, i): segment for i, segment in enumerate(segments)}
        found = [odd for path, section in sections.items() for odd in unusual(section, path)]
        for e in self.scene:
            for p in e.effect.parameters:
                key = "effects", e.name, p.name
                found += outside(quantity(p), e.values[p.name], key)
        places = self._origin.places
        problems = [
            places.problem(places.locate(path), *kind.doubts(value))
            for path, value, kind in dict.fromkeys(found)
            if places.locate(path)[-1:] == path[-1:]  # not a default
        ]
        problems += (
            places.problem(places.locate(path), *rest)
            for path, *rest in doubts(self.sheet, self.scene)
        )
        tables = (s for s in sections.values() if isinstance(s, TableSection) and s.tolerance)
        return [
            *(f"warning: {problem}" for problem in problems),
            *(
                f"{t.samples.file.name}: {len(t.samples.times)} of {t.samples.rows} rows are left "
                f"within {t.tolerance:g} m"
                for t in tables
            ),
        ]

    def to_yaml(self) -> str:
        """Return YAML that reads as an equal case, with units and every default."""
        yaml: Any = YAML(typ="safe", pure=True)
        yaml.default_flow_style = None
        yaml.sort_base_mapping_type_on_output = False
        yaml.width = 100
        stream = StringIO()
        yaml.dump(self._written(), stream)
        return stream.getvalue()

    def _written(self, **options: Any) -> dict[str, Any]:
        """Return all sections as they are written in a file; options as of pydantic."""
        left_out: Any = {} if self.accuracy is None else CHOSEN
        data: dict[str, Any] = self.model_dump(
            mode="json", by_alias=True, exclude_none=True, exclude=left_out, **options
        )
        return data

    def __repr__(self) -> str:
        """Return name, sheet, effects, edges and program in one line."""
        sheet = self.sheet
        if isinstance(sheet, Rectangle):
            shape = f"{sheet.length:g} m x {sheet.width:g} m"
        else:
            shape = sheet.file.name
        program = ", ".join(segment.type for segment in self.program)
        return (
            f"<Case {self.name}: {shape}; effects {', '.join(self.effects)}; "
            f"edges {', '.join(self.boundary)}; program {program}>"
        )

    def _read(
        self, document: Document, files: tuple[Path, ...] = (), overrides: tuple[str, ...] = ()
    ) -> None:
        """Take the values of a document, all of them or none."""
        folder = files[0].parent if files else Path()
        custom: CustomEffects = {}
        if named := custom_files(document.data):
            from wovenfab.case.custom_effects import custom_effects

            custom = custom_effects(named, folder)
        context = {"folder": folder, "custom": custom}
        try:
            self.__pydantic_validator__.validate_python(
                document.data, self_instance=self, context=context
            )
        except ValidationError as error:
            effects = [e.effect for e in custom.values() if isinstance(e, CustomEffect)]
            problems = list(problems_in(error, document, json_schema(effects)))
            problems += _combinations(_valid_sections(document.data, context), document)
            raise CaseError(document.in_order(problems)) from error
        sections = {name: getattr(self, name) for name in type(self).model_fields}
        if problems := list(_combinations(sections, document)):
            raise CaseError(document.in_order(problems))
        self._origin = _Origin(Places(document.file, document.places), files, overrides)
        self.__dict__.update(_with_defaults(self))


def read_case(
    path: str | Path, overrides: Overrides = (), fabric: str | Path | None = None
) -> Case:
    """Return the case that a file describes, or a test and a fabric together.

    Args:
        path: A YAML file.
        overrides: Values that replace those of the files, ``"effects.shear.stiffness=500 N/m"``
            each, or a mapping such as ``{"effects.shear.stiffness": "500 N/m"}``.
        fabric: Another YAML file, whose values replace those of the first one.

    Returns:
        The case in SI units, all defaults filled in.

    Raises:
        CaseError: With everything that is wrong.
    """
    files = (Path(path),) if fabric is None else (Path(path), Path(fabric))
    texts = tuple(_listed(overrides))
    return _case(reduce(_overridden, texts, resolved_document(*files)), files, texts)


def _overridden(document: Document, text: str) -> Document:
    """Return the document with one value replaced; a key that is taken out must be a known one.

    Raises:
        CaseError: The text is malformed, or nothing bears that name.
    """
    changed = override(document, text)
    key = text.partition("=")[0]
    path = key_path(key)
    if path not in {*paths_in(document.data), *paths_in(changed.data)}:
        try:
            _case(override(document, f"{key}=clamp"))
        except CaseError as error:
            if unknown := [p for p in error.problems if p.message.startswith("unknown")]:
                raise CaseError(unknown) from None
    return changed


def json_schema(custom: Sequence[Effect] = ()) -> dict[str, Any]:
    """Return the JSON Schema of a whole case, with effects of the user's own."""
    return deepcopy(_described(tuple(forms.effects().values()), tuple(custom)))


@cache
def _described(_known: tuple[Effect, ...], custom: tuple[Effect, ...]) -> dict[str, Any]:
    schema = Case.model_json_schema(schema_generator=_InOrder)
    schema["properties"] = {FROM: _FROM_SCHEMA} | schema["properties"]
    schema["$defs"]["Effects"]["properties"] |= custom_schemas(custom)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema


_FROM_SCHEMA = {
    "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}, "minItems": 1}],
    "description": "Case file to start from, relative to this one, which says what differs; of "
    "several the later ones say what differs from those before.",
    "examples": ["base.yaml", ["test.yaml", "fabric.yaml"]],
}


class _InOrder(GenerateJsonSchema):
    """Keeps the keys in the order in which they are best read."""

    def sort(self, value: Any, parent_key: str | None = None) -> Any:
        """Return the value as it is."""
        return value


def _case(
    document: Document, files: tuple[Path, ...] = (), overrides: tuple[str, ...] = ()
) -> Case:
    case = Case.__new__(Case)
    case._read(document, files, overrides)
    return case


def _listed(overrides: str | Overrides) -> Iterator[str]:
    """Yield overrides as ``"key=value"``, the values in YAML."""
    if isinstance(overrides, str):
        yield overrides
    elif isinstance(overrides, Mapping):
        for key, value in overrides.items():
            given = plain(value)
            yield f"{key}={given if isinstance(given, str) else json.dumps(given)}"
    else:
        yield from overrides


def _combinations(sections: dict[str, Any], document: Document) -> Iterator[CaseProblem]:
    for location, message, remedy in findings(sections):
        yield document.problem(document.locate(location), message, remedy)


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


def _as_given(name: str, section: Any) -> Any:
    """Return a section in which values that were derived from others count as given."""
    derived = {key: getattr(section, key) for key in _DERIVED.get(name, ())}
    return section.model_copy(update=derived) if derived else section


def _with_defaults(case: Case) -> dict[str, Any]:
    """Return the sections in which values depend on other sections; these do not count as given."""
    sections = {name: getattr(case, name).model_copy() for name in _DERIVED}
    mesh = sections["discretisation"]
    if isinstance(case.sheet, Rectangle):
        kind = mesh.mesh or "fibres"
        size = mesh.mesh_size or min(case.sheet.length, case.sheet.width) / CELLS[kind]
        mesh.__dict__.update(mesh_size=size, mesh=kind)
    if "fields" not in sections["output"].model_fields_set:
        sections["output"].__dict__["fields"] = possible_fields(case.needs)
    return sections
