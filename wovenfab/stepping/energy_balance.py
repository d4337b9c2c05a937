"""Forces and powers at one time, of which work and losses are summed.

Work and losses since the start, summed over accepted steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.stepping.schemes import Scheme
from wovenfab.stepping.state import State
from wovenfab.stepping.time_error import StepError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Forces:
    """What acts at one time, on this rank's own unknowns.

    Attributes:
        force: Internal force less the dead loads, which is what edges must hold, N.
        load: Dead loads, N.
        power: Dissipated power by effect on all ranks, W.
        plastic: Part of ``force`` that set-valued friction exerts, N; 0 without any.
    """

    force: Array
    load: Array
    power: Mapping[str, float]
    plastic: Array | float = 0.0

    def mean(self, other: Forces) -> Forces:
        """Return the mean of two times: the trapezoidal rule, second order.

        Set-valued friction acts in a step as it does at its end: it does no work before
        it has attained its bound.
        """
        return Forces(
            (self.force + other.force + other.plastic - self.plastic) / 2,
            (self.load + other.load) / 2,
            {name: (self.power[name] + power) / 2 for name, power in other.power.items()},
        )


class EnergyBalance:
    """What was put into a model and what it lost.

    Attributes:
        work: External work, J.
        dissipated: Dissipated energy (J) by effect.
        dissipated_error: Of all dissipated energy by the errors of steps, J.
        forces: Those at the last accepted state.
        error: Error of the last step in time, where it was measured.
    """

    def __init__(
        self, model: Model, constraints: Constraints, equilibrium: EquilibriumSolver, scheme: Scheme
    ) -> None:
        """Begin with nothing.

        Args:
            model: The compiled model.
            constraints: Its prescribed placements.
            equilibrium: Its solver.
            scheme: The time scheme.
        """
        self._model, self._constraints, self._equilibrium = model, constraints, equilibrium
        self._stage = scheme.stage
        self.work = self.dissipated_error = 0.0
        self.dissipated = {e.name: 0.0 for e in model.effects if e.dissipative}
        self.error: StepError | None = None
        own, nothing = model.placements.owned, dict.fromkeys(self.dissipated, 0.0)
        self._own = own
        self.forces = Forces(np.zeros(own), np.zeros(own), nothing)

    def begin(self) -> None:
        """Know the forces of the state in which the program begins."""
        force, load = self._equilibrium.force, self._model.loading.force()
        self.forces = replace(self.forces, force=force, load=load)

    def add(self, motion: State, until: float, jump: bool, error: StepError | None) -> None:
        """Add a step and finish it; collective.

        Args:
            motion: At the solved stage state of the step.
            until: Time at its end, s.
            jump: The velocity jumped at its start.
            error: Its error in time, where that was measured.
        """
        model, equilibrium = self._model, self._equilibrium
        step = until - motion.time
        plastic = equilibrium.plastic_force()
        lost, loads = model.dissipated_power(), model.loading.force()
        stage = Forces(equilibrium.force, loads, lost, plastic)
        sudden = model.dissipated_energy()
        change = motion.finish(until, jump)
        now, mean = self._now_and_mean(stage, motion, jump)
        moved = change[: self._own]
        self.work += self._constraints.work(mean.force, moved)
        self.work += float(model.comm.allreduce(mean.load @ moved))
        for name, energy in sudden.items():
            self.dissipated[name] += energy / self._stage
        for name, power in mean.power.items():
            self.dissipated[name] += step * power
        errors = [e.power if e else 0.0 for e in (self.error, error)]
        self.dissipated_error += step * sum(errors) / 2
        self.forces, self.error = now, error

    def _now_and_mean(self, stage: Forces, motion: State, jump: bool) -> tuple[Forces, Forces]:
        """Return the forces at the end of a step and their mean over it."""
        if self._stage < 1:
            force, load = self._equilibrium.evaluate_force(), self._model.loading.force()
            return Forces(force, load, stage.power), stage
        return stage, self._mean_after_jump(stage, motion) if jump else self.forces.mean(stage)

    def _mean_after_jump(self, now: Forces, motion: State) -> Forces:
        """Return the mean of a step whose velocity jumped at its start.

        Friction jumps with it to what it is at the end; all else is continuous.
        """
        model, mean = self._model, self.forces.mean(now)
        if not model.rate_weights:
            return mean
        field, end = model.field.x.array, model.field.x.array.copy()
        model.friction.value = 0.0
        after = self._equilibrium.evaluate_force()
        field[:] = motion.states[0]
        before = self._equilibrium.evaluate_force()
        field[:], model.friction.value = end, 1.0
        loads = now.load - self.forces.load  # after and before have the same ones
        return replace(mean, force=now.force + (before - after + loads) / 2, power=now.power)
