"""Whether a user's own effect gives energies that can be varied and compiled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import ufl

from forms.balance import Balance, Rate
from forms.effect import Effect, Term
from forms.kinematics import point_of
from forms.point_friction import PointFriction, components_of

from .problems import in_brief, refusal
from .scene import Scene

DEGREE = 2
#: What is asked of the functions of an effect.
REMEDY = (
    "Its functions return one number in J/m^2 (an energy) or W/m^2 (a dissipation), made of what "
    "they are given by Python's operators and the functions of UFL."
)


@contextmanager
def blame_own(scene: Scene) -> Iterator[None]:
    """Take what fails inside, where a scene is built, for a fault of the user's own effects.

    Raises:
        CaseError: If the scene has any, with their files and the cause.
    """
    try:
        yield
    except (OSError, MemoryError):
        raise
    except Exception as error:
        own = ", ".join(e.file.name for e in scene if e.file)
        if not own:
            raise
        raise refusal(own, f"the effect cannot be compiled: {in_brief(error)}", REMEDY) from error


def try_forms(effect: Effect) -> None:
    """Form potential, residual and tangent of an effect on a sheet of symbols.

    Raises:
        ValueError: If an energy is not one number at each point.
        Exception: Whatever the functions of the effect, or UFL about them, raise.
    """
    term, balance = _balance(effect)
    point = point_of(balance.field, balance.fibres, balance.second_gradient)
    if effect.energy is not None:
        _require_scalar("energy", effect.energy(point, term.values))
    if effect.strains is not None:
        for strain in effect.strains(point, term.values):
            _require_scalar("the measure of a strain", strain.measure)
            _require_scalar("the stiffness of a strain", strain.stiffness)
    if effect.dissipation is not None and effect.measure is not None:
        rate = ufl.variable(effect.measure(point))
        _require_scalar("dissipation", effect.dissipation(rate, term.values))
    space = balance.field.ufl_function_space()
    test, trial = ufl.TestFunction(space), ufl.TrialFunction(space)
    balance.potential()
    balance.power()
    balance.residual(test)
    balance.jacobian(trial, test, ufl.Coefficient(space))
    if effect.bound is not None:
        _try_bound(term, balance, trial, test)


def _try_bound(term: Term, balance: Balance, trial: Any, test: Any) -> None:
    """Form what a friction with its stress at points consists of."""
    import basix.ufl

    size, degree = components_of(term, balance), DEGREE
    element = basix.ufl.quadrature_element("triangle", value_shape=(size,), degree=degree)
    space = ufl.FunctionSpace(balance.field.ufl_function_space().ufl_domain(), element)
    friction = PointFriction(term, balance, ufl.Coefficient(space), ufl.Coefficient(space), degree)
    _require_scalar("the strength of a bound", friction.strength())
    friction.jacobian(trial, test)
    friction.residual(test)
    friction.creep()
    friction.loss()


def _require_scalar(what: str, found: Any) -> None:
    try:
        value = ufl.as_ufl(found)
    except (TypeError, ValueError):
        value = None
    if not isinstance(value, ufl.classes.Expr) or isinstance(value, ufl.classes.Condition):
        raise ValueError(f"{what} gives {type(found).__name__}, not a number")
    if value.ufl_shape != ():
        raise ValueError(f"{what} gives a value of shape {value.ufl_shape}, not one number")


def _balance(effect: Effect) -> tuple[Term, Balance]:
    """Return the effect and the balance of it alone, with nothing but symbols in it."""
    import basix.ufl  # not for those without effects of their own

    def element(degree: int, size: int) -> Any:
        return basix.ufl.element("Lagrange", "triangle", degree, shape=(size,))

    mesh = ufl.Mesh(element(1, 2))
    space = ufl.FunctionSpace(mesh, element(DEGREE, 2 * effect.needs.placements))
    fibres = (ufl.Constant(mesh, shape=(2,)), ufl.Constant(mesh, shape=(2,)))
    values = {
        p.name: (ufl.Constant(mesh), ufl.Constant(mesh)) if p.per_family else ufl.Constant(mesh)
        for p in effect.parameters
    }
    rate = Rate((ufl.Constant(mesh), ufl.Constant(mesh)), (ufl.Coefficient(space),))
    term = Term(effect, values, 1)
    return term, Balance(
        terms=() if effect.set_valued else (term,),
        fibres=fibres,
        field=ufl.Coefficient(space),
        rate=rate if effect.needs.history else None,
        degree=DEGREE,
        quadrature=2 * DEGREE,
        held_edges=(ufl.ds(0), ufl.ds(0)),
    )
