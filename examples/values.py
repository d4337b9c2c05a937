"""Functionals in UFL, values at points and along a yarn, and the history as arrays."""

import numpy as np
import ufl

import wovenfab as wf  # before dolfinx

# isort: split
from dolfinx import fem
from mpi4py import MPI

corners, names = [(0, 0), (0.3, 0), (0.3, 0.1), (0, 0.1)], ["bottom", "right", "top", "left"]
sheet = wf.fibre_sheet(corners, names, wf.directions((np.pi / 4, -np.pi / 4)), 0.05, names[1::2])
effects = [wf.stretch(5e5), wf.shear(40.0), wf.bending(0.02), wf.coupling(1e6)]
edges = [wf.clamp("left"), wf.move("right", (wf.PROGRAM, 0.0))]
model = wf.build_model(sheet, effects, edges, wf.Numerics(2))
probes = {"middle": wf.circle_zone((0.15, 0.05), 0.01), "corner": wf.PointProbe((0.3, 0.1))}
program, out = wf.program(wf.Ramp(0.02, steps=4)), wf.Output(probes=probes)
simulation = wf.Simulation(wf.Problem(model), program, output=out)

first, second = simulation.displacements  # m, one a family; they share the solver's memory
bulge = fem.form(ufl.inner(second - first, second - first) * ufl.dx)
yarn = wf.points_of_yarn(sheet, wf.Yarn(family=1, through=(0.15, 0.05), points=5))
along = wf.PointFields(model, yarn, ["relative_displacement", "shear_angle"])


def look(step):
    """Print what the present state has; called after each step, on every rank."""
    slip = np.sqrt(MPI.COMM_WORLD.allreduce(fem.assemble_scalar(bulge)) / (0.3 * 0.1))
    angles = np.degrees(along.values()["shear_angle"].ravel())
    if MPI.COMM_WORLD.rank == 0:
        print(f"{1e3 * step.displacement:4.1f} mm: slip {1e6 * slip:6.2f} um", angles.round(1))


run = wf.simulate(simulation, observers=[look])
columns = dict(run.history)  # arrays by name; pandas.DataFrame(columns) is a table of them
if MPI.COMM_WORLD.rank == 0:
    print(columns["force_N"], columns["middle_shear_angle_rad"])
