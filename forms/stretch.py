"""Stretch of the yarns: K_e/2 (|f_a| - 1)^2 for each family, eqs. (2), (3), or a measured law."""

from __future__ import annotations

from functools import partial
from typing import Any

from wovenfab.forms.effect import Effect, Parameter, Strain, Values
from wovenfab.forms.kinematics import Point, stretch
from wovenfab.forms.table import TABLE, Column, TableParameter, least_slope, table_energy


def strains(point: Point, values: Values) -> tuple[Strain, ...]:
    """Return the stretch of each family with its stiffness (N/m)."""
    return tuple(Strain(stretch(f), k) for f, k in zip(point.f, values["stiffness"], strict=True))


def linear_stiffness(values: Values) -> tuple[Any, Any]:
    """Return the stiffness (N/m) of each family, the same at all stretches."""
    first, second = values["stiffness"]
    return first, second


def tabulated_strains(point: Point, values: Values) -> tuple[Strain, ...]:
    """Return the stretch of each family with its measured law.

    A yarn that is shorter than at rest has the stiffness of the first rows.
    """
    families = zip(point.f, values["scale"], values[TABLE], strict=True)
    return tuple(
        Strain(stretch(f), scale, law=partial(table_energy, pieces=pieces))
        for f, scale, pieces in families
    )


def tabulated_stiffness(values: Values) -> tuple[Any, Any]:
    """Return the least stiffness (N/m) of each family at all stretches."""
    families = zip(values["scale"], values[TABLE], strict=True)
    first, second = (scale * least_slope(pieces) for scale, pieces in families)
    return first, second


EFFECT = Effect(
    name="stretch",
    summary="Elastic stretch of the yarns, paper eqs. (2) and (3)",
    parameters=(
        Parameter(
            "stiffness",
            "N/m",
            "extensional stiffness K_e of a family",
            per_family=True,
            usual=(10.0, 1e11),
        ),
    ),
    strains=strains,
    stretch_stiffness=linear_stiffness,
    resists=frozenset({"stretching"}),
    law="linear",
    laws=(
        Effect(
            name="stretch",
            summary="Elastic stretch of the yarns by a measured curve",
            parameters=(
                Parameter("scale", "1", "factor of all forces", per_family=True, default=1.0),
            ),
            strains=tabulated_strains,
            stretch_stiffness=tabulated_stiffness,
            resists=frozenset({"stretching"}),
            law="table",
            table=TableParameter(
                Column("strain", "1", "stretch of the yarns |f_a| - 1"),
                Column("force", "N/m", "tension of a family per width"),
                per_family=True,
            ),
        ),
    ),
)
