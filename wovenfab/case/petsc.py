"""Which PETSc options a case may have.

A case is data: options that run programs, load code or write files are not among these. After
``--`` on the command line, and in ``PETSC_OPTIONS``, a user may give any.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

#: Linear solvers, preconditioners, packages and orderings of PETSc itself or that come with it.
_SOLVERS = """preonly cg cgne cr fcg pipecg groppcg minres symmlq gmres fgmres lgmres dgmres gcr
    bcgs bcgsl fbcgs ibcgs tfqmr tcqmr cgs lsqr richardson chebyshev"""
_PRECONDITIONERS = """none jacobi sor bjacobi pbjacobi asm gasm ilu icc lu cholesky gamg redundant
    telescope ksp kaczmarz svd qr"""
_PACKAGES = """petsc mumps superlu superlu_dist umfpack cholmod klu spqr strumpack mkl_pardiso"""
_ORDERINGS = "natural nd 1wd rcm qmd rowlength amd metisnd external"
#: Ways to print, which print on the terminal as long as they have no value.
_SHOWN = re.compile(
    r"(snes|ksp)_(monitor|view|converged_reason|converged_rate)|snes_monitor_short"
    r"|ksp_monitor_(short|true_residual|singular_value)|snes_linesearch_monitor"
)
#: Controls of MUMPS without those that name units of output (1 to 3), change what it solves (19 to
#: 21, 30) or write the factor to disk (22).
_MUMPS = re.compile(r"mat_mumps_(icntl_(4|6|7|8|1[0-4]|2[3-9]|3[135678]|48|49|56|58)|cntl_[1-57])")
_NUMBERS = re.compile(
    r"ksp_(rtol|atol|divtol|max_it|gmres_restart|richardson_scale|cg_single_reduction)"
    r"|ksp_(initial_guess_nonzero|diagonal_scale|diagonal_scale_fix|gmres_modifiedgramschmidt)"
    r"|pc_factor_(levels|fill|zeropivot|shift_amount|pivoting|diagonal_fill|in_place|reuse_fill"
    r"|reuse_ordering|nonzeros_along_diagonal|pivot_in_blocks)"
    r"|pc_(sor_omega|sor_its|sor_lits|asm_overlap|asm_blocks|bjacobi_blocks|jacobi_abs)"
    r"|snes_(max_it|max_funcs)"
)
_WORDS: Mapping[str, str] = {
    "ksp_type": _SOLVERS,
    "pc_type": _PRECONDITIONERS,
    "ksp_pc_side": "left right symmetric",
    "ksp_norm_type": "none preconditioned unpreconditioned natural",
    "pc_factor_mat_solver_type": _PACKAGES,
    "pc_factor_mat_ordering_type": _ORDERINGS,
    "pc_factor_shift_type": "none nonzero positive_definite inblocks",
    "pc_jacobi_type": "diagonal rowmax rowsum rowl1",
    "pc_asm_type": "basic restrict interpolate none",
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",
}
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
#: Numbers for which PETSc takes memory, where it ends the process if there is not enough.
_LARGEST = {"ksp_gmres_restart": 10_000}
_SWITCH = ("true", "false", "yes", "no", "on", "off", "")


REMEDY = "On the command line any option of PETSc may stand after --, as the user's own."


def refused(options: Mapping[str, str | int | float | bool]) -> Iterator[tuple[str, str, str]]:
    """Yield name, fault and remedy of each option that a case may not have.

    Args:
        options: Options by name, without the leading dash.
    """
    for name, value in options.items():
        if fault := _fault(name, str(value).lower() if isinstance(value, bool) else str(value)):
            yield name, fault, REMEDY


def _fault(name: str, text: str) -> str:
    """Return what is wrong with an option and its value, or nothing."""
    if name in _WORDS:
        known = _WORDS[name].split()
        return "" if text in known else f"in a case it can be {', '.join(known)}, not {text!r}"
    if _SHOWN.fullmatch(name):
        return "" if text == "" else f"in a case it can be '' (to print), not {text!r}"
    if _NUMBERS.fullmatch(name) or _MUMPS.fullmatch(name):
        fits = text in _SWITCH or _NUMBER.fullmatch(text)
        if fits and name in _LARGEST and text not in _SWITCH and float(text) > _LARGEST[name]:
            return f"is at most {_LARGEST[name]} in a case, not {text}"
        return "" if fits else f"expected a number, true or false, got {text!r}"
    return (
        "is no option that a case may have: those act on the linear solver (ksp_type, pc_type, "
        "pc_factor_levels, mat_mumps_icntl_14 and the like), on Newton's method (snes_type, "
        "snes_max_it, snes_linesearch_type) or print on the terminal (snes_monitor, ksp_view)"
    )
