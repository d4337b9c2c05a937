"""The effects section: its keys are whatever the folder forms/ offers."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, create_model
from pydantic_core import core_schema

from forms import catalogue
from forms.effect import Effect, Parameter

from .units import KINDS
from .values import OneOr, Quantity, Section


def effects_model() -> type[Section]:
    """Return a model with one optional field for each effect that there is."""
    return _model(tuple(catalogue.effects().values()))


@cache
def _model(effects: tuple[Effect, ...]) -> type[Section]:
    fields: Any = {
        effect.name: (
            _values_model(effect),
            Field(default=None, description=effect.summary, json_schema_extra=_without_default),
        )
        for effect in effects
    }
    return create_model("Effects", __base__=Section, __doc__=_TELL, **fields)


_TELL = "What the sheet resists and dissipates; what is not listed is not simulated."


def _without_default(schema: dict[str, Any]) -> None:
    schema.pop("default", None)


def _values_model(effect: Effect) -> type[Section]:
    fields: Any = {
        p.name: (_kind(p), Field(description=p.meaning, examples=[_example(p)]))
        for p in effect.parameters
    }
    return create_model(effect.name, __base__=Section, __doc__=effect.summary, **fields)


def _kind(parameter: Parameter) -> Any:
    zero = {"least": 0.0} if parameter.zero_allowed else {"above": 0.0}
    quantity = Annotated[float, Quantity(unit=parameter.unit, **zero)]
    return Annotated[tuple[quantity, quantity], OneOr(2)] if parameter.per_family else quantity


def _example(parameter: Parameter) -> str:
    return KINDS.get(parameter.unit, ("", f"1 {parameter.unit}"))[1]


class EffectsOfCatalogue:
    """Annotation that reads a mapping of effects, as the catalogue is at that time."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Read and write by way of :func:`effects_model`."""
        return core_schema.no_info_plain_validator_function(
            lambda data: _plain(data, "python"),
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda values: _plain(values, "json"), when_used="json"
            ),
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Describe the effects that there are."""
        return handler(effects_model().__pydantic_core_schema__)


def _plain(data: Any, mode: str) -> dict[str, Any]:
    """Return values by effect and parameter, effects in the catalogue's order."""
    return effects_model().model_validate(data).model_dump(mode=mode, exclude_unset=True)
