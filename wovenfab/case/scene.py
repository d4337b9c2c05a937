"""The effects of a case with their values: what there is to simulate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from forms.effect import Effect

from .expression import Expression

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
        name: Its name.
    """

    effect: Effect = field(compare=False, repr=False)
    values: Values
    file: Path | None = None
    name: str = field(init=False)

    def __post_init__(self) -> None:
        """Take the name from the effect."""
        object.__setattr__(self, "name", self.effect.name)


#: In the order of the catalogue, then the user's own in the order of the file.
Scene = tuple[SceneEffect, ...]
