"""Compiled derivatives of a model's residual and dissipated power by material parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import ufl
from dolfinx import fem

from forms.sensitivity import BalanceDerivatives, Target, loss_along, loss_by
from wovenfab.model.assembly import Sum, compile_sums
from wovenfab.model.model import Model


class TargetError(Exception):
    """No effect of the scene has a parameter of that name."""


@dataclass(frozen=True)
class SensitivityForms:
    """The forms of tangent-linear equations; each is empty where nothing depends on it.

    Attributes:
        targets: The parameters.
        now, earlier: Fields along which the present and the earlier states change, m.
        residual: For each parameter, linear forms of the derivative of the residual.
        residual_along: Its change along ``earlier``.
        power: For each parameter, scalar forms of the derivative of the dissipated power.
        power_along: Its change along ``now`` and ``earlier``.
        loss, loss_along: The same of the energy that set-valued laws dissipate in the step.
    """

    targets: tuple[Target, ...]
    now: fem.Function
    earlier: tuple[fem.Function, ...]
    residual: tuple[Sum, ...]
    residual_along: Sum
    power: tuple[Sum, ...]
    power_along: Sum
    loss: tuple[Sum, ...]
    loss_along: Sum


def require_targets(model: Model, targets: Sequence[Target]) -> None:
    """Check that each parameter is one of the scene.

    Raises:
        TargetError: If one is not.
    """
    terms = (*model.balance.terms, *(f.term for f in model.point_frictions))
    known = {(t.effect.name, name) for t in terms for name in t.values}
    for target in targets:
        if (target.effect, target.parameter) not in known:
            names = ", ".join(sorted(f"{e}.{p}" for e, p in known))
            raise TargetError(f"{target} is no parameter of this scene; it has {names}")


def sensitivity_forms(model: Model, targets: Sequence[Target]) -> SensitivityForms:
    """Return the compiled forms; collective.

    Args:
        model: As it is solved. The stress of its point frictions is held fixed here.
        targets: The parameters.
    """
    at_points = {f.term.effect.name for f in model.point_frictions}
    smooth = tuple(t for t in model.balance.terms if t.effect.name not in at_points)
    balance = replace(model.balance, terms=smooth)
    whole = BalanceDerivatives(model.balance)  # the power is that of the laws, smooth or not
    space = model.space
    now, earlier = fem.Function(space), tuple(fem.Function(space) for _ in model.history)
    test = ufl.TestFunction(space)
    inside = BalanceDerivatives(balance)
    set_valued = [f for f in model.point_frictions if f.term.effect.set_valued]
    sums: dict[str, list[Any]] = {
        "residual along": [inside.residual_along(earlier, test)] if earlier else [],
        "power along": [whole.power_along(now, earlier)],
        "loss along": [loss_along(f, now, earlier) for f in set_valued],
    }
    for i, target in enumerate(targets):
        lines = [
            inside.line_residual(
                target, family, fem.Function(part, model.field.x), ufl.TestFunction(part)
            )
            for family, part in enumerate(model.placements.families)
        ]
        sums[f"residual {i}"] = [inside.residual(target, test), *lines]
        sums[f"power {i}"] = [whole.power(target)]
        sums[f"loss {i}"] = [loss_by(target, f) for f in set_valued]
    present = {
        name: [f for f in forms if f is not None and not _vanishes(f)]
        for name, forms in sums.items()
    }
    compiled = compile_sums(present, model.comm)

    def each(name: str) -> tuple[Sum, ...]:
        return tuple(compiled[f"{name} {i}"] for i in range(len(targets)))

    return SensitivityForms(
        tuple(targets), now, earlier, each("residual"), compiled["residual along"],
        each("power"), compiled["power along"], each("loss"), compiled["loss along"],
    )  # fmt: skip


def _vanishes(form: Any) -> bool:
    """Return whether a form is zero once it is differentiated."""
    expanded = ufl.algorithms.apply_derivatives.apply_derivatives(
        ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering(form)
    )
    return not expanded.integrals()
