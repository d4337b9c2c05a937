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
from .files import FILE, LAW
from .own_effects import OwnEffect, OwnEffects
from .parameters import (
    chosen_from,
    field,
    law_of,
    models_of,
    quantity,
    schema_of,
    values_of,
)
from .scene import Scene, SceneEffect
from .values import Json, Section, hide_default

_TELL = "What the sheet resists and dissipates; what is not listed is not simulated."
_FILE = "Python file beside the case that defines EFFECT, an effect of your own."
#: What the schema says of a key that is no effect of forms/.
_OWN_SCHEMA: Json = {
    "type": "object",
    "description": "An effect of your own, with its parameters beside the file.",
    "properties": {FILE: {"type": "string", "description": _FILE, "examples": ["my_effect.py"]}},
    "required": [FILE],
}


def own_schemas(own: Iterable[Effect]) -> dict[str, Json]:
    """Return the JSON Schema of the values of some effects by their names."""
    return {effect.name: schema_of(effect) for effect in own}


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
        _chosen(effect, given, file)
        for effect, file in known
        if (given := getattr(section, field(effect.name))) is not None
    )


def _chosen(effect: Effect, given: Section, file: Path | None) -> SceneEffect:
    law = law_of(effect, given)
    return SceneEffect(law, values_of(law, given), file)


def _plain(scene: Scene, written: bool) -> dict[str, Any]:
    """Return values by effect and parameter, with their units if they are to be written."""
    return {
        e.name: ({} if e.file is None else {FILE: str(e.file)})
        | ({LAW: e.effect.law} if e.effect.law else {})
        | {p.name: _written(p, e.values[p.name], written) for p in e.effect.parameters}
        for e in scene
    }


def _written(parameter: Parameter, value: Any, with_unit: bool) -> Any:
    if isinstance(value, tuple):
        return [_written(parameter, v, with_unit) for v in value]
    if with_unit or isinstance(value, Expression):
        return quantity(parameter).write(value)
    return value


def _section_model(own: OwnEffects) -> type[Section]:
    """Return a model with one optional field for each effect that there is."""
    known = _catalogue_model(tuple(catalogue.effects().values()))
    fields = _fields({name: _own_kind(e) for name, e in own.items()})
    return create_model("Effects", __base__=known, __doc__=_TELL, **fields)


@cache
def _catalogue_model(effects: tuple[Effect, ...]) -> type[Section]:
    fields = _fields({e.name: (chosen_from(models_of(e)), e.summary) for e in effects})
    return create_model("Effects", __base__=Section, __doc__=_TELL, **fields)


def _fields(kinds: Mapping[str, tuple[Any, str]]) -> Any:
    """Return an optional field for each effect from its kind and what it is."""
    return {
        field(name): (
            kind,
            Field(default=None, alias=name, description=told, json_schema_extra=hide_default),
        )
        for name, (kind, told) in kinds.items()
    }


def _own_kind(own: OwnEffect | PydanticCustomError) -> tuple[Any, str]:
    if isinstance(own, PydanticCustomError):
        return _refused(own), ""
    path, effect = own.file, own.effect
    file: Any = (Annotated[Path, PlainValidator(lambda _: path)], Field(alias=FILE))
    return chosen_from(models_of(effect, {field(FILE): file})), effect.summary


def _refused(error: PydanticCustomError) -> type[Section]:
    """Return the model of an effect that could not be loaded."""

    def refuse(_: Any) -> None:
        raise error

    class Refused(Section, extra="ignore"):
        """What stands beside the name of the file is not looked at."""

        file: Annotated[Any, BeforeValidator(refuse)]

    return Refused
