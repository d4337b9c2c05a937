"""The values of one effect: a model with a field for each parameter, and one for each law."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Union

from pydantic import Discriminator, Field, Tag, create_model

from forms.effect import Effect, Parameter

from .files import LAW
from .units import KINDS
from .values import Json, OneOr, Section
from .varying import Varying

_TELL = "Which law it obeys"


def quantity(parameter: Parameter) -> Varying:
    """Return how one value of a parameter is read and written."""
    unit = _unit(parameter)
    if parameter.above is not None:
        return Varying(unit=unit, above=parameter.above)
    return Varying(unit=unit, least=0) if parameter.zero_allowed else Varying(unit=unit, above=0)


def field(name: str) -> str:
    """Return a name for a field that nothing else has: keys are free, attributes are not."""
    return f"{name}_"


def models_of(effect: Effect, more: Mapping[str, Any] | None = None) -> dict[str, type[Section]]:
    """Return a model of the values for each law of an effect.

    Args:
        effect: The effect.
        more: Other fields that each has, as for pydantic's ``create_model``.
    """
    return {one.law: _model(one, one is effect, more or {}) for one in effect.all_laws}


def chosen_from(models: Mapping[str, type[Section]]) -> Any:
    """Return the annotation of a value that is one of some models, by its law.

    The first one is meant where none is named.
    """
    first, *others = models

    def law(data: Any) -> str:
        named = data.get(LAW, first) if isinstance(data, dict) else getattr(data, field(LAW), first)
        return named if isinstance(named, str) else repr(named)

    if not others:
        return models[first]
    options = tuple(Annotated[model, Tag(word)] for word, model in models.items())
    return Annotated[Union[options], Discriminator(law)]  # noqa: UP007 - options are computed


def law_of(effect: Effect, given: Section) -> Effect:
    """Return the law of an effect that was chosen."""
    word = getattr(given, field(LAW), effect.law)
    return next(one for one in effect.all_laws if one.law == word)


def values_of(effect: Effect, given: Section) -> dict[str, Any]:
    """Return the values of all parameters of an effect by their names."""
    return {p.name: getattr(given, field(p.name)) for p in effect.parameters}


def schema_of(effect: Effect) -> Json:
    """Return the JSON Schema of an effect's values."""
    schemas = [model.model_json_schema() for model in models_of(effect).values()]
    return schemas[0] if len(schemas) == 1 else {"oneOf": schemas}


def _model(effect: Effect, default: bool, more: Mapping[str, Any]) -> type[Section]:
    fields: Any = {field(p.name): (_kind(p), _described(p)) for p in effect.parameters}
    name = effect.name
    if effect.law:
        tell = f"{_TELL}; this is {effect.law}."
        chosen = Field(effect.law, alias=LAW, description=tell) if default else None
        named = chosen or Field(alias=LAW, description=tell)
        fields[field(LAW)] = (Literal[effect.law], named)
        name = name if default else f"{name}_{effect.law}"
    return create_model(name, __base__=Section, __doc__=effect.summary, **fields, **more)


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
