"""The simulation of a case, and the same one made of the library's objects."""

import numpy as np

import wovenfab as wf  # before dolfinx

# isort: split
from mpi4py import MPI

case = wf.read_case(
    "configs/elastic-1x3.yaml", {"program.steps": 4, "discretisation.mesh_size": "100 mm"}
)
with wf.simulation_of(case, wf.sheet_of(case, MPI.COMM_WORLD)) as simulation:
    of_case = [step.force for step in simulation.steps()]

corners, names = [(0, 0), (0.9, 0), (0.9, 0.3), (0, 0.3)], ["bottom", "right", "top", "left"]
yarns = wf.directions((np.pi / 4, -np.pi / 4))
sheet = wf.fibre_sheet(corners, names, yarns, 0.1, held=["left", "right"])
terms = [term.effect(**term.values) for term in case.scene]  # numbers in SI units, as they are
edges = [wf.clamp("left"), wf.move("right", (wf.PROGRAM, 0.0))]
model = wf.build_model(sheet, terms, edges, wf.Numerics(case.discretisation.degree))
program = wf.program(wf.Ramp(case.program[0].to, steps=4))
with wf.Simulation(wf.Problem(model), program) as simulation:
    own = [step.force for step in simulation.steps()]
assert np.allclose(own, of_case, rtol=1e-9), (own, of_case)
if MPI.COMM_WORLD.rank == 0:
    print(own)
