"""The kinds of values in a case, as annotations for pydantic."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
)
from pydantic_core import core_schema

from wovenfab.case import lists, units
from wovenfab.case.document import Document
from wovenfab.case.errors import (
    CaseError,
    FormulaError,
    KeyPath,
    describe,
    near_miss,
    one_of,
    problems_in,
    value_error,
)
from wovenfab.case.formula import Expression, is_formula

Json = dict[str, Any]


class Section(BaseModel):
    """A mapping of the case file: fixed keys, frozen once read.

    Raises:
        CaseError: It is built in Python from values that a case file may not have either.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        use_attribute_docstrings=True,
        model_title_generator=lambda model: model.__name__.removesuffix("Section"),
    )

    def __init__(self, /, **data: Any) -> None:
        """Check the values, which are numbers in SI units or texts as in a case file."""
        data = {key: plain(value) for key, value in data.items()}
        try:
            self.__pydantic_validator__.validate_python(data, self_instance=self)
        except ValidationError as error:
            document = Document.of(data)
            raise CaseError(problems_in(error, document, self.model_json_schema())) from error

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Show what is given."""
        return ((key, value) for key, value in super().__repr_args__() if value is not None)

    # Without this pydantic would call it for the sections of a section, too.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]


def plain(value: Any) -> Any:
    """Return a value as a case file has it, in which sections are mappings."""
    match value:
        case Section():
            kind = {"type": value.type} if hasattr(value, "type") else {}
            return kind | value.model_dump(mode="json", by_alias=True, exclude_unset=True)
        case dict():
            return {key: plain(inner) for key, inner in value.items()}
        case list() | tuple():
            return [plain(inner) for inner in value]
        case Path():
            return str(value)
    return value


def hide_default(schema: Json) -> None:
    """Take a default out of the schema of a key that is better left out."""
    schema.pop("default", None)


@dataclass(frozen=True)
class _Scalar:
    """A scalar with bounds, or one of a few words.

    Attributes:
        above: Exclusive lower bound.
        least: Lower bound.
        most: Upper bound.
        words: Texts that stand for themselves.
    """

    above: float = -math.inf
    least: float = -math.inf
    most: float = math.inf
    words: tuple[str, ...] = ()

    def read(self, value: Any) -> Any:
        """Return the value as it is kept, or raise what is wrong with it."""
        return value if value in self.words and isinstance(value, str) else self.number(value)

    def number(self, value: Any) -> float:
        """Return the value as a number; to be defined by each kind."""
        raise NotImplementedError

    def write(self, value: Any) -> Any:
        """Return the value as it is written to a file."""
        return value

    def bounds(self) -> Json:
        """Return the bounds in the words of JSON Schema."""
        named = {"exclusiveMinimum": self.above, "minimum": self.least, "maximum": self.most}
        return {name: bound for name, bound in named.items() if math.isfinite(bound)}

    def broken(self, value: float) -> str:
        """Return what a value must do that this one does not, or nothing."""
        if value <= self.above:
            return "be positive" if self.above == 0 else f"be more than {self.above:g}"
        if value < self.least:
            return "not be negative" if self.least == 0 else f"be at least {self.least:g}"
        return f"be at most {self.most:g}" if value > self.most else ""

    def check(self, value: float, text: Any) -> None:
        """Raise if the value is out of bounds."""
        if problem := self.broken(value):
            raise value_error(f"must {problem}, got {describe(text)}")

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Read and write with the methods above."""
        return core_schema.no_info_plain_validator_function(
            self.read,
            serialization=core_schema.plain_serializer_function_ser_schema(
                self.write, when_used="json"
            ),
        )

    def _or_words(self, options: list[Json]) -> Json:
        words = [{"enum": list(self.words)}] if self.words else []
        options = [*words, *options]
        return options[0] if len(options) == 1 else {"anyOf": options}


#: Sizes between which products of several quantities are neither infinite nor zero.
LEAST, MOST = 1e-50, 1e50
SIZES = f"Values are between {LEAST:g} and {MOST:g} in SI units, or zero."


