"""What each specimen of replicates would give, beside the values of all of them together.

Fits of each specimen alone would take as long as the joint one. Near the joint solution residuals
are linear in the scaled parameters q. If the curve of one specimen takes the place of the mean, and
other tests stay, q moves by the least-squares solution of J dq = -(change of the residuals). The
mean of these moves over the specimens is zero, since the mean curve is the mean of theirs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wovenfab.study.fit.fit_file import Fit, MeasuredTest
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.search import Found


@dataclass(frozen=True)
class SpecimenValues:
    """What the curve of one specimen asks for.

    Attributes:
        test: Number of its test, from 0.
        measured: Name of its file.
        values: Of the parameters, in SI units.
    """

    test: int
    measured: str
    values: Mapping[str, float]


def specimen_values(objective: Objective, fit: Fit, found: Found) -> tuple[SpecimenValues, ...]:
    """Return the values that each specimen of replicates asks for, linearised where all are fitted.

    Tests with one specimen give none.
    """
    e = found.evaluation
    weights = e.weights(fit)
    jacobian = weights[:, None] * e.jacobian
    centre = objective.scaled(found.values)
    ends = np.cumsum([0, *(c.rows.size for c in e.comparisons)])
    result = []
    for number, (test, c) in enumerate(zip(fit.tests, e.comparisons, strict=True)):
        if not isinstance(test, MeasuredTest) or len(test.specimens) == 1:
            continue
        part = slice(ends[number], ends[number + 1])
        for own, specimen in enumerate(test.specimens):
            forces = test.replicates.forces[own, c.rows]
            change = np.zeros_like(weights)
            change[part] = weights[part] * test.factors[c.rows] * (c.measured - forces)
            move = np.linalg.lstsq(jacobian, -change, rcond=1e-6)[0]
            values = objective.values(centre + move)
            result.append(SpecimenValues(number, specimen.file.name, values))
    return tuple(result)


def describe_specimens(specimens: Sequence[SpecimenValues], fit: Fit) -> list[str]:
    """Return a line for each parameter and test: its values of the specimens and their scatter."""
    lines = []
    for number, test in enumerate(fit.tests):
        own = [s for s in specimens if s.test == number]
        names = ", ".join(one.file.stem for one in test.specimens)
        for unknown in fit.unknowns if own else ():
            values = np.array([s.values[unknown.name] for s in own])
            shown = ", ".join(f"{value:.4g}" for value in values)
            scatter = f"standard deviation {values.std(ddof=1):.2g}"
            lines.append(
                f"{unknown.name} of each specimen ({names}): {shown} {unknown.unit}, {scatter} "
                "(linearised)."
            )
    return lines
