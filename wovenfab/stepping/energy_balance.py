"""Work and dissipated energy since the start, summed over accepted steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.model.memory import attributes, take_attributes
from wovenfab.model.model import preserved
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.stepping.schemes import Scheme, StepError
from wovenfab.stepping.state import State

Array = NDArray[np.float64]
#: Sums over the steps.
SUMS = "work", "dissipated", "dissipated_error"


@dataclass(frozen=True)
class Forces:
    """What acts at one time, on this rank's own unknowns.

    Attributes:
        force: Internal force less the dead loads, which is what edges must hold, N.
        load: Dead loads, N.
        power: Dissipated power by effect on all ranks, W.
        plastic: Part of ``force`` that set-valued friction exerts, N; 0 without any.
        mean_plastic: That part in the mean of the step that ends here, N.
    """

    force: Array
    load: Array
    power: Mapping[str, float]
    plastic: Array | float = 0.0
    mean_plastic: Array | float = 0.0

    def mean(self, other: Forces) -> Forces:
        """Return the mean of two times: the trapezoidal rule, second order.

        Set-valued friction slides in all of a step: it does no work before it has attained
        its bound.
        """
        return Forces(
            (self.force - self.plastic + other.force - other.plastic) / 2 + other.mean_plastic,
            (self.load + other.load) / 2,
            {name: (self.power[name] + power) / 2 for name, power in other.power.items()},
        )


class EnergyBalance:
    """Work done on a sheet and energy dissipated in it.

    Attributes:
        work: External work, J.
        dissipated: Dissipated energy (J) by effect.
        dissipated_error: Estimated error of all dissipated energy by the time steps, J.
        forces: Those at the last accepted state.
        error: Estimated error of the last step in time, where it was measured.
    """

    def __init__(self, solver: EquilibriumSolver, scheme: Scheme) -> None:
        """Start with zero.

        Args:
            solver: Solver of the problem.
            scheme: The time scheme.
        """
        model = solver.problem.model
        self._solver, self._model, self._stage = solver, model, scheme.stage
        self.work = self.dissipated_error = 0.0
        self.dissipated = {e.name: 0.0 for e in model.effects if e.loses}
        self.error: StepError | None = None
        own, zero = model.placements.owned, dict.fromkeys(self.dissipated, 0.0)
        self._own = own
        self.forces = Forces(np.zeros(own), np.zeros(own), zero)

    def begin(self) -> None:
        """Take the forces of the present state as those at the start of the program."""
        force, load = self._solver.problem.force, self._model.loading.force()
        self.forces = replace(self.forces, force=force, load=load)

    def snapshot(self) -> dict[str, Any]:
        """Return the sums, and the forces and error of the last step."""
        error = asdict(self.error) if self.error else None
        return {**attributes(self, *SUMS), "forces": asdict(self.forces), "error": error}

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with those of a snapshot."""
        take_attributes(self, snapshot, *SUMS)
        forces: dict[str, Any] = {
            name: value[: self._own] if isinstance(value, np.ndarray) else value
            for name, value in snapshot["forces"].items()
        }
        self.forces = Forces(**forces)
        if snapshot["error"]:
            self.error = StepError(**snapshot["error"])

    def add(self, state: State, until: float, jump: bool, error: StepError | None) -> None:
        """Add a step and finish it; collective.

        Args:
            state: At the solved stage state of the step.
            until: Time at its end, s.
            jump: The velocity jumped at its start.
            error: Its error in time, where that was measured.
        """
        model, problem = self._model, self._solver.problem
        step = until - state.time
        power, loads = model.dissipated_power(), model.loading.force()
        plastic = self._solver.plastic_force(), self._solver.mean_plastic_force()
        stage = Forces(problem.force, loads, power, *plastic)
        lost = model.dissipated_energy()
        change = state.finish(until, jump)
        now, mean = self._now_and_mean(stage, state, jump)
        moved = change[: self._own]
        self.work += problem.constraints.work(mean.force, moved)
        self.work += float(model.comm.allreduce(mean.load @ moved))
        for name, energy in lost.items():
            self.dissipated[name] += energy / self._stage
        for name, mean_power in mean.power.items():
            self.dissipated[name] += step * mean_power
        errors = [e.power if e else 0.0 for e in (self.error, error)]
        self.dissipated_error += step * sum(errors) / 2
        self.forces, self.error = now, error

    def _now_and_mean(self, stage: Forces, state: State, jump: bool) -> tuple[Forces, Forces]:
        """Return the forces at the end of a step and their mean over it."""
        if self._stage < 1:
            force, load = self._solver.problem.evaluate_force(), self._model.loading.force()
            mean = replace(stage, force=stage.force + stage.mean_plastic - stage.plastic)
            return Forces(force, load, stage.power), mean
        return stage, self._mean_after_jump(stage, state) if jump else self.forces.mean(stage)

    def _mean_after_jump(self, now: Forces, state: State) -> Forces:
        """Return the mean of a step whose velocity jumped at its start.

        Friction jumps with it to what it is at the end; all else is continuous.
        """
        model, problem, mean = self._model, self._solver.problem, self.forces.mean(now)
        if not model.rate_weights:
            return mean
        with preserved(model.field, model.friction):
            model.friction.value = 0.0
            after = problem.evaluate_force()
            model.field.x.array[:] = state.states[0]
            before = problem.evaluate_force()
        loads = now.load - self.forces.load  # after and before have the same ones
        force = now.force - now.plastic + now.mean_plastic
        return replace(mean, force=force + (before - after + loads) / 2, power=now.power)
