"""A sheet from any dolfinx mesh with tagged edges, and one that wovenfab meshes along the yarns."""

import numpy as np

import wovenfab as wf  # before dolfinx

# isort: split
from dolfinx import mesh
from mpi4py import MPI

YARNS = wf.directions((np.pi / 4, -np.pi / 4))
EFFECTS = [wf.stretch(5e5), wf.shear(40.0), wf.bending(0.02)]  # N/m, N/m, N m
EDGES = [wf.clamp("left"), wf.move("right", (wf.PROGRAM, 0.0))]


def own_mesh() -> wf.Sheet:
    """Return a rectangle of 300 mm by 100 mm."""
    shared = mesh.GhostMode.shared_facet  # ranks need the cells beside their own
    ends = [[0.0, 0.0], [0.3, 0.1]]
    plane = mesh.create_rectangle(MPI.COMM_WORLD, ends, [12, 4], ghost_mode=shared)
    left = mesh.locate_entities_boundary(plane, 1, lambda x: np.isclose(x[0], 0.0))
    right = mesh.locate_entities_boundary(plane, 1, lambda x: np.isclose(x[0], 0.3))
    facets, numbers = np.concatenate([left, right]), np.repeat([1, 2], [len(left), len(right)])
    order = np.argsort(facets)
    tags = mesh.meshtags(plane, 1, facets[order], numbers[order].astype(np.int32))
    return wf.Sheet(plane, tags, {"left": 1, "right": 2}, YARNS)


def along_the_yarns() -> wf.Sheet:
    """Return the same sheet, whose cells follow the yarns."""
    corners, names = [(0, 0), (0.3, 0), (0.3, 0.1), (0, 0.1)], ["bottom", "right", "top", "left"]
    return wf.fibre_sheet(corners, names, YARNS, mesh_size=0.025, held=("left", "right"))


for sheet in (own_mesh(), along_the_yarns()):
    model = wf.build_model(sheet, EFFECTS, EDGES, wf.Numerics(degree=3))
    run = wf.simulate(wf.Simulation(wf.Problem(model), wf.program(wf.Ramp(0.02, steps=4))))
    if MPI.COMM_WORLD.rank == 0:
        print(f"{model.unknowns} unknowns: {run.history['force'][-1]:.4g} N at 20 mm")
