"""Residual and tangent as UFL forms: a Newton loop of one's own, then vibrations by SLEPc."""

import numpy as np
import ufl

import wovenfab as wf  # before dolfinx

# isort: split
from dolfinx import fem
from dolfinx.fem import petsc
from petsc4py import PETSc
from slepc4py import SLEPc

corners, names = [(0, 0), (0.3, 0), (0.3, 0.1), (0, 0.1)], ["bottom", "right", "top", "left"]
sheet = wf.fibre_sheet(corners, names, wf.directions((np.pi / 4, -np.pi / 4)), 0.05, names[1::2])
edges = [wf.clamp("left"), wf.move("right", (wf.PROGRAM, 0.0))]
effects = [wf.stretch(5e5), wf.shear(40.0), wf.bending(0.02)]
model = wf.build_model(sheet, effects, edges, wf.Numerics(2, mixed=False))
problem, u, v = wf.Problem(model), model.field, ufl.TestFunction(model.space)
problem.prescribe(0.005)
bcs, x = problem.constraints.bcs, u.x.petsc_vec
# Parts of a sum have facets of their own: each is compiled for itself.
tangent, residual = ([*map(fem.form, model.forms[k].values())] for k in ("jacobian", "residual"))
A, b, ksp = problem.create_tangent(upper=False), x.duplicate(), PETSc.KSP().create(x.comm)
ksp.setOperators(A), ksp.setType("preonly"), ksp.getPC().setType("lu")
for _ in range(6):
    A.zeroEntries(), b.set(0.0), b.ghostUpdate()
    for K, f in zip(tangent, residual, strict=True):
        petsc.assemble_matrix(A, K, bcs=bcs), A.assemble(PETSc.Mat.AssemblyType.FLUSH)
        petsc.assemble_vector(b, f), petsc.apply_lifting(b, [K], [bcs], [x], -1.0)
    A.assemble(), b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
    petsc.set_bc(b, bcs, x, -1.0)
    PETSc.Sys.Print(f"residual {b.norm():.1e} N")
    ksp.solve(-b, b), x.axpy(1.0, b), u.x.scatter_forward()
M = petsc.assemble_matrix(fem.form(0.2 * ufl.inner(ufl.TrialFunction(model.space), v) * ufl.dx))
M.assemble(), M.zeroRowsColumns(problem.constraints.own + M.getOwnershipRange()[0], 1e-9)
eps = SLEPc.EPS().create(x.comm)  # of the mass of 0.2 kg/m^2, with held unknowns far away
eps.setOperators(A, M), eps.setProblemType(SLEPc.EPS.ProblemType.GHEP), eps.setDimensions(4)
eps.setTarget(0.0), eps.getST().setType("sinvert"), eps.solve()
PETSc.Sys.Print(*(f"{np.sqrt(eps.getEigenvalue(i).real) / 2 / np.pi:.2f} Hz" for i in range(4)))
