"""The effects of a case with their values, and what follows from them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal, Union

from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PlainValidator,
    Tag,
    ValidationInfo,
    create_model,
)
from pydantic_core import PydanticCustomError, core_schema

from wovenfab import forms
from wovenfab.case.document import FILE, LAW
from wovenfab.case.errors import tagged
from wovenfab.case.formula import SHEAR_ANGLE, Expression
from wovenfab.case.quantities import Json, OneOr, Quantity, Section, hide_default
from wovenfab.case.tables import Tabulated
from wovenfab.case.units import KINDS
from wovenfab.forms.effect import Effect, Needs, Parameter
from wovenfab.forms.table import TABLE, ForceTable

#: A parameter's value in SI units: the same everywhere, or a formula of x and y.
Value = float | Expression
#: Values by name; a pair where they are given for each family.
Values = Mapping[str, Value | tuple[Value, Value]]


@dataclass(frozen=True)
class SceneEffect:
    """An effect with the values that a case gives it.

    Attributes:
        effect: The effect; two with the same name and file count as equal.
        values: All its parameters.
        file: Where it was read from if it is the user's own.
        table: Its table if it takes one; a pair if the families may have different ones.
        name: Its name.
    """

    effect: Effect = dataclass_field(compare=False, repr=False)
    values: Values
    file: Path | None = None
    table: ForceTable | tuple[ForceTable, ForceTable] | None = None
    name: str = dataclass_field(init=False)

    def __post_init__(self) -> None:
        """Take the name from the effect."""
        object.__setattr__(self, "name", self.effect.name)


@dataclass(frozen=True)
class CustomEffect:
    """An effect of the user's own and the file it was read from."""

    effect: Effect
    file: Path


#: By key in the case; what is wrong with a file stands in place of its effect.
CustomEffects = Mapping[str, CustomEffect | PydanticCustomError]
#: In the order of the catalogue, then the user's own in the order of the file.
Scene = tuple[SceneEffect, ...]


_LAW = "Which law it obeys"


def custom_files(data: Any) -> dict[str, Any]:
    """Return the files of the user's own effects by name, from the plain data of any case."""
    section = data.get("effects") if isinstance(data, dict) else None
    given = section.items() if isinstance(section, dict) else ()
    return {key: v[FILE] for key, v in given if isinstance(v, dict) and FILE in v}


def quantity(parameter: Parameter) -> Quantity:
    """Return how one value of a parameter is read and written."""
    variables = ("x", "y", *((SHEAR_ANGLE,) if parameter.of_angle else ()))
    kind = partial(Quantity, unit=_unit(parameter), variables=variables, usual=parameter.usual)
    if parameter.above is not None:
        return kind(above=parameter.above)
    return kind(least=0) if parameter.zero_allowed else kind(above=0)


def field(name: str) -> str:
    """Return a name for a field that nothing else has: keys are free, attributes are not."""
    return f"effect_{name}"


def _models(effect: Effect, **more: Any) -> dict[str, type[Section]]:
    """Return a model of the values for each law of an effect, with more fields in each."""
    return {one.law: _model(one, one is effect, more) for one in effect.all_laws}


def _type_of(models: Mapping[str, type[Section]]) -> Any:
    """Return the annotation of values by one of the laws: the first where none is named."""
    first, *others = models

    def law(data: Any) -> str:
        named = data.get(LAW, first) if isinstance(data, dict) else getattr(data, field(LAW), first)
        return tagged(named if isinstance(named, str) else repr(named))

    if not others:
        return models[first]
    options = tuple(Annotated[model, Tag(tagged(word))] for word, model in models.items())
    return Annotated[Union[options], Discriminator(law)]  # noqa: UP007 - options are computed


def _model(effect: Effect, default: bool, more: Mapping[str, Any]) -> type[Section]:
    fields: Any = {field(p.name): (_kind(p), _described(p)) for p in effect.parameters}
    if table := effect.table:
        described = Field(alias=TABLE, description=table.meaning, examples=[f"{effect.name}.csv"])
        fields[field(TABLE)] = (_one_or_pair(Tabulated(table), table.per_family), described)
    name = effect.name
    if effect.law:
        text = f"{_LAW}; this is {effect.law}."
        chosen = Field(effect.law, alias=LAW, description=text) if default else None
        named = chosen or Field(alias=LAW, description=text)
        fields[field(LAW)] = (Literal[effect.law], named)
        name = name if default else f"{name}_{effect.law}"
    return create_model(name, __base__=Section, __doc__=effect.summary, **fields, **more)


