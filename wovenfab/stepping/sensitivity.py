"""Derivatives of a run by material parameters: the tangent-linear equations of each step.

After each step the linear equations of ``wovenfab.forms.balance`` are solved with the tangent at
its solution, one right-hand side for each parameter. The force that is conjugate to the program is
the work of the internal force on w, the derivative of prescribed displacements by the program: its
derivative is w.(K du + b) with the tangent K and the right-hand side b before boundary conditions,
and K w is formed once for all parameters.

Internal variables have derivatives of their own, which their updates carry on.

The lengths of the steps are taken as given. Where set-valued friction is about to stick or to
slide, the derivative is one of the two one-sided ones, or between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.forms.effect import Target, Term, along_fields, by_parameter
from wovenfab.model.assembly import Sum, assemble_scalar, compile_sums
from wovenfab.model.memory import VariableSlopes
from wovenfab.model.model import Model, preserved
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.friction_sensitivity import FrictionSensitivity
from wovenfab.stepping.schemes import Scheme

Array = NDArray[np.float64]
#: Error of a solution in the energy norm, relative, where an older factor is used.
ACCURACY = 1e-9


@dataclass(frozen=True)
class Derivatives:
    """Derivatives of an accepted state by each parameter, in SI units; shape (parameters,).

    Attributes:
        force: Of the force that is conjugate to the program (N by the parameter's unit).
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
        dissipation: bool = True,
    ) -> None:
        """Compile the forms; collective.

        Args:
            solver: Solver of the problem.
            scheme: The time scheme.
            targets: The parameters.
            dissipation: Differentiate the dissipated energy, too.

        Raises:
            TargetError: If the scene has no such parameter.
        """
        problem = solver.problem
        require_targets(problem.model, targets)
        self.targets = tuple(targets)
        self._solver, self._problem, self._stage = solver, problem, scheme.stage
        self._dissipation = dissipation
        self._virtual: Array = np.zeros(0)  # w at the end of the step
        self._compiled: dict[int, tuple[Model, dict[str, Sum], FrictionSensitivity | None]] = {}
        self._directions = Directions(problem.model, targets)
        self._forms()
        size = problem.model.field.x.array.size
        # Derivatives of the last accepted states that rates use and of the stage state.
        self._states = [np.zeros((len(targets), size)) for _ in range(max(2, scheme.memory))]
        self._now = np.zeros((len(targets), size))
        self._stresses: list[Array] = []
        zero: Array = np.zeros(len(targets))
        self._power = zero
        self.derivatives = Derivatives(zero, zero)
        self._b, self._x = (problem.residual.duplicate() for _ in range(2))

    @property
    def state(self) -> Array:
        """Derivatives of the last accepted state, with ghosts, shape (parameters, unknowns)."""
        return self._states[0]

    def begin(self, at_rest: bool, virtual: Array) -> None:
        """Differentiate the state that the program starts from; collective.

        Args:
            at_rest: Whether it is the state of reference, which depends on no parameter.
            virtual: w there: unknowns of this rank, with ghosts.
        """
        zero = np.zeros(len(self.targets))
        if at_rest:
            return
        self._virtual = virtual
        friction = self._problem.model.friction
        with preserved(friction):
            friction.value = 0.0
            force = self._solve()
        self._states = [self._now.copy() for _ in self._states]
        self.derivatives = Derivatives(force, zero)

    def solve(self, step: float, jump: bool, virtual: Array) -> None:
        """Differentiate the stage state of a step at its solution; collective.

        Args:
            step: Length of the step, s.
            jump: The velocity jumps at its start.
            virtual: w at its end: unknowns of this rank, with ghosts.
        """
        self._virtual = virtual
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
        for k in range(len(self.targets)):
            self._set(k)
            self._directions.update(k)
        self._states = [self._now.copy(), *self._states[:-1]]

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._b.destroy()
        self._x.destroy()

    def _forms(self) -> tuple[Model, dict[str, Sum], FrictionSensitivity | None]:
        """Return the forms of the model as it is solved now: friction may have changed."""
        model = self._problem.model
        if id(model) not in self._compiled:
            points = None
            others = self._directions.others
            forms = sensitivity_forms(model, self.targets, self._directions)
            if self._problem.friction:
                points = FrictionSensitivity(self._problem, self.targets, others)
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
        virtual, now, self._stresses = self._virtual[:own], self._directions.now, []
        for k in range(len(self.targets)):
            self._directions.set(k, self._states)
            self._assemble(forms, k)
            if points:
                points.add_force(k, self._b)
            self._b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            force[k] = virtual @ self._b.array_r
            fem_petsc.set_bc(self._b, problem.constraints.bcs, alpha=0.0)
            linear.solve(self._b, self._x, ACCURACY)
            now.x.array[:own] = -self._x.array_r
            now.x.scatter_forward()
            self._now[k] = now.x.array
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
            self._directions.set(k, self._states)
            self._assemble(forms, k)
            if points:
                self._problem.add_friction_force(self._b, self._stresses[k])
            self._b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            force[k] = self._virtual[:own] @ self._b.array_r + action @ self._now[k][:own]
        return self._sum(force)

    def _set(self, k: int) -> None:
        """Set the changes of all states by a parameter."""
        self._directions.set(k, self._states)
        self._directions.now.x.array[:] = self._now[k]

    def _assemble(self, forms: dict[str, Sum], k: int) -> None:
        """Put the derivative of the residual for fixed present state into the vector."""
        with self._b.localForm() as local:
            local.set(0.0)
        for form in (*forms[f"residual {k}"].values(), *forms["residual along"].values()):
            fem_petsc.assemble_vector(self._b, form)

    def _dissipated(self, step: float, jump: bool) -> Array:
        """Return the derivatives of the energy that is dissipated in the step, J by the unit.

        As :class:`~wovenfab.stepping.energy_balance.EnergyBalance` sums it.
        """
        _, forms, _ = self._forms()
        power, loss = np.zeros((2, len(self.targets)))
        for k in range(len(self.targets)):
            self._set(k)
            power[k] = self._value(forms[f"power {k}"], forms["power along"])
            loss[k] = self._value(forms[f"loss {k}"], forms["loss along"]) / self._stage
        trapezoidal = self._stage == 1 and not jump
        mean = (self._power + power) / 2 if trapezoidal else power
        self._power = power
        return np.asarray(step * mean + loss)

    def _value(self, *sums: Sum) -> float:
        return sum(assemble_scalar(forms, self._problem.model.comm) for forms in sums if forms)

    def _sum(self, mine: Array) -> Array:
        return np.asarray(self._problem.model.comm.allreduce(mine))


