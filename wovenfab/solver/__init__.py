"""The equilibrium of a sheet under prescribed placements.

One iteration of Newton's method, in order:

1. ``NewtonSolver.evaluate_residual`` assembles the force of the present placements
   (``Problem.evaluate_residual``); before the prescribed placements are attained, they are
   lifted, so that one full step attains them. Where friction has its stress at quadrature points,
   that is an unknown as well (``InteriorPoint``).
2. ``NewtonSolver.test`` ends the solve if forces balance (``Convergence.reason``) and friction
   obeys its law (``InteriorPoint.obeys_law``), or if nothing is gained any more.
3. ``NewtonSolver.evaluate_jacobian`` assembles the tangent.
4. ``LinearSolver.solve`` gives Newton's step: with a new Cholesky factor, or by conjugate
   gradients with an older one, by what costs less. The factor counts negative eigenvalues.
5. ``NewtonSolver.limit_step`` changes the step:
   ``TangentSpectrum.shift`` replaces it where the tangent is indefinite and a run follows
   branches; ``InteriorPoint.correct`` adds the friction at points; ``CrossingLimit.limit`` keeps
   f_1 × f_2 positive; ``LineSearch.along`` shortens it until the potential falls enough, and
   where that is by an indefinite tangent, the step of the positive part is taken instead
   (``TangentSpectrum.replace``). ``Problem.advance`` takes the step for the stresses, too.

``EquilibriumSolver.solve`` runs the iterations, starts again with stress at points where the
smooth friction law fails, and lets ``TangentSpectrum.judge`` count the negative eigenvalues at
the solution. ``diagnose`` names the cause of a failure.

PETSc's SNES (newtonls) runs the loop. Its monitors and viewers act, as do the options of its
linear solver (``ksp_``, ``pc_``, ``mat_mumps_``), which may replace the Cholesky factorisation.
Convergence test and line search are those above: ``snes_atol``,
``snes_rtol`` and ``snes_stol`` have no effect; ``snes_max_it`` ends a solve as
``solver.max_iterations`` does; ``snes_linesearch_type`` other than ``basic`` searches once more
along the shortened step.
"""