@dataclass(frozen=True)
class Quantity(_Scalar):
    """A float in the SI unit ``unit``, written as a number, text with a unit or a formula.

    Attributes:
        unit: SI unit; empty for a pure number.
        variables: What a formula may depend on here; formulas are refused if empty.
        usual: Sizes outside are asked back, since a unit is probably wrong; zero is not.
    """

    unit: str = ""
    variables: tuple[str, ...] = ()
    usual: tuple[float, float] = (0.0, math.inf)

    def read(self, value: Any) -> Any:
        """Return a word, a number, or an expression if it depends on any variable."""
        if isinstance(value, Expression):
            return value
        if not self.variables or not isinstance(value, str) or value in self.words:
            return super().read(value)
        return self.expression(value) if is_formula(value) else self.number(value)

    def number(self, value: Any) -> float:
        """Return the SI value."""
        try:
            if isinstance(value, bool) or not isinstance(value, int | float | str):
                raise ValueError(describe(value))
            number = units.parse(value, self.unit) if isinstance(value, str) else float(value)
            if not math.isfinite(number):
                raise ValueError(describe(value))
        except (ValueError, OverflowError) as error:
            words = f"{one_of(self.words)}, or " if self.words else ""
            reason = f"expected {words}{units.kind(self.unit)}, got {error}"
            raise value_error(reason, near_miss(value, self.words)) from error
        if number and not LEAST < abs(number) < MOST:
            raise value_error(f"{describe(value)} is beyond what can be computed with", SIZES)
        self.check(number, value)
        return number

    def expression(self, text: str) -> float | Expression:
        """Return the value of a formula."""
        try:
            expression = Expression(text, self.unit)
        except FormulaError as error:
            raise value_error(str(error), error.remedy) from error
        if expression.constant is not None:
            self.check(expression.constant, text)
            return expression.constant
        if unknown := sorted(expression.variables - set(self.variables)):
            remedy = f"This formula may depend on {one_of(self.variables)}."
            raise value_error(f"'{unknown[0]}' cannot be used here", remedy)
        return expression

    def doubts(self, value: float) -> tuple[str, str]:
        """Return what is asked about an unusual value, and how it is written."""
        least, most = (units.write(bound, self.unit) for bound in self.usual)
        smaller = f"{value:g} m{self.unit}" if self.unit in ("m", "m/s") else ""
        example = smaller or units.KINDS.get(self.unit, ("", f"1 {self.unit}"))[1]
        return (
            f"is {units.write(value, self.unit)} meant? Usual are {least} to {most}",
            f"A number without a unit is in {self.unit}; with its unit it is written '{example}'.",
        )

    def write(self, value: Any) -> Any:
        """Return text with the unit, or a formula, that reads as the same value."""
        if isinstance(value, Expression):
            return value.text
        return value if isinstance(value, str) else units.write(value, self.unit)

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> Json:
        """Describe a number in SI, or text with a unit or a formula."""
        name, example = units.KINDS.get(self.unit, ("a value", f"1 {self.unit}"))
        number = {"type": "number", "description": f"{name} in {self.unit}".removesuffix(" in ")}
        text: Json = {"type": "string"}
        if self.variables:
            text["description"] = f"'{example}', or a formula of {', '.join(self.variables)}"
        else:
            text |= {"pattern": units.PATTERN, "description": f"'{example}'"}
        options = [number | self.bounds(), *([text] if self.unit or self.variables else [])]
        examples = {"examples": [example]} if self.unit or self.variables else {}
        return self._or_words(options) | examples | {"unit": self.unit or "1"}


class Newtons(float):
    """A force (N) where a displacement (m) could be."""


def is_force(value: Any) -> bool:
    """Return whether a value is a force, or a text with a unit of force."""
    return isinstance(value, Newtons) or (isinstance(value, str) and units.measures(value, "N"))


@dataclass(frozen=True)
class TimeOrSteps(Quantity):
    """A duration as text with its unit, a number of steps as a whole number, or false."""

    def read(self, value: Any) -> Any:
        """Return seconds as a float, steps as an int, or False."""
        if value is False:
            return value
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            remedy = "For example '5 min', 100 for every 100 steps, or false."
            raise value_error(
                f"expected a duration or a number of steps, got {describe(value)}", remedy
            )
        if isinstance(value, int):
            self.check(value, value)
            return value
        return self.number(value)

    def write(self, value: Any) -> Any:
        """Return text with the unit of a duration, and what else there is as it is."""
        return units.write(value, self.unit) if isinstance(value, float) else value

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> Json:
        """Describe the three."""
        steps = {"type": "integer", "description": "a number of steps", "minimum": 1}
        text = {"type": "string", "description": "a duration with its unit"}
        return {"anyOf": [text, steps, {"const": False}]}


