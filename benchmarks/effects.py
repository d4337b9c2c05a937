"""What each effect costs on the default case, and what leaving some out must save."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI

from benchmarks.figure import Figure
from wovenfab.case import read_case
from wovenfab.case.objects import sheet_of
from wovenfab.forms.effect import Needs
from wovenfab.study.effects import Cost, line, measure, printed, study, with_effects

CONFIGS = Path(__file__).parents[1] / "configs"
CASE, ELASTIC = CONFIGS / "bias-1x3.yaml", CONFIGS / "elastic-1x3.yaml"
SIZE = ("program.amplitudes=40mm", "time.steps_per_cycle=20")


def cost_of_effects() -> list[Figure]:
    """Print the table of costs; return what one placement and no second gradient save."""
    case = read_case(CASE, SIZE)
    sheet = sheet_of(case, MPI.COMM_WORLD)
    needs = {e.name: e.effect.needs for e in case.scene}

    def only(keep: Callable[[Needs], bool]) -> Cost:
        names = [name for name, n in needs.items() if keep(n)]
        return measure(with_effects(case, names), sheet)

    rows = study(case, MPI.COMM_WORLD, lambda row: print(line(row), flush=True))
    print(f"\n{printed(rows)}", flush=True)
    # What is compared is measured side by side, since machines change their speed.
    whole, smooth = only(lambda n: True), only(lambda n: not n.second_gradient)
    coupled, bonded = _tied(None), _tied("null")
    return [
        Figure(
            name="assembly with all effects over that without second gradients",
            value=whole.assembly / smooth.assembly,
            limit=2.0,
            unit="x",
            meaning=f"mean time of one tangent, {1e3 * whole.assembly:.0f} over "
            f"{1e3 * smooth.assembly:.0f} ms, {whole.unknowns} unknowns each",
            at_least=True,
        ),
        Figure(
            name="two tied placements over one",
            value=coupled.whole / bonded.whole,
            limit=2.5,
            unit="x",
            meaning=f"time of all steps on the same mesh, {coupled.whole:.1f} over "
            f"{bonded.whole:.1f} s, {coupled.unknowns} against {bonded.unknowns} unknowns, "
            "elastic",
            at_least=True,
        ),
    ]


def _tied(coupling: str | None) -> Cost:
    """Return what an elastic pull costs with stiffly tied placements, or with another coupling.

    The mesh is so fine that nearly all time goes into matrices.
    """
    pull = ["program={type: ramp, to: 40 mm, steps: 4}", "discretisation.mesh_size=10 mm"]
    tied = read_case(ELASTIC, [*pull, "effects.coupling.stiffness=1e12 N/m^3"])
    case = read_case(ELASTIC, [*pull, f"effects.coupling={coupling}"]) if coupling else tied
    return measure(case, sheet_of(tied, MPI.COMM_WORLD))
