"""Fields at each step as dolfinx functions: ``env/enter python3 examples/fields.py``."""

import numpy as np
import ufl
from mpi4py import MPI  # with PyPI's wheels, before dolfinx

# isort: split
from dolfinx import fem

import wovenfab

case = wovenfab.read_case(
    "configs/elastic-1x3.yaml", {"program.steps": 4, "discretisation.mesh_size": "100 mm"}
)
for step in wovenfab.steps(case):
    angle = step.field("shear_angle")  # a dolfinx function on the sheet
    area = MPI.COMM_WORLD.allreduce(
        fem.assemble_scalar(fem.form(ufl.conditional(ufl.gt(abs(angle), 0.05), 1.0, 0.0) * ufl.dx))
    )
    first, second = step.displacements  # of family 1 and 2, in m; they may jump along yarns
    largest = MPI.COMM_WORLD.allreduce(np.abs(first.x.array).max(), op=MPI.MAX)
    if MPI.COMM_WORLD.rank == 0:
        print(
            f"{1e3 * step.displacement:5.1f} mm {step.force:8.3f} N: sheared by more than 0.05 rad "
            f"on {1e4 * area:6.1f} cm2, largest displacement {1e3 * largest:.1f} mm"
        )
