"""The curve of a test, computed, compared with the measured one, and its derivatives.

A displacement of the machine is that of the sample, of a spring in series and an offset:
X = U + c F + u_0, and its force F + f_0. Between two steps the force is a cubic polynomial of U
that is linear in the forces of the steps, so that derivatives are interpolated in the same way.

Where the program reverses, friction may turn within a step or two. What lies between these steps
is not known: a force there has the change of the force in the step as a further error. A row at
such a place then tells where friction turns to about the length of a step, and no more.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from math import isclose
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicHermiteSpline, PPoly, make_interp_spline

from wovenfab.case import Case, CaseError, read_case
from wovenfab.case.objects import differentiate, sheet_of, simulation_of
from wovenfab.forms.effect import Target
from wovenfab.measured.columns import setting_text
from wovenfab.measured.curve import Measured, reversed_force
from wovenfab.model.model import Model, preserved
from wovenfab.model.probes import PointFields, located
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import Step, StepFailedError
from wovenfab.study.cluster import CASE, portable
from wovenfab.study.fit.fit_file import FitParameter
from wovenfab.study.runner import Command, Ended

Array = NDArray[np.float64]
#: Fewest measured points that can be compared.
FEWEST = 3
#: Ratio of the slopes of two steps after a reversal from which the first is not resolved.
STEEP = 2.0
#: File of a command that has the parameters by which the curve is differentiated.
TARGETS = "targets.pickle"
#: Iterations for the displacement of the sample behind a spring.
ITERATIONS = 50


@dataclass(frozen=True)
class FieldPoints:
    """Where and when displacements are wanted.

    Attributes:
        time: At which a step of the program ends, s.
        points: Reference positions, shape (n, 2), m.
    """

    time: float
    points: Array


@dataclass(frozen=True)
class ResponseCurve:
    """The computed force against the displacement of the sample.

    Attributes:
        displacement: m, shape (steps,).
        force: N, shape (steps,).
        work: External work since the start, J, shape (steps,).
        slopes: Derivatives of the force by the material parameters, shape (steps, parameters).
        turns: Rows at which the program reverses, first and last included.
        seconds: Wall time.
        straight: Whether the curve is straight between the steps, as pictures draw it.
        fields: Displacements (m) and their derivatives by the material parameters at the points of
            measured fields, by :attr:`~wovenfab.study.fit.fit_file.FieldTest.key`, shape (points,
            2, 1 + parameters).
    """

    displacement: Array
    force: Array
    work: Array
    slopes: Array
    turns: tuple[int, ...]
    seconds: float
    straight: bool = False
    fields: Mapping[str, Array] = field(default_factory=dict)

    @staticmethod
    def of(data: Mapping[str, Any]) -> ResponseCurve:
        """Return the curve of what :meth:`as_lists` gave."""
        names = "displacement", "force", "work", "slopes"
        u, f, work, slopes = (np.array(data[name]) for name in names)
        fields = {key: np.array(values) for key, values in data.get("fields", {}).items()}
        turns = tuple(data["turns"])
        return ResponseCurve(u, f, work, slopes, turns, data["seconds"], fields=fields)

    def as_lists(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        fields = {key: values.tolist() for key, values in self.fields.items()}
        own = {name: np.asarray(value).tolist() for name, value in asdict(self).items()}
        return own | {"fields": fields}

    def times(self, factors: Array) -> ResponseCurve:
        """Return the curve with derivatives by other parameters: each multiplied by a factor."""
        fields = {
            key: np.concatenate([values[..., :1], values[..., 1:] * factors], axis=2)
            for key, values in self.fields.items()
        }
        return replace(self, slopes=self.slopes * factors, fields=fields)


class TrialError(Exception):
    """A trial whose run did not come to its end."""


def computed(
    case: Case, targets: Sequence[Target], places: Mapping[str, FieldPoints] = MappingProxyType({})
) -> ResponseCurve:
    """Return the curve of a case with its derivatives; collective.

    Args:
        case: The case.
        targets: The material parameters by which it is differentiated.
        places: Where and when displacements are wanted, by the key of a field.

    Raises:
        TrialError: The run did not come to its end.
    """
    started = perf_counter()
    steps: list[Step] = []
    fields: dict[str, Array] = {}
    try:
        with simulation_of(case, sheet_of(case, MPI.COMM_WORLD)) as simulation:
            if targets:
                differentiate(simulation, case, targets, dissipation=False)
            probes = {key: CloudProbe(simulation.model, p.points) for key, p in places.items()}
            for step in simulation.steps():
                # Where a step was cut, others lie between: they would change the interpolation.
                if step.milestone is None:
                    continue
                steps.append(step)
                slopes = simulation.stepper.state_derivatives
                for key, place in places.items():
                    if isclose(step.time, place.time):
                        fields[key] = probes[key].values(slopes)
    except (CaseError, StepFailedError, StabilityLostError) as error:
        raise TrialError(str(error)) from error
    none = np.zeros(len(targets))
    rows = [s.derivatives.force if s.derivatives else none for s in steps]
    u, f = np.array([(s.displacement, s.force) for s in steps]).T
    work = np.array([sum(s.stored.values()) + sum(s.dissipated.values()) for s in steps])
    seconds = perf_counter() - started
    return ResponseCurve(u, f, work, np.array(rows), _turns(u), seconds, fields=fields)


def command(
    case: Case, targets: Sequence[Target], places: Mapping[str, FieldPoints], ranks: int
) -> Command:
    """Return the command that computes a curve in a process of its own, on several ranks."""
    files = portable(case) | {TARGETS: pickle.dumps((list(targets), dict(places)))}
    return Command(["-m", "wovenfab.study.fit.response"], ranks, files=files)


def curve_of(ended: Ended) -> ResponseCurve:
    """Return the curve that such a command has computed.

    Raises:
        TrialError: The run did not come to its end.
    """
    if ended.failure:
        raise TrialError(ended.failure)
    result = ended.result
    if "failure" in result:
        raise TrialError(result["failure"])
    return ResponseCurve.of(result)


class CloudProbe:
    """Displacements of the present state at points, some of which may lie beside the sheet."""

    def __init__(self, model: Model, points: Array) -> None:
        """Locate points (m), shape (n, 2), and compile the evaluation; collective."""
        *_, self._on = located(model.sheet, points)
        self._model = model
        self._fields = PointFields(model, points[self._on]) if self._on.any() else None

    def values(self, derivatives: Array) -> Array:
        """Return displacements and their derivatives, shape (n, 2, 1 + parameters); collective.

        Args:
            derivatives: Of the state by each parameter, with ghosts, shape (parameters, unknowns).

        Returns:
            They are NaN at points beside the sheet.
        """
        field, values = self._model.field, np.full((len(self._on), 2, 1 + len(derivatives)), np.nan)
        if self._fields is None:
            return values
        columns = [_mean_displacement(self._fields)]
        with preserved(field):
            for direction in derivatives:
                field.x.array[:] = direction
                columns.append(_mean_displacement(self._fields))
        values[self._on] = np.stack(columns, axis=2)
        return values


def _mean_displacement(fields: PointFields) -> Array:
    """Return the mean over the families, shape (points, 2), m; collective."""
    return np.asarray(np.mean([*fields.values().values()], axis=0))


def _turns(displacement: Array) -> tuple[int, ...]:
    """Return where a displacement reverses, with first and last row."""
    signs = np.sign(np.diff(displacement))
    moving = np.flatnonzero(signs)
    last = [i for i, j in pairwise(moving) if signs[i] != signs[j]]
    return (0, *(int(i) + 1 for i in last), len(displacement) - 1)


@dataclass(frozen=True)
class Comparison:
    """What was measured beside what is computed: of a curve, of figures or of a field, SI units.

    Attributes:
        rows: Rows of the measured curve, figures, or components of displacements, that count.
        measured: Their forces or values.
        computed: The computed ones.
        slopes: Derivatives of these by all parameters, shape (rows, parameters).
        unresolved: What the force may differ by where the steps do not resolve the curve, else 0;
            infinite at points beside the sheet.
        size: What a distance is a share of: the largest measured force, each measured figure, or
            of a component the largest displacement over the root of two.
        beyond: Number of rows at displacements that the program does not reach.
        reach: Least and largest displacement of the program, m.
        of_field: Whether it is that of displacements.
    """

    rows: NDArray[np.intp]
    measured: Array
    computed: Array
    slopes: Array
    unresolved: Array
    size: Array
    beyond: int = 0
    reach: tuple[float, float] = (0.0, 0.0)
    of_field: bool = False

    @property
    def left_out(self) -> str:
        """How many rows are compared and how many the program does not reach; else nothing."""
        if not self.beyond:
            return ""
        low, high = (f"{1e3 * end:.4g}" for end in self.reach)
        count = self.rows.size
        are, lie = ("is" if count == 1 else "are"), ("lies" if self.beyond == 1 else "lie")
        return (
            f"{count} of {count + self.beyond} rows {are} compared, {self.beyond} {lie} beyond the "
            f"displacements of the program, {low} to {high} mm"
        )

    @property
    def shares(self) -> Array:
        """Computed less measured ones, over their size."""
        shares: Array = (self.computed - self.measured) / self.size
        return shares

    @property
    def misfit(self) -> float:
        """Root mean square of these shares, where the steps resolve the curve."""
        return float(np.sqrt(np.mean(self.shares[self.resolved] ** 2)))

    @property
    def resolved(self) -> NDArray[np.bool_]:
        """Whether the steps resolve the curve there."""
        return np.asarray(self.unresolved == 0)


class BranchError(Exception):
    """Measured and computed curve do not belong to each other."""


def curve_of_history(displacement: Array, force: Array) -> ResponseCurve:
    """Return the curve of a run that is there already, in m and N, without derivatives.

    It is straight between the steps, as it is drawn.
    """
    slopes, work = np.zeros((len(force), 0)), cumulative_trapezoid(force, displacement, initial=0.0)
    return ResponseCurve(
        displacement, force, work, slopes, _turns(displacement), 0.0, straight=True
    )


def compared(
    measured: Measured,
    curve: ResponseCurve,
    unknowns: Sequence[FitParameter] = (),
    values: Mapping[str, float] = MappingProxyType({}),
    toe: float = -np.inf,
    reference: Mapping[str, float] = MappingProxyType({}),
    error: float = np.inf,
) -> Comparison:
    """Return what is measured beside what is computed.

    ``values`` are those of the parameters by name (SI units); points below the ``toe`` (m) are
    left out. With the machine's parameters in ``reference`` the program reaches the rows that are
    compared: the same rows for all values. A step after a reversal that changes the force by less
    than the ``error`` (N) beyond the slope of the next one is resolved.

    Raises:
        BranchError: The curves do not belong to each other.
    """
    if not np.ptp(curve.displacement):
        raise BranchError("the program has not moved yet: there is nothing to compare")
    branches, turns = measured.branches(), curve.turns
    if measured.cycle:  # of a longer record: the last one of the program is compared
        turns = turns[-len(branches) - 1 :]
    if len(branches) != len(turns) - 1:
        raise BranchError(
            f"{measured.file.name} has {len(branches)} branches of loading and unloading, the "
            f"program has {len(turns) - 1}; let the program reverse as often"
        )
    _check_signs(measured, curve.displacement[list(turns[:2])])
    machine, fixed = (
        [given.get(f"machine.{name}", 0.0) for name in ("compliance", "displacement", "force")]
        for given in (values, reference)
    )
    sample = measured.displacement - fixed[1] - fixed[0] * (measured.force - fixed[2])
    wanted = 0
    parts: list[Any] = []
    for number, rows in enumerate(branches):
        chosen = rows if number == 0 else rows[1:]
        chosen = chosen[measured.displacement[chosen] >= toe]
        wanted += chosen.size
        span = slice(turns[number], turns[number + 1] + 1)
        low, high = np.sort(curve.displacement[list(turns[number : number + 2])])
        slack = 1e-3 * (high - low)
        chosen = chosen[(sample[chosen] >= low - slack) & (sample[chosen] <= high + slack)]
        parts.append(_along(measured, curve, span, chosen, unknowns, machine, error))
    rows, forces, computed, slopes, uncertain = (
        np.concatenate(one) for one in zip(*parts, strict=True)
    )
    reach = float(curve.displacement.min()), float(curve.displacement.max())
    count = rows.size
    if count < FEWEST:
        low, high = 1e3 * measured.displacement.min(), 1e3 * measured.displacement.max()
        raise BranchError(
            f"{measured.file.name} and the computed curve have less than {FEWEST} displacements in "
            f"common: {low:.4g} to {high:.4g} mm are measured, the program goes from "
            f"{1e3 * reach[0]:.4g} to {1e3 * reach[1]:.4g} mm. Measure displacements from the "
            "state at rest, in the unit that the header says, and let the program go as far"
        )
    if np.count_nonzero(uncertain == 0) < FEWEST:
        raise BranchError(
            f"{measured.file.name}: the steps of the run resolve less than {FEWEST} of its rows, "
            "the others lie where friction reverses. Take more steps"
        )
    size = np.full(count, np.abs(forces).max())
    return Comparison(rows, forces, computed, slopes, uncertain, size, wanted - count, reach)


def _check_signs(measured: Measured, program: Array) -> None:
    """Refuse curves whose displacement or force has the other sign than the program's.

    Args:
        measured: The measured curve.
        program: Displacements (m) between which the program goes first, shape (2,).

    Raises:
        BranchError: With what is to be said.
    """
    if measured.is_reversed:
        raise BranchError(f"{measured.file.name}: {reversed_force(measured.reading)}")
    u = measured.displacement[measured.branches()[0]]
    goes = float(program[1] - program[0])
    if (u[-1] - u[0]) * goes < 0:
        raise BranchError(
            f"{measured.file.name}: the displacement first goes from {1e3 * u[0]:.4g} to "
            f"{1e3 * u[-1]:.4g} mm, the program to {1e3 * program[1]:.4g} "
            "mm. If the machine counts the other way, say "
            f"{setting_text('units', 'displacement', '-1 mm')}, and maybe the same of the force"
        )


def _along(
    measured: Measured,
    curve: ResponseCurve,
    span: slice,
    rows: NDArray[np.intp],
    unknowns: Sequence[FitParameter],
    machine: Sequence[float],
    error: float,
) -> tuple[NDArray[np.intp], Array, Array, Array, Array]:
    """Return rows, measured and computed forces, slopes and what is not resolved, of one branch."""
    compliance, shift, weight = machine
    u, f, by_parameters = curve.displacement[span], curve.force[span], curve.slopes[span]
    keep = np.concatenate([[True], np.diff(u) != 0])  # a hold has no length here
    u, f, by_parameters = u[keep], f[keep], by_parameters[keep]
    kink = unresolved(u, f, error)
    low, high = np.sort(u[[0, -1]])
    force = _straight(u, f) if curve.straight else _cubic(u, f, kink)
    x = measured.displacement[rows]
    at = x - shift
    for _ in range(ITERATIONS if compliance else 0):
        steep = force(np.clip(at, low, high), 1)
        step = (at + compliance * _along_ends(force, at) + shift - x) / (1 + compliance * steep)
        at = np.clip(at - step, 2 * low - high, 2 * high - low)
        if np.abs(step).max(initial=0.0) < 1e-12 * (high - low):
            break
    computed, steep = _along_ends(force, at), force(np.clip(at, low, high), 1)
    softer = 1 + compliance * steep
    columns, material = [], 0
    for unknown in unknowns:
        match unknown.name:
            case "machine.compliance":
                columns.append(-steep * computed / softer)
            case "machine.displacement":
                columns.append(-steep / softer)
            case "machine.force":
                columns.append(np.ones_like(at))
            case _:
                slope = _cubic(u, by_parameters[:, material], kink)
                columns.append(_along_ends(slope, at) / softer)
                material += 1
    slopes = np.stack(columns, axis=1) if columns else np.zeros((at.size, 0))
    uncertain = np.zeros_like(at)
    if kink:  # also in half of the next step: a row at its start may be on either side
        way = np.abs(u - u[0])
        places = np.searchsorted([*way[1:kink], (way[kink] + way[kink + 1]) / 2], np.abs(at - u[0]))
        uncertain = np.array([*np.abs(np.diff(f[: kink + 1])), 0.0])[places]
    return rows, measured.force[rows], computed + weight, slopes, uncertain


def _along_ends(curve: PPoly, at: Array) -> Array:
    """Return the values of a spline, continued straight beyond its ends.

    A row at an end of the program must have a derivative by the machine's displacement.
    """
    inside = np.clip(at, curve.x[0], curve.x[-1])
    return np.asarray(curve(inside) + curve(inside, 1) * (at - inside))


def unresolved(u: Array, f: Array, error: float) -> int:
    """Return how many steps after a reversal do not resolve how the force turns.

    Args:
        u: Displacements of a branch in the order of time, shape (n,).
        f: Forces, shape (n,).
        error: Change of the force beyond the slope of the next step that does not matter, N.
    """
    slopes = np.abs(np.diff(f) / np.diff(u))
    for k in range(slopes.size - 1):
        steep = slopes[k] > STEEP * slopes[k + 1]
        if not steep or (slopes[k] - slopes[k + 1]) * abs(u[k + 1] - u[k]) <= error:
            return k
    return 0  # nothing of it is regular: friction does not stand out


def _cubic(u: Array, f: Array, kink: int = 0) -> CubicHermiteSpline:
    """Return the cubic through points whose slopes are those of parabolas through three.

    From the ``kink`` on, a number of steps, slopes do not depend on what is before it.
    """
    slopes = _slopes(u[kink:], f[kink:])
    if kink:
        slopes = np.concatenate([_slopes(u[: kink + 1], f[: kink + 1])[:-1], slopes])
    return CubicHermiteSpline(*_rising(u, f, slopes))


def _straight(u: Array, f: Array) -> PPoly:
    return PPoly.from_spline(make_interp_spline(*_rising(u, f), k=1))


def _slopes(u: Array, f: Array) -> Array:
    return np.asarray(np.gradient(f, u, edge_order=2 if len(u) > 2 else 1))


def _rising(u: Array, *others: Array) -> tuple[Array, ...]:
    """Return displacements and what belongs to them so that the displacements increase."""
    return (u, *others) if u[0] < u[-1] else (u[::-1], *(o[::-1] for o in others))


def main() -> None:
    """Compute the curve that :func:`command` asks for; print it on the first rank."""
    try:
        targets, places = pickle.loads(Path(TARGETS).read_bytes())
        result = computed(read_case(CASE), targets, places).as_lists()
    except TrialError as error:
        result = {"failure": str(error)}
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(result))


if __name__ == "__main__":
    main()
