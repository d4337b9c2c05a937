"""A Dirichlet condition of dolfinx, a dead load, and a grip that turns: none needs a case."""

import numpy as np

import wovenfab as wf  # before dolfinx

# isort: split
from dolfinx import fem
from mpi4py import MPI

corners, names = [(0, 0), (0.3, 0), (0.3, 0.1), (0, 0.1)], ["bottom", "right", "top", "left"]
sheet = wf.fibre_sheet(corners, names, wf.directions((0.0, np.pi / 2)), 0.05, names[1::2])


def turned(x, y, program, second):
    """Return the displacement (m) along y of an edge that turns about its middle."""
    return 0.1 * np.sin(program / 0.1) * (x - 0.3) + (y - 0.05) * (np.cos(program / 0.1) - 1)


edges = [
    wf.clamp("left", rotation=True),
    wf.move("right", (lambda x, y, program, second: -np.sin(program / 0.1) * (y - 0.05), turned)),
    wf.load("top", (0.0, 0.5)),  # N/m
]
effects = [wf.stretch(5e5), wf.shear(40.0), wf.bending(0.02)]
model = wf.build_model(sheet, effects, edges, wf.Numerics(2))
pin = fem.locate_dofs_geometrical(model.space, lambda x: np.isclose(x[0], 0.15) & (x[1] < 1e-9))
given = fem.Function(model.space)  # m; it may be changed between steps
problem = wf.Problem(model, bcs={"pin": fem.dirichletbc(given, pin)})
with wf.Simulation(problem, wf.program(wf.Ramp(0.01, steps=4))) as simulation:
    for step in simulation.steps():
        given.x.array[1::2] = 1e-4 * (step.number + 1)  # lifted by 0.1 mm a step
        if MPI.COMM_WORLD.rank == 0:
            print(f"force {step.force:8.4f} N, pin {step.reactions['pin']} N")