def _kind(parameter: Parameter) -> Any:
    return _one_or_pair(quantity(parameter), parameter.per_family)


def _one_or_pair(kind: Any, per_family: bool) -> Any:
    one = Annotated[Any, kind]
    return Annotated[tuple[one, one], OneOr(2)] if per_family else one


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else parameter.unit


def _described(parameter: Parameter) -> Any:
    example = KINDS.get(_unit(parameter), ("", f"1 {parameter.unit}"))[1]
    more: Mapping[str, Any] = {}
    if parameter.default is not None:
        both = (parameter.default,) * 2
        more = {"default": both if parameter.per_family else parameter.default}
    return Field(alias=parameter.name, description=parameter.meaning, examples=[example], **more)


#: What an effect may say that it resists.
RESISTIBLE = ("stretching", "shearing", "slipping", "curving")


def needs_of_scene(scene: Scene) -> Needs:
    """Return what the effects of a scene need together."""
    needs = [e.effect.needs for e in scene]
    return Needs(
        placements=max((n.placements for n in needs), default=1),
        second_gradient=any(n.second_gradient for n in needs),
        rate=any(n.rate for n in needs),
        increment=any(e.effect.needs.increment or e.effect.memory for e in scene),
    )


def acting_effects(scene: Scene) -> list[SceneEffect]:
    """Return the effects without a zero among their values; formulas are taken as positive."""
    return [e for e in scene if all(map(_positive, e.values.values()))]


def resisted(effects: Iterable[SceneEffect]) -> frozenset[str]:
    """Return what some effects keep from moving freely."""
    return frozenset().union(*(e.effect.resists for e in effects))


def missing_resistance(scene: Scene, act: Collection[SceneEffect]) -> tuple[str, str] | None:
    """Return what no effect resists and that in a sentence, or None for a sound sheet.

    Bending does in place of shear: among fibres that keep their length, the only
    displacements without curvature are a_1 + a_2 y along x and b_1 + b_2 x along y
    (x, y along the fibres), that is, rigid motions and one uniform shear, which the
    held edges must exclude; see ``boundary.free_motion``.

    Args:
        scene: All effects, which decide what is built.
        act: Those that act, which decide what is resisted.
    """
    resists = resisted(act)
    if "stretching" not in resists:
        return "stretching", "nothing resists stretching of the yarns"
    if not resists & {"shearing", "curving"}:
        return "shearing", "nothing resists shear between the families"
    if needs_of_scene(scene).placements == 2 and "slipping" not in resists:
        return "slipping", "nothing ties the two families together where they are not held"
    return None


def effects_that_resist(resistance: str, scene: Scene = ()) -> list[str]:
    """Return the names of all effects that resist something, those of a scene included."""
    known = {**forms.effects(), **{e.name: e.effect for e in scene}}
    return [name for name, effect in known.items() if resistance in effect.resists]


def with_second_gradient() -> list[str]:
    """Return the names of all effects of forms/ that depend on second derivatives."""
    return [name for name, e in forms.effects().items() if e.needs.second_gradient]


def with_two_placements() -> list[str]:
    """Return the names of all effects of forms/ that need a placement for each family."""
    return [name for name, e in forms.effects().items() if e.needs.placements == 2]


def _positive(value: float | Expression | tuple[float | Expression, ...]) -> bool:
    if isinstance(value, tuple):
        return all(map(_positive, value))
    return isinstance(value, Expression) or value > 0


_SECTION = "What the sheet resists and dissipates; what is not listed is not simulated."
_FILE = "Python file beside the case that defines EFFECT, an effect of your own."
#: What the schema says of a key that is no effect of forms/.
_CUSTOM_SCHEMA: Json = {
    "type": "object",
    "description": "An effect of your own, with its parameters beside the file.",
    "properties": {FILE: {"type": "string", "description": _FILE, "examples": ["my_effect.py"]}},
    "required": [FILE],
}


def custom_schemas(custom: Iterable[Effect]) -> dict[str, Json]:
    """Return the JSON Schema of the values of some effects by their names."""
    return {
        effect.name: {"oneOf": [model.model_json_schema() for model in _models(effect).values()]}
        for effect in custom
    }


