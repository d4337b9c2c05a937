"""One loop in three lines, and a picture of it: ``env/enter python3 examples/one_loop.py``.

Works the same under ``mpirun``.
"""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from mpi4py import MPI

import wovenfab

case = wovenfab.read_case("configs/bias-1x3.yaml", {"program.amplitudes": "40 mm"})
run = wovenfab.simulate(case)
force = run.history["force"]

if MPI.COMM_WORLD.rank == 0:
    print(run)
    figure, axes = plt.subplots(figsize=(5, 3.5), layout="constrained")
    axes.plot(1e3 * run.history["displacement"], force)
    axes.set(xlabel="displacement (mm)", ylabel="force (N)")
    figure.savefig("one_loop.png", dpi=150)
