"""The effects section: its keys are what forms/ offers, and the user's own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PlainValidator,
    ValidationInfo,
    create_model,
)
from pydantic_core import PydanticCustomError, core_schema

from forms import catalogue
from forms.effect import Effect, Parameter

from .expression import Expression
from .files import FILE
from .own_effects import OwnEffect, OwnEffects
from .scene import Scene, SceneEffect
from .units import KINDS
from .values import Json, OneOr, Section, hide_default
from .varying import Varying

_TELL = "What the sheet resists and dissipates; what is not listed is not simulated."
_FILE = "Python file beside the case that defines EFFECT, an effect of your own."
#: What the schema says of a key that is no effect of forms/.
_OWN_SCHEMA: Json = {
    "type": "object",
    "description": "An effect of your own, with its parameters beside the file.",
    "properties": {FILE: {"type": "string", "description": _FILE, "examples": ["my_effect.py"]}},
    "required": [FILE],
}


def quantity(parameter: Parameter) -> Varying:
    """Return how one value of a parameter is read and written."""
    unit = _unit(parameter)
    if parameter.above is not None:
        return Varying(unit=unit, above=parameter.above)
    return Varying(unit=unit, least=0) if parameter.zero_allowed else Varying(unit=unit, above=0)


def own_schemas(own: Iterable[Effect]) -> dict[str, Json]:
    """Return the JSON Schema of the values of some effects by their names."""
    return {effect.name: _values_model(effect).model_json_schema() for effect in own}


class EffectsSection:
    """Annotation that reads a mapping of effects as a scene.

    The user's own effects are taken from ``own`` of the context.
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
        told = handler(
            _catalogue_model(tuple(catalogue.effects().values())).__pydantic_core_schema__
        )
        handler.resolve_ref_schema(told)["additionalProperties"] = _OWN_SCHEMA
        return told


def _read(data: Any, info: ValidationInfo) -> Scene:
    own: OwnEffects = (info.context or {}).get("own", {})
    section = _section_model(own).model_validate(data)
    known: list[tuple[Effect, Path | None]] = [(e, None) for e in catalogue.effects().values()]
    known += [(e.effect, e.file) for e in own.values() if isinstance(e, OwnEffect)]
    return tuple(
        SceneEffect(effect, _values(effect, given), file)
        for effect, file in known
        if (given := getattr(section, _field(effect.name))) is not None
    )


def _values(effect: Effect, given: Section) -> dict[str, Any]:
    return {p.name: getattr(given, _field(p.name)) for p in effect.parameters}


def _plain(scene: Scene, written: bool) -> dict[str, Any]:
    """Return values by effect and parameter, with their units if they are to be written."""
    return {
        e.name: ({} if e.file is None else {FILE: str(e.file)})
        | {p.name: _written(p, e.values[p.name], written) for p in e.effect.parameters}
        for e in scene
    }


def _written(parameter: Parameter, value: Any, with_unit: bool) -> Any:
    if isinstance(value, tuple):
        return [_written(parameter, v, with_unit) for v in value]
    if with_unit or isinstance(value, Expression):
        return quantity(parameter).write(value)
    return value


def _field(name: str) -> str:
    """Return a name for a field that nothing else has: keys are free, attributes are not."""
    return f"{name}_"


def _section_model(own: OwnEffects) -> type[Section]:
    """Return a model with one optional field for each effect that there is."""
    known = _catalogue_model(tuple(catalogue.effects().values()))
    fields = _fields({name: _own_model(e) for name, e in own.items()})
    return create_model("Effects", __base__=known, __doc__=_TELL, **fields)


@cache
def _catalogue_model(effects: tuple[Effect, ...]) -> type[Section]:
    fields = _fields({effect.name: _values_model(effect) for effect in effects})
    return create_model("Effects", __base__=Section, __doc__=_TELL, **fields)


def _fields(models: Mapping[str, type[Section]]) -> Any:
    return {
        _field(name): (
            model,
            Field(
                default=None, alias=name, description=model.__doc__, json_schema_extra=hide_default
            ),
        )
        for name, model in models.items()
    }


def _values_model(effect: Effect) -> type[Section]:
    fields: Any = {_field(p.name): (_kind(p), _described(p)) for p in effect.parameters}
    return create_model(effect.name, __base__=Section, __doc__=effect.summary, **fields)


def _own_model(own: OwnEffect | PydanticCustomError) -> type[Section]:
    if isinstance(own, PydanticCustomError):
        return _refused(own)
    path, base = own.file, _values_model(own.effect)
    file: Any = (Annotated[Path, PlainValidator(lambda _: path)], Field(alias=FILE))
    return create_model(own.effect.name, __base__=base, __doc__=base.__doc__, file_=file)


def _refused(error: PydanticCustomError) -> type[Section]:
    """Return the model of an effect that could not be loaded."""

    def refuse(_: Any) -> None:
        raise error

    class Refused(Section, extra="ignore"):
        """What stands beside the name of the file is not looked at."""

        file: Annotated[Any, BeforeValidator(refuse)]

    return Refused


def _kind(parameter: Parameter) -> Any:
    one = Annotated[Any, quantity(parameter)]
    return Annotated[tuple[one, one], OneOr(2)] if parameter.per_family else one


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else parameter.unit


def _described(parameter: Parameter) -> Any:
    example = KINDS.get(_unit(parameter), ("", f"1 {parameter.unit}"))[1]
    more: Mapping[str, Any] = {}
    if parameter.default is not None:
        both = (parameter.default,) * 2
        more = {"default": both if parameter.per_family else parameter.default}
    return Field(alias=parameter.name, description=parameter.meaning, examples=[example], **more)