class TargetError(Exception):
    """No effect of the scene has a parameter of that name."""


class Directions:
    """Fields along which what a model depends on changes, by one parameter at a time.

    Attributes:
        now: Change of the present state, m.
        others: All else that states leave behind, each with the field along which it changes.
    """

    def __init__(self, model: Model, targets: Sequence[Target]) -> None:
        """Compile how internal variables change; collective.

        Args:
            model: The model.
            targets: The parameters.
        """
        space, memory = model.space, model.memory
        self.now, earlier = fem.Function(space), [fem.Function(space) for _ in model.history]
        self._earlier, self._variables = earlier, []
        self.others = list(zip(model.history, earlier, strict=True))
        if memory:
            self._earlier = earlier or [fem.Function(space)]
            self.others.append((memory.before, self._earlier[0]))
            self._variables = [VariableSlopes(v, len(targets)) for v in memory.variables]
            self.others += [pair for v in self._variables for pair in v.pairs]
            for variables in self._variables:
                variables.compile(memory, [(model.field, self.now), *self.others], targets)

    def set(self, target: int, states: Sequence[Array]) -> None:
        """Set all but the change of the present state.

        Args:
            target: Number of the parameter.
            states: Changes of the earlier states by each parameter, latest first.
        """
        for field, values in zip(self._earlier, states, strict=False):
            field.x.array[:] = values[target]
        for variables in self._variables:
            variables.set(target)

    def update(self, target: int) -> None:
        """Update the derivatives of the internal variables; all changes must be set."""
        for variables in self._variables:
            variables.update(target)


