"""A loop of one's own: prescribe, solve, look, and keep or reject; no step size control."""

import numpy as np

import wovenfab as wf  # before dolfinx

# isort: split
from mpi4py import MPI

corners, names = [(0, 0), (0.3, 0), (0.3, 0.1), (0, 0.1)], ["bottom", "right", "top", "left"]
sheet = wf.fibre_sheet(corners, names, wf.directions((np.pi / 4, -np.pi / 4)), 0.05, names[1::2])
effects = [wf.stretch(5e5), wf.shear(40.0), wf.bending(0.02), wf.coupling(1e6)]
effects += [wf.slip_friction(2e3, law="coulomb")]  # N/m^2; its stress is a variable at points
edges = [wf.clamp("left"), wf.move("right", (wf.PROGRAM, 0.0))]
problem = wf.Problem(wf.build_model(sheet, effects, edges, wf.Numerics(2)))
solver = wf.EquilibriumSolver(problem, wf.SolverOptions(tolerance=1e-10))

displacement, step = 0.0, 0.004
while displacement < 0.02 - 1e-12:
    result = solver.advance(displacement + step)
    if not result.converged or result.negatives or result.iterations > 12:
        solver.reject()  # the state is that of before
        step /= 2
        continue
    solver.accept()
    displacement += step
    (fx, fy), energy = problem.reactions()["right"], problem.energy()  # collective
    if MPI.COMM_WORLD.rank == 0:
        print(f"{1e3 * displacement:4.1f} mm  {fx:8.4f} N  {energy:.3e} J  {result.iterations}")
solver.destroy()
