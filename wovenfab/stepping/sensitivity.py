"""Derivatives of a run by material parameters: the tangent-linear equations of each step.

After each step the linear equations of ``forms.balance`` are solved with the tangent at its
solution, one right-hand side for each parameter. The force of an edge is the work of the internal
force on a unit displacement w of that edge: its derivative is w.(K du + b) with the tangent K
and the right-hand side b before boundary conditions, and K w is formed once for all parameters.

The lengths of the steps are taken as given. Where set-valued friction is about to stick or to
slide, the derivative is one of the two one-sided ones, or between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from petsc4py import PETSc

from forms.effect import Target
from wovenfab.model.assembly import Sum, assemble_scalar, compile_sums
from wovenfab.model.model import Model, preserved
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.stepping.schemes import Scheme

if TYPE_CHECKING:
    from wovenfab.solver.point_friction import PointSensitivity

Array = NDArray[np.float64]
#: Error of a solution in the energy norm, relative, where an older factor is used.
ACCURACY = 1e-9


@dataclass(frozen=True)
class Derivatives:
    """Derivatives of an accepted state by each parameter, in SI units; shape (parameters,).

    Attributes:
        force: Of the force of the chosen edge in the chosen direction (N by the parameter's unit).
        dissipated: Of all energy dissipated since the start (J by the unit).
    """

    force: Array
    dissipated: Array


class TangentLinear:
    """Derivatives of the states of a run by parameters; collective.

    Attributes:
        targets: The parameters.
        derivatives: Of the last accepted state.
    """

    def __init__(
        self,
        solver: EquilibriumSolver,
        scheme: Scheme,
        targets: Sequence[Target],
        virtual: Array,
        dissipation: bool = True,
    ) -> None:
        """Compile the forms; collective.

        Args:
            solver: Solver of the problem.
            scheme: The time scheme.
            targets: The parameters.
            virtual: Unit displacement of the edge whose force is differentiated: unknowns of this
                rank, with ghosts.
            dissipation: Differentiate the dissipated energy, too.

        Raises:
            TargetError: If the scene has no such parameter.
        """
        problem = solver.problem
        require_targets(problem.model, targets)
        self.targets = tuple(targets)
        self._solver, self._problem, self._stage = solver, problem, scheme.stage
        self._virtual, self._dissipation = virtual, dissipation
        self._compiled: dict[int, tuple[Model, SensitivityForms, PointSensitivity | None]] = {}
        self._forms()
        size = problem.model.field.x.array.size
        # Derivatives of the last two accepted states and of the stage state.
        self._states = [np.zeros((len(targets), size)) for _ in range(2)]
        self._now = np.zeros((len(targets), size))
        self._stresses: list[Array] = []
        zero: Array = np.zeros(len(targets))
        self._power = zero
        self.derivatives = Derivatives(zero, zero)
        self._b, self._x = (problem.residual.duplicate() for _ in range(2))

    def begin(self, at_rest: bool) -> None:
        """Differentiate the state that the program starts from; collective.

        Args:
            at_rest: Whether it is the state of reference, which depends on no parameter.
        """
        zero = np.zeros(len(self.targets))
        if at_rest:
            return
        friction = self._problem.model.friction
        with preserved(friction):
            friction.value = 0.0
            force = self._solve()
        self._states = [self._now.copy() for _ in self._states]
        self.derivatives = Derivatives(force, zero)

    def solve(self, step: float, jump: bool) -> None:
        """Differentiate the stage state of a step at its solution; collective.

        Args:
            step: Length of the step, s.
            jump: The velocity jumps at its start.
        """
        force = self._solve()
        dissipated = self.derivatives.dissipated
        if self._dissipation:
            dissipated = dissipated + self._dissipated(step, jump)
        self.derivatives = Derivatives(force, dissipated)

    def finish(self) -> None:
        """Go from the stage state to the end of the step, where the model is now; collective."""
        if self._stage < 1:
            before = self._states[0]
            self._now = before + (self._now - before) / self._stage
            self.derivatives = Derivatives(self._force_at_end(), self.derivatives.dissipated)
        self._states = [self._now.copy(), self._states[0]]

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._b.destroy()
        self._x.destroy()

    def _forms(self) -> tuple[Model, SensitivityForms, PointSensitivity | None]:
        """Return the forms of the model as it is solved now: friction may have changed."""
        model, stress = self._problem.model, self._problem.point_stress
        if id(model) not in self._compiled:
            points = None
            forms = sensitivity_forms(model, self.targets)
            if stress:
                from wovenfab.solver.point_friction import PointSensitivity

                points = PointSensitivity(model, stress, self.targets, forms.earlier)
            self._compiled[id(model)] = model, forms, points
        return self._compiled[id(model)]

    def _solve(self) -> Array:
        """Solve for the derivatives at the present state; return those of the force."""
        _, forms, points = self._forms()
        problem, linear = self._problem, self._solver.linear
        if points:
            points.linearise()
            problem.model.last.x.array[:] = problem.model.field.x.array
            problem.size_of_tangent(self._solver.matrix)
            linear.definite = False
        else:
            self._solver.tangent()
        action = self._problem.stiffness_along(self._virtual)
        own, force = len(action), np.zeros(len(self.targets))
        virtual, self._stresses = self._virtual[:own], []
        for k in range(len(self.targets)):
            self._set_earlier(forms, k)
            self._assemble(forms, k)
            if points:
                points.add_force(k, self._b)
            self._b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            force[k] = virtual @ self._b.array_r
            fem_petsc.set_bc(self._b, problem.constraints.bcs, alpha=0.0)
            linear.solve(self._b, self._x, ACCURACY)
            forms.now.x.array[:own] = -self._x.array_r
            forms.now.x.scatter_forward()
            self._now[k] = forms.now.x.array
            force[k] -= action @ self._x.array_r
            if points and self._stage < 1:
                self._stresses.append(points.stress(k, -self._x.array_r))
        return self._sum(force)

    def _force_at_end(self) -> Array:
        """Return the derivatives of the force at the end of a step that was solved elsewhere in it.

        Stresses at points are those of the stage.
        """
        model, forms, points = self._forms()
        model.last.x.array[:] = model.field.x.array
        if points:
            points.hold()
        action = self._problem.stiffness_along(self._virtual)
        own, force = len(action), np.zeros(len(self.targets))
        for k in range(len(self.targets)):
            self._set_earlier(forms, k)
            self._assemble(forms, k)
            if points:
                points.add_force_of(self._stresses[k], self._b)
            self._b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            force[k] = self._virtual[:own] @ self._b.array_r + action @ self._now[k][:own]
        return self._sum(force)

    def _set_earlier(self, forms: SensitivityForms, k: int) -> None:
        for field, states in zip(forms.earlier, self._states, strict=False):
            field.x.array[:] = states[k]

    def _assemble(self, forms: SensitivityForms, k: int) -> None:
        """Put the derivative of the residual for fixed present state into the vector."""
        with self._b.localForm() as local:
            local.set(0.0)
        for form in (*forms.residual[k], *forms.residual_along):
            fem_petsc.assemble_vector(self._b, form)

    def _dissipated(self, step: float, jump: bool) -> Array:
        """Return the derivatives of the energy that is dissipated in the step, J by the unit.

        As :class:`~wovenfab.stepping.energy_balance.EnergyBalance` sums it.
        """
        _, forms, _ = self._forms()
        power, loss = np.zeros((2, len(self.targets)))
        for k in range(len(self.targets)):
            self._set_earlier(forms, k)
            forms.now.x.array[:] = self._now[k]
            power[k] = self._value((*forms.power[k], *forms.power_along))
            loss[k] = self._value((*forms.loss[k], *forms.loss_along)) / self._stage
        trapezoidal = self._stage == 1 and not jump
        mean = (self._power + power) / 2 if trapezoidal else power
        self._power = power
        return np.asarray(step * mean + loss)

    def _value(self, forms: Sum) -> float:
        return assemble_scalar(forms, self._problem.model.comm) if forms else 0.0

    def _sum(self, mine: Array) -> Array:
        return np.asarray(self._problem.model.comm.allreduce(mine))


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
    whole = model.balance  # the power is that of the laws, smooth or not
    space = model.space
    now, earlier = fem.Function(space), tuple(fem.Function(space) for _ in model.history)
    test = ufl.TestFunction(space)
    set_valued = [f for f in model.point_frictions if f.term.effect.set_valued]
    sums: dict[str, list[Any]] = {
        "residual along": [balance.residual_along(earlier, test)] if earlier else [],
        "power along": [whole.power_along(now, earlier)],
        "loss along": [f.loss_along(now, earlier) for f in set_valued],
    }
    for i, target in enumerate(targets):
        lines = [
            balance.lines_residual_by(
                target, family, fem.Function(part, model.field.x), ufl.TestFunction(part)
            )
            for family, part in enumerate(model.placements.families)
        ]
        sums[f"residual {i}"] = [balance.residual_by(target, test), *lines]
        sums[f"power {i}"] = [whole.power_by(target)]
        sums[f"loss {i}"] = [f.loss_by(target) for f in set_valued]
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
