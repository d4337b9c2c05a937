"""The sheet of a case; mistakes are reported with their line of the case file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from wovenfab.case import Case, CaseError, problem_at

if TYPE_CHECKING:
    from wovenfab.sheet.sheet import Sheet


def sheet_for(case: Case, path: Path, overrides: Sequence[str]) -> Sheet:
    """Return the meshed sheet of a case that was read from ``path``; collective.

    Raises:
        CaseError: If the geometry cannot be meshed or lacks an edge that the case names.
    """
    from mpi4py import MPI

    from wovenfab.sheet.gmsh_io import GeometryError
    from wovenfab.simulation.from_case import UnknownEdgeError, sheet_of

    try:
        return sheet_of(case, MPI.COMM_WORLD)
    except GeometryError as error:
        problem = problem_at(path, overrides, "sheet.file", str(error))
    except UnknownEdgeError as error:
        problem = problem_at(
            path,
            overrides,
            f"boundary.{error.edge}",
            f"the sheet has no edge {error.edge!r}",
            f"It has {', '.join(error.known)}.",
        )
    raise CaseError([problem])
