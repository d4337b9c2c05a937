"""Stiffness as a fem.Function and as a UFL expression, and changed between steps."""

import numpy as np
import ufl

import wovenfab as wf  # before dolfinx

# isort: split
from dolfinx import fem
from mpi4py import MPI

corners, names = [(0, 0), (0.3, 0), (0.3, 0.1), (0, 0.1)], ["bottom", "right", "top", "left"]
sheet = wf.fibre_sheet(corners, names, wf.directions((np.pi / 4, -np.pi / 4)), 0.05, names[1::2])

shear = fem.Function(fem.functionspace(sheet.mesh, ("DG", 0)))  # N/m, from a scan, say
shear.interpolate(lambda x: 40 + 20 * np.sin(20 * x[0]))
x = ufl.SpatialCoordinate(sheet.mesh)
weak = ufl.conditional(ufl.lt(x[1], 0.05), 4e5, 5e5)  # N/m, of the yarns of family 2
softening = fem.Constant(sheet.mesh, 1.0)

model = wf.build_model(
    sheet,
    [wf.stretch((5e5, weak)), wf.shear(softening * shear), wf.bending(0.02)],
    [wf.clamp("left"), wf.move("right", (wf.PROGRAM, 0.0))],
    wf.Numerics(degree=2),
)
with wf.Simulation(wf.Problem(model), wf.program(wf.Ramp(0.02, steps=8))) as simulation:
    for step in simulation.steps():
        if MPI.COMM_WORLD.rank == 0:
            print(f"{1e3 * step.displacement:4.1f} mm  {step.force:7.4f} N")
        if step.number == 4:  # half of the shear stiffness is lost from here on
            softening.value = 0.5