class EffectsSection:
    """Annotation that reads a mapping of effects as a scene.

    The user's own effects are taken from ``custom`` of the context.
    """

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Read and write with the functions of this module."""
        return core_schema.with_info_plain_validator_function(
            _read,
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda scene, info: _plain(scene, info.mode == "json"), info_arg=True
            ),
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> Json:
        """Describe the effects that there are."""
        text = handler(_catalogue_model(tuple(forms.effects().values())).__pydantic_core_schema__)
        handler.resolve_ref_schema(text)["additionalProperties"] = _CUSTOM_SCHEMA
        return text


def _read(data: Any, info: ValidationInfo) -> Scene:
    custom: CustomEffects = (info.context or {}).get("custom", {})
    section = _section_model(custom).model_validate(data)
    known: list[tuple[Effect, Path | None]] = [(e, None) for e in forms.effects().values()]
    known += [(e.effect, e.file) for e in custom.values() if isinstance(e, CustomEffect)]
    return tuple(
        _chosen(effect, given, file)
        for effect, file in known
        if (given := getattr(section, field(effect.name))) is not None
    )


def _chosen(effect: Effect, given: Section, file: Path | None) -> SceneEffect:
    word = getattr(given, field(LAW), effect.law)
    law = next(one for one in effect.all_laws if one.law == word)
    values = {p.name: getattr(given, field(p.name)) for p in law.parameters}
    return SceneEffect(law, values, file, getattr(given, field(TABLE), None))


def _plain(scene: Scene, written: bool) -> dict[str, Any]:
    """Return values by effect and parameter, with their units if they are to be written."""
    return {
        e.name: ({} if e.file is None else {FILE: str(e.file)})
        | ({LAW: e.effect.law} if e.effect.law else {})
        | {p.name: _written(p, e.values[p.name], written) for p in e.effect.parameters}
        | _written_table(e)
        for e in scene
    }


def _written_table(e: SceneEffect) -> dict[str, Any]:
    if e.effect.table is None or e.table is None:
        return {}
    kind = Tabulated(e.effect.table)
    both = [kind.write(t) for t in e.table] if isinstance(e.table, tuple) else kind.write(e.table)
    return {TABLE: both}


def _written(parameter: Parameter, value: Any, with_unit: bool) -> Any:
    if isinstance(value, tuple):
        return [_written(parameter, v, with_unit) for v in value]
    if with_unit or isinstance(value, Expression):
        return quantity(parameter).write(value)
    return value


def _section_model(custom: CustomEffects) -> type[Section]:
    """Return a model with one optional field for each effect that there is."""
    known = _catalogue_model(tuple(forms.effects().values()))
    if not custom:
        return known
    fields = _fields({name: _custom_kind(e) for name, e in custom.items()})
    return create_model("Effects", __base__=known, __doc__=_SECTION, **fields)


@cache
def _catalogue_model(effects: tuple[Effect, ...]) -> type[Section]:
    fields = _fields({e.name: (_type_of(_models(e)), e.summary) for e in effects})
    return create_model("Effects", __base__=Section, __doc__=_SECTION, **fields)


def _fields(kinds: Mapping[str, tuple[Any, str]]) -> Any:
    """Return an optional field for each effect from its kind and what it is."""
    return {
        field(name): (
            kind,
            Field(default=None, alias=name, description=text, json_schema_extra=hide_default),
        )
        for name, (kind, text) in kinds.items()
    }


def _custom_kind(custom: CustomEffect | PydanticCustomError) -> tuple[Any, str]:
    if isinstance(custom, PydanticCustomError):
        return _refused(custom), ""
    path, effect = custom.file, custom.effect
    file: Any = (Annotated[Path, PlainValidator(lambda _: path)], Field(alias=FILE))
    return _type_of(_models(effect, **{field(FILE): file})), effect.summary


def _refused(error: PydanticCustomError) -> type[Section]:
    """Return the model of an effect that could not be loaded."""

    def refuse(_: Any) -> None:
        raise error

    class Refused(Section, extra="ignore"):
        """What stands beside the name of the file is not looked at."""

        file: Annotated[Any, BeforeValidator(refuse)]

    return Refused
