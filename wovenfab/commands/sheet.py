"""The sheet of a case, with what is wrong with it told at its line of the case file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wovenfab.case import Case, CaseError

if TYPE_CHECKING:
    from wovenfab.sheet.sheet import Sheet


def sheet_for(case: Case) -> Sheet:
    """Return the meshed sheet of a case; collective.

    Raises:
        CaseError: If the geometry cannot be meshed or lacks an edge that the case names.
    """
    from mpi4py import MPI

    from wovenfab.sheet.gmsh_model import GeometryError
    from wovenfab.simulation.assemble import UnknownEdgeError, sheet_of

    try:
        return sheet_of(case, MPI.COMM_WORLD)
    except GeometryError as error:
        problem = case.problem("sheet.file", str(error))
    except UnknownEdgeError as error:
        problem = case.problem(
            f"boundary.{error.edge}",
            f"the sheet has no edge {error.edge!r}",
            f"It has {', '.join(error.known)}.",
        )
    raise CaseError([problem])