@dataclass(frozen=True)
class Count(_Scalar):
    """A whole number."""

    even: bool = False

    def number(self, value: Any) -> int:
        """Return the whole number."""
        if isinstance(value, bool) or not isinstance(value, int):
            words = f"{one_of(self.words)}, or " if self.words else ""
            raise value_error(f"expected {words}a whole number, got {describe(value)}")
        self.check(value, value)
        if self.even and value % 2:
            raise value_error(f"must be even, got {value}")
        return int(value)

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> Json:
        """Describe a whole number."""
        even = {"multipleOf": 2} if self.even else {}
        return self._or_words([{"type": "integer"} | self.bounds() | even])


@dataclass(frozen=True)
class Several:
    """A list of values, each with its own unit, or a text with one unit for all of them.

    Attributes:
        copies: How many a single value without brackets stands for; 0 if for none.
    """

    copies: int = 0

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Make a list of what is none."""
        items = handler(source)
        return core_schema.no_info_before_validator_function(self._listed, items)

    def _listed(self, value: Any) -> Any:
        if isinstance(value, str):
            value = lists.numbers_of(value) or value
        if isinstance(value, list | tuple):
            if problem := lists.mixed(value):
                raise value_error(*problem)
            return value
        return [value] * self.copies if self.copies else value

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> Json:
        """Describe a list, and what may stand in its place: one item, a text."""
        many = handler(schema)
        one = many["prefixItems"][0] if "prefixItems" in many else many["items"]
        unit = one.get("unit", "1")
        if self.copies:  # its text may be a list, too
            return {"anyOf": [one, many]}
        if unit == "1":
            return many
        example = units.KINDS.get(unit, ("", f"1 {unit}"))[1]
        text = f"one text for both such as '0, {example}'"
        return {"anyOf": [many, {"type": "string", "description": text}]}


@dataclass(frozen=True)
class OneOr(Several):
    """The same, whose brackets may be left out if it has one item, standing for ``copies``."""

    copies: int = 1


Length = Annotated[float, Quantity(unit="m", usual=(1e-8, 20.0))]
Size = Annotated[float, Quantity(unit="m", above=0, usual=(1e-8, 20.0))]
Extent = Annotated[float, Quantity(unit="m", above=0, usual=(1e-3, 20.0))]
Duration = Annotated[float, Quantity(unit="s", above=0)]
Speed = Annotated[float, Quantity(unit="m/s", above=0, usual=(1e-9, 10.0))]
Frequency = Annotated[float, Quantity(unit="Hz", above=0, usual=(1e-6, 1e3))]
Angle = Annotated[float, Quantity(unit="rad")]
AtLeastOne = Annotated[int, Count(least=1, most=1_000_000)]


def unusual(section: Section, path: KeyPath = ()) -> Iterator[tuple[KeyPath, float, Quantity]]:
    """Yield the values of a section that are probably not meant, each with where it is."""
    for name, field in type(section).model_fields.items():
        kinds = filter(None, map(_quantity_in, (*field.metadata, field.annotation)))
        if kind := next(kinds, None):
            yield from outside(kind, getattr(section, name), (*path, field.alias or name))


def outside(kind: Quantity, value: Any, path: KeyPath) -> Iterator[tuple[KeyPath, float, Quantity]]:
    """Yield a value, or those of a tuple, that are out of what is usual."""
    if isinstance(value, tuple):
        for i, one in enumerate(value):
            yield from outside(kind, one, path if len(set(value)) == 1 else (*path, i))
    elif isinstance(value, float) and value and not isinstance(value, Newtons):
        least, most = kind.usual
        if not least <= abs(value) <= most:
            yield path, value, kind


def _quantity_in(annotation: Any) -> Quantity | None:
    if isinstance(annotation, Quantity):
        return annotation
    return next(filter(None, map(_quantity_in, get_args(annotation))), None)
