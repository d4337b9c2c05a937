"""An effect of one's own as an object, and a further potential in UFL: yarns on a soft bed."""

import numpy as np
import ufl

import wovenfab as wf  # before dolfinx

# isort: split
from mpi4py import MPI

from wovenfab.forms.kinematics import shear_tangent


def locking(point, values):
    """Return an energy (J/m^2) that grows with the fourth power of the shear."""
    return values["stiffness"] / 4 * shear_tangent(point.f, point.fibres) ** 4


LOCKING = wf.Effect(
    name="locking",
    summary="Shear that becomes stiff",
    parameters=(wf.Parameter("stiffness", "N/m", "stiffness at a shear of 45 degrees"),),
    energy=locking,
    resists=frozenset({"shearing"}),
)


def bed(displacements):
    """Return the energy (J) of springs of 2 kN/m^3 under the sheet."""
    return 2e3 / 2 * ufl.inner(displacements[0], displacements[0]) * ufl.dx


corners, names = [(0, 0), (0.3, 0), (0.3, 0.1), (0, 0.1)], ["bottom", "right", "top", "left"]
sheet = wf.fibre_sheet(corners, names, wf.directions((np.pi / 4, -np.pi / 4)), 0.05, names[1::2])
effects = [wf.stretch(5e5), wf.shear(40.0), wf.bending(0.02), LOCKING(300.0)]
edges = [wf.clamp("left"), wf.move("right", (wf.PROGRAM, 0.0))]
model = wf.build_model(sheet, effects, edges, wf.Numerics(2), potentials={"bed": bed})
run = wf.simulate(wf.Simulation(wf.Problem(model), wf.program(wf.Ramp(0.02, steps=4))))
if MPI.COMM_WORLD.rank == 0:
    print({name: run.history[name][-1] for name in ("energy_locking", "energy_bed", "imbalance")})
