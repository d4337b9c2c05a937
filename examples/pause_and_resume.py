"""Pause, observe and resume from Python; and two simulations that are alive at once."""

import numpy as np

import wovenfab as wf  # before dolfinx

# isort: split
from mpi4py import MPI

corners, names = [(0, 0), (0.3, 0), (0.3, 0.1), (0, 0.1)], ["bottom", "right", "top", "left"]
sheet = wf.fibre_sheet(corners, names, wf.directions((np.pi / 4, -np.pi / 4)), 0.05, names[1::2])
EDGES = [wf.clamp("left"), wf.move("right", (wf.PROGRAM, 0.0))]
PROGRAM = wf.program(wf.Cycles([0.02], max_velocity=[0.1], steps=8))


def simulation(stiffness: float) -> wf.Simulation:
    """Return a loop with friction, for a shear stiffness (N/m)."""
    effects = [wf.stretch(5e5), wf.shear(stiffness), wf.bending(0.02), wf.coupling(1e6)]
    effects += [wf.slip_friction(2e3, 100.0), wf.spin_friction(0.5, 10.0)]
    model = wf.build_model(sheet, effects, EDGES, wf.Numerics(2))
    return wf.Simulation(wf.Problem(model), PROGRAM, "bdf2", output=wf.Output(fields=()))


with simulation(40.0) as soft, simulation(80.0) as stiff:  # each has its own state
    for one, other in zip(soft.steps(), stiff.steps(), strict=True):
        if MPI.COMM_WORLD.rank == 0 and one.number % 4 == 0:
            print(f"{1e3 * one.displacement:4.1f} mm  {one.force:7.4f} N  {other.force:7.4f} N")

with simulation(40.0) as begun:
    paused = wf.simulate(begun, "results/loop", until=0.3)  # s; a checkpoint is written
with simulation(40.0) as again:
    whole = wf.simulate(again, "results/loop", resume=True)
if MPI.COMM_WORLD.rank == 0:
    print(
        paused.summary["outcome"], len(paused.history["force"]), "of", len(whole.history["force"])
    )