def require_targets(model: Model, targets: Sequence[Target]) -> None:
    """Check that each parameter is one of the scene.

    Raises:
        TargetError: If one is not.
    """
    terms = (*model.balance.terms, *(f.term for f in model.friction_stresses))
    known = {(t.effect.name, p.name) for t in terms for p in t.effect.parameters}
    for target in targets:
        if (target.effect, target.parameter) not in known:
            names = ", ".join(sorted(f"{e}.{p}" for e, p in known))
            raise TargetError(f"{target} is no parameter of this scene; it has {names}")


def sensitivity_forms(
    model: Model, targets: Sequence[Target], directions: Directions
) -> dict[str, Sum]:
    """Return the compiled forms of tangent-linear equations; collective.

    They are derivatives of the ``residual``, of the dissipated ``power``, and of the ``loss`` in
    the step that depends on no rate: by each parameter for fixed states (``residual 0``), and
    along the fields (``residual along``). Those of the residual are for a fixed present state.

    Args:
        model: As it is solved. Its friction stresses are held fixed here.
        targets: The parameters.
        directions: The fields along which all changes.
    """
    at_points = {f.term.effect.name: f for f in model.friction_stresses}
    balance, test = model.balance, ufl.TestFunction(model.space)
    smooth = [t for t in balance.terms if t.effect.name not in at_points]
    lasting = [t for t in smooth if t.effect.dissipation or t.effect.memory]
    rated = [t for t in balance.terms if t.effect.dissipation]  # the power is that of the laws
    losing = [f.term for f in model.friction_stresses if f.term.effect.set_valued]
    losing += [t for t in balance.terms if t.effect.releases]
    everything = [(model.field, directions.now), *directions.others]

    def loss(term: Term) -> Any:
        if term.effect.set_valued:
            return replace(at_points[term.effect.name], term=term).loss()
        assert model.memory is not None
        return model.memory.loss(term)

    def residual(term: Term) -> Any:
        return balance.alone(term).residual(test)

    def power(term: Term) -> Any:
        return balance.alone(term).power()

    def on_lines(family: int, term: Term) -> Any:
        part = model.placements.families[family]
        lines = balance.alone(term).lines(family, fem.Function(part, model.field.x))
        return sum(line.residual(ufl.TestFunction(part)) for line in lines) if lines else None

    sums: dict[str, list[Any]] = {
        "residual along": [sum(along_fields(residual(t), directions.others) for t in lasting)],
        "power along": [sum(along_fields(power(t), everything) for t in rated)],
        "loss along": [along_fields(loss(t), everything) for t in losing],
    }
    for i, target in enumerate(targets):
        lines = [by_parameter(target, smooth, partial(on_lines, family)) for family in (0, 1)]
        sums[f"residual {i}"] = [by_parameter(target, smooth, residual), *lines]
        sums[f"power {i}"] = [by_parameter(target, rated, power)]
        sums[f"loss {i}"] = [by_parameter(target, losing, loss)]
    present = {
        name: {
            str(i): f for i, f in enumerate(forms) if isinstance(f, ufl.Form) and not _vanishes(f)
        }
        for name, forms in sums.items()
    }
    return compile_sums(present, model.comm)


def _vanishes(form: Any) -> bool:
    """Return whether a form is zero once it is differentiated."""
    expanded = ufl.algorithms.apply_derivatives.apply_derivatives(
        ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering(form)
    )
    return not expanded.integrals()
